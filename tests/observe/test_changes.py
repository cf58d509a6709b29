"""A watch: its changes, applied to its first profile, give the profile of every later moment."""

from __future__ import annotations

import asyncio
import json
import time
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from aiorts import Component, ExternalContext, InPort, Kernel, OutPort, Param, PeriodicContext, SimulatedClock
from aiorts.errors import BusyError, ClosedError
from aiorts.events import PortAdded
from aiorts.observe.change_values import Change, ProfileSnapshot
from aiorts.testing import simulate
from aiorts.types import TimedDouble


class Node(Component):
    into = InPort(TimedDouble)
    out = OutPort(TimedDouble)
    gain = Param(1.0, ge=0.0)
    fails = Param(False)

    def on_initialize(self) -> None:
        self.add_port("early", OutPort(TimedDouble))
        if self.name.endswith("bad"):
            raise ValueError("bad from the start")

    def on_execute(self) -> None:
        if self.fails:
            raise ValueError("asked to")


class Follower:
    """Applies whatever a watch says."""

    def __init__(self, kernel: Kernel, length: int = 1024) -> None:
        self.watch = kernel.changes(length=length)
        self.profile: Any = None
        self.seen: list[ProfileSnapshot | Change] = []

    async def catch_up(self) -> Any:
        """Take all there is; the structure known then."""
        while self.watch._stale or self.watch._queue:
            change = await anext(self.watch)
            json.dumps(change.to_plain(), allow_nan=False)
            self.profile = change.apply(self.profile)
            self.seen.append(change)
        return self.profile.structure()


OPERATIONS = st.lists(
    st.tuples(
        st.sampled_from(
            (
                "add",
                "add_bad",
                "remove",
                "port",
                "unport",
                "connect",
                "disconnect",
                "start",
                "stop",
                "join",
                "leave",
                "activate",
                "tick",
                "fail",
                "reset",
                "configure",
                "rate",
                "catch_up",
            )
        ),
        st.integers(0, 5),
        st.integers(0, 5),
    ),
    max_size=40,
)


SCRIPT: list[tuple[str, int, int]] = [
    *[("add", 0, 0)] * 3,
    ("add_bad", 0, 0),
    ("connect", 0, 1),
    ("connect", 1, 1),
    ("start", 0, 1),
    ("start", 2, 2),
    ("tick", 0, 0),
    ("join", 1, 0),
    ("activate", 0, 0),
    ("port", 0, 2),
    ("configure", 1, 3),
    ("fail", 0, 0),
    ("tick", 0, 0),
    ("reset", 0, 0),
    ("rate", 2, 1),
    ("unport", 0, 2),
    ("leave", 1, 0),
    ("disconnect", 0, 0),
    ("stop", 0, 1),
    ("remove", 0, 0),
    ("remove", 0, 0),
]
"""Everything once, where it is possible."""


async def operate(kernel: Kernel, operation: str, one: int, other: int) -> None:
    """One change of the system, or none when it is not possible now."""
    components, contexts = list(kernel.components.values()), list(kernel.contexts.values())
    connectors = list(kernel.connectors.values())
    if operation in ("add", "add_bad"):
        try:
            await kernel.add(Node(f"n{kernel.bus.sequence}{'bad' if operation == 'add_bad' else ''}"))
        except ValueError:
            assert operation == "add_bad"
        return
    if not components:
        return
    node = components[one % len(components)]
    peer = components[other % len(components)]
    context: Any = contexts[other % len(contexts)] if contexts else None
    if operation == "remove":
        await kernel.remove(node)
    elif operation == "port" and f"p{other}" not in node.ports:
        node.add_port(f"p{other}", OutPort(TimedDouble))
    elif operation == "unport" and f"p{other}" in node.ports:
        node.remove_port(f"p{other}")
    elif operation == "connect":
        await kernel.connect(node.ports["out"], peer.ports["into"], allow_duplicate=True)
    elif operation == "disconnect" and connectors:
        await kernel.disconnect(connectors[one % len(connectors)])
    elif operation == "configure":
        await node.configure(gain=float(other))
    elif operation == "start":
        members = {n.name: n for n in (node, peer)}.values()
        kind = ExternalContext() if other % 2 else PeriodicContext(1.0)
        await kernel.start(kind, *members, activate=one % 2 == 0)
    elif context is None:
        return
    elif operation == "stop":
        await context.stop()
    elif operation == "join" and node not in (m.component for m in context.runner.members):
        await context.add(node)
    elif operation == "leave" and node in (m.component for m in context.runner.members):
        await context.remove(node)
    elif operation == "activate":
        await context.activate()
    elif operation == "reset":
        await context.reset()
    elif operation == "fail":
        await node.configure(fails=not node.fails)  # type: ignore[attr-defined]
    elif operation == "tick" and isinstance(context, ExternalContext):
        await context.tick()
    elif operation == "rate" and isinstance(context, PeriodicContext):
        await context.set_rate(1.0 + one)


@pytest.mark.slow(kept_by="first")
@pytest.mark.row(84)
@settings(max_examples=60)
@example(SCRIPT)
@given(OPERATIONS)
def test_changes_applied_to_the_snapshot_give_the_later_snapshot(operations: list[tuple[str, int, int]]) -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            always, seldom, small = Follower(kernel), Follower(kernel), Follower(kernel, length=3)
            await seldom.catch_up()
            await small.catch_up()
            for operation in operations:
                if operation[0] == "catch_up":
                    await small.catch_up()
                    continue
                await operate(kernel, *operation)
                assert await always.catch_up() == kernel.profile().structure(), operation
            await asyncio.sleep(3.0)
            reality = kernel.profile().structure()
            for follower in (always, seldom, small):
                assert await follower.catch_up() == reality
            assert sum(isinstance(change, ProfileSnapshot) for change in always.seen) == 1
            numbers = [change.sequence for change in always.seen]
            assert numbers == sorted(numbers)

    simulate(main)


@pytest.mark.slow(kept_by="test_a_watch_holds_as_many_changes_as_it_was_told_and_no_more")
@pytest.mark.row(84)
def test_a_slow_reader_gets_a_fresh_profile_and_knows_what_it_missed() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            slow = Follower(kernel, length=10)
            await slow.catch_up()
            node = await kernel.add(Node("node"))
            await slow.catch_up()
            for number in range(10_000):
                await node.configure(gain=float(number))
            assert len(slow.watch._queue) <= 10
            slow.seen.clear()
            await slow.catch_up()
            (fresh,) = slow.seen
            assert isinstance(fresh, ProfileSnapshot)
            assert fresh.missed == 30_000  # three events a change
            assert fresh.profile.components["node"].params["gain"].value == 9999.0

    simulate(main)


@pytest.mark.row(84)
def test_a_watch_holds_as_many_changes_as_it_was_told_and_no_more() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            node = await kernel.add(Node("node"))
            follower = Follower(kernel, length=10)
            for changes, kinds in ((3, [Change] * 9), (4, [ProfileSnapshot])):  # three events a change
                await follower.catch_up()
                follower.seen.clear()
                for number in range(changes):
                    await node.configure(gain=10.0 * changes + number)
                await follower.catch_up()
                assert [type(seen) for seen in follower.seen] == kinds
            assert follower.seen[0].missed == 12

    simulate(main)


@pytest.mark.row(21, 201)
def test_a_running_components_interface_changes_and_everyone_sees_it_at_once() -> None:
    """The Flexi paper (III-A): tools went on showing the ports a component was created with."""

    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            node = await kernel.add(Node("node"))
            loop = await kernel.start(PeriodicContext(100.0), node, activate=True)
            followers = [Follower(kernel) for _ in range(3)]
            for follower in followers:
                await follower.catch_up()
            begun = clock.monotonic_ns()
            node.add_port("camera", OutPort(TimedDouble, unit="m"))
            for follower in followers:
                change = await anext(follower.watch)
                assert isinstance(change, Change)
                assert isinstance(change.event, PortAdded)
                seen = change.apply(follower.profile).components["node"].ports["camera"]
                assert (seen.direction, seen.unit) == ("out", "m")
            assert clock.monotonic_ns() == begun
            assert kernel.find("node.camera") is node.ports["camera"]
            assert kernel.profile().components["node"].ports["camera"].unit == "m"
            node.remove_port("camera")
            change = await anext(followers[0].watch)
            assert "camera" not in change.apply(followers[0].profile).components["node"].ports
            assert loop.running

    simulate(main)


@pytest.mark.fault("I7")
async def test_what_is_told_is_true_within_a_fifth_of_a_second(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        node = await kernel.add(Node("node"))
        context = await kernel.start(PeriodicContext(100.0, name="loop"), node)
        async with kernel.changes() as watch:
            first = await anext(watch)
            assert first.apply().components["node"].states == {"loop": "inactive"}  # type: ignore[call-arg]
            asking = asyncio.create_task(context.activate(node))
            async with asyncio.timeout(20):
                async for change in watch:
                    if change.apply(first.profile).components["node"].states == {"loop": "active"}:  # type: ignore[union-attr]
                        break
            assert str(node.states["loop"]) == "active"
            await asking


def test_a_watch_ends_with_its_kernel_and_tells_the_end() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            await kernel.add(Node("node"))
            watch = kernel.changes()
            assert isinstance(await anext(watch), ProfileSnapshot)
            reading = asyncio.create_task(anext(watch))
            await asyncio.sleep(0)
            with pytest.raises(BusyError):
                await anext(watch)
        last = [await reading] + [change async for change in watch]
        assert "node" not in last[-1].apply(kernel.profile()).components
        with pytest.raises(ClosedError):
            kernel.changes()
        assert kernel.bus.observers == ()

    simulate(main)


@pytest.mark.slow
@settings(max_examples=25)
@example(SCRIPT)
@given(OPERATIONS)
def test_a_profile_taken_in_turns_is_as_true_as_one_of_a_moment(operations: list[tuple[str, int, int]]) -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            for number in range(4):
                await kernel.add(Node(f"node{number}"))
            profiling = asyncio.create_task(kernel.profile_in_turns(0.0))
            await asyncio.sleep(0)
            for operation in operations:
                if operation[0] != "catch_up":
                    await operate(kernel, *operation)
                    if profiling.done():
                        taken, now = profiling.result(), kernel.profile()
                        if taken.sequence == now.sequence:
                            assert taken.structure() == now.structure()
                        profiling = asyncio.create_task(kernel.profile_in_turns(0.0))
            await profiling
            assert (await kernel.profile_in_turns(0.0)).structure() == kernel.profile().structure()
            assert kernel.bus.observers == ()

    simulate(main)


@pytest.mark.slow
def test_a_thousand_components_are_profiled_without_holding_the_loop() -> None:
    async def main(clock: SimulatedClock) -> None:
        turns = 0

        async def count() -> None:
            nonlocal turns
            while True:
                turns += 1
                await asyncio.sleep(0)

        async with Kernel() as kernel:
            nodes = [await kernel.add(Node(f"node{number}")) for number in range(1000)]
            for one, other in pairwise(nodes):
                await kernel.connect(one.out, other.into)
            counting = asyncio.create_task(count())
            profile = await kernel.profile_in_turns(0.0005)
            counting.cancel()
            assert turns >= 3
            assert profile.structure() == kernel.profile().structure()
            begun = time.perf_counter()
            assert len(kernel.profile().components) == 1000
            assert time.perf_counter() - begun < 2.0  # 23 ms on an idle machine

    simulate(main)


def test_a_component_that_is_still_initialised_is_in_no_profile() -> None:
    class Slow(Component):
        async def on_initialize(self) -> None:
            self.add_port("early", OutPort(TimedDouble))
            await asyncio.sleep(1.0)
            raise ValueError("no")

    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            follower = Follower(kernel)
            await follower.catch_up()
            adding = asyncio.create_task(kernel.add(Slow("slow")))
            await asyncio.sleep(0.5)
            assert "slow" in kernel.components
            for profile in (kernel.profile(), await kernel.profile_in_turns(0.0)):
                assert dict(profile.components) == {}
            with pytest.raises(ValueError, match="no"):
                await adding
            assert await follower.catch_up() == kernel.profile().structure()

    simulate(main)
