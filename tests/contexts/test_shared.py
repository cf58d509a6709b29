"""Components in several contexts, and storms of requests: never entered twice at once, never in an impossible state."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import random
import time

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule, run_state_machine_as_test

from aiorts import (
    Component,
    Context,
    EventContext,
    ExternalContext,
    Kernel,
    LifecycleState,
    PeriodicContext,
    SimulatedClock,
)
from aiorts.errors import AiortsError
from aiorts.kernel.loop.bus import HookBefore
from aiorts.testing.simulation import SimulatedLoop, simulate
from campaign import CAMPAIGN, ORDERS
from contexts.parts import MS, Doer, Idle, Ticker


class Fragile(Component):
    """Notes when it is entered twice at once; fails where `dice` says so."""

    def __init__(self, name: str, dice: random.Random, contexts: int = 1) -> None:
        super().__init__(name)
        self.dice = dice
        self.inside = 0
        self.entered_twice = 0
        self.wrong_context = 0
        self.order: dict[str, list[str]] = {}

    async def _hook(self, what: str) -> None:
        context = self.context.name
        self.inside += 1
        self.entered_twice += self.inside > 1
        self.order.setdefault(context, []).append(what)
        try:
            if self.dice.random() < 0.5:
                await self.sleep(self.dice.choice([0.0, 0.001, 0.005]))
            self.wrong_context += self.context.name != context
        finally:
            self.inside -= 1
        if self.dice.random() < 0.1:
            raise RuntimeError(f"{what} fails")

    async def on_activated(self) -> None:
        await self._hook("activated")

    async def on_deactivated(self) -> None:
        await self._hook("deactivated")

    async def on_execute(self) -> None:
        await self._hook("execute")

    async def on_state_update(self) -> None:
        await self._hook("execute")

    async def on_reset(self) -> None:
        await self._hook("reset")

    def broken_rules(self) -> list[str]:
        """What must never be: a wrong order of hooks in one context."""
        found = []
        for context, hooks in self.order.items():
            active = False
            for hook in hooks:
                if hook == "activated" and active:
                    found.append(f"{context}: activated twice")
                if hook == "deactivated" and not active:
                    found.append(f"{context}: deactivated while not active")
                if hook == "execute" and not active:
                    found.append(f"{context}: executed while not active")
                active = hook == "activated" or (active and hook != "deactivated")
        return found


@pytest.mark.slow
@pytest.mark.row(19)
@pytest.mark.fault("C08")
def test_a_component_in_two_contexts_is_never_entered_twice_at_once() -> None:
    async def main(clock: SimulatedClock) -> tuple[Fragile, int]:
        dice = random.Random(3)
        dice_no = random.Random(4)
        dice_no.random = lambda: 0.3  # type: ignore[method-assign] # waits, never fails
        dice_no.choice = dice.choice  # type: ignore[method-assign]
        async with Kernel() as kernel:
            fragile = await kernel.add(Fragile("fragile", dice_no))
            fast = await kernel.start(PeriodicContext(200.0, name="fast"), fragile, activate=True)
            slow = await kernel.start(PeriodicContext(130.0, name="slow"), fragile, activate=True)
            await asyncio.sleep(5.0)
            assert min(fast.statistics.cycles, slow.statistics.cycles) > 100
            assert fragile.states == {"fast": LifecycleState.ACTIVE, "slow": LifecycleState.ACTIVE}
            await fast.deactivate()
            assert fragile.states == {"fast": LifecycleState.INACTIVE, "slow": LifecycleState.ACTIVE}
            return fragile, 0

    fragile, _ = simulate(main)
    assert fragile.entered_twice == 0
    assert fragile.wrong_context == 0
    assert fragile.broken_rules() == []


@pytest.mark.fault("C08")
def test_a_hook_that_asks_another_context_of_its_component_does_not_wait_for_itself() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            other: Context

            async def ask() -> None:
                await other.deactivate(doer)
                await other.remove(doer)

            doer = await kernel.add(Doer("doer"))
            mate = await kernel.add(Ticker("mate"))
            other = await kernel.start(PeriodicContext(100.0, name="other"), doer, mate, activate=True)
            doer.execute = ask
            await kernel.start(PeriodicContext(1.0, name="own"), doer, activate=True)
            before = clock.monotonic_ns()
            while other.members == (doer, mate):
                await asyncio.sleep(0.001)
            assert other.members == (mate,)
            assert clock.monotonic_ns() - before <= 50 * MS

    simulate(main)


@pytest.mark.fault("C08")
def test_a_hook_that_stops_another_context_of_its_component_does_not_wait_for_itself() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            other: Context

            async def stop() -> None:
                await other.stop()

            doer = await kernel.add(Doer("doer"))
            other = await kernel.start(PeriodicContext(100.0), doer, activate=True)
            doer.execute = stop
            own = await kernel.start(EventContext(), doer, activate=True)
            await asyncio.sleep(0.001)
            own.trigger()
            await asyncio.sleep(0.5)
            assert not other.running
            assert doer.contexts == (own,)
            assert doer.last_error is None

    simulate(main)


@pytest.mark.slow
@pytest.mark.fault("C08")
def test_a_context_stopped_while_its_members_run_ends_in_order_within_a_second() -> None:
    async def main() -> float:
        async with Kernel() as kernel:
            tickers = [await kernel.add(Ticker(f"t{number}", 0.01)) for number in range(5)]
            context = await kernel.start(PeriodicContext(1000.0), *tickers, activate=True)
            await asyncio.sleep(0.1)
            began = time.monotonic()
            await asyncio.gather(context.stop(), context.remove(tickers[0]), return_exceptions=True)
            assert not context.running
            return time.monotonic() - began

    assert asyncio.run(main()) <= 1.0


class Storm(RuleBasedStateMachine):
    """Requests from eight tasks at once, while cycles run and hooks wait and fail."""

    kinds = (lambda: PeriodicContext(300.0), EventContext, ExternalContext)

    @initialize(seed=st.integers(0, 2**16), kind=st.integers(0, 2))
    def open(self, seed: int, kind: int) -> None:
        self.dice = random.Random(seed)
        self.loop = SimulatedLoop(seed=seed)
        self.tasks: list[asyncio.Task[None]] = []
        self.context = type(self).kinds[kind]()
        self.run(self._open())

    async def _open(self) -> None:
        self.kernel = await Kernel().open()
        self.members = [await self.kernel.add(Fragile(f"f{number}", self.dice)) for number in range(2)]
        await self.kernel.start(self.context, *self.members)

    def run(self, main: object) -> None:
        self.loop.run_until_complete(main)  # type: ignore[arg-type]

    @rule(requests=st.lists(st.sampled_from(["activate", "deactivate", "reset"]), min_size=8, max_size=8))
    def ask(self, requests: list[str]) -> None:
        async def one(what: str, member: Component) -> None:
            with contextlib.suppress(AiortsError):  # refused, failed or too late: that is allowed
                await getattr(self.context, what)(member, timeout=self.dice.choice([0.0005, 1.0, None]))

        async def all_at_once() -> None:
            self.tasks += [asyncio.ensure_future(one(what, self.dice.choice(self.members))) for what in requests]
            await asyncio.sleep(self.dice.choice([0.0, 0.002]))

        self.run(all_at_once())

    @rule(seconds=st.sampled_from([0.0, 0.001, 0.02]))
    def wait(self, seconds: float) -> None:
        if isinstance(self.context, EventContext):
            self.context.trigger()
        elif isinstance(self.context, ExternalContext):
            self.run(self.context.tick())
        self.run(asyncio.sleep(seconds))

    @invariant()
    def nothing_impossible_has_happened(self) -> None:
        for member in getattr(self, "members", ()):
            assert member.entered_twice == 0
            assert member.broken_rules() == []
        if hasattr(self, "members"):
            assert self.context.running

    def teardown(self) -> None:
        if not hasattr(self, "loop"):
            return

        async def close() -> None:
            await asyncio.gather(*self.tasks)  # every request was answered
            for member in self.members:
                hooks = self.context.state(member)
                assert (hooks is LifecycleState.ACTIVE) <= (member.order.get(self.context.name) != [])
            await self.kernel.aclose()
            self.nothing_after()

        try:
            self.run(close())
        finally:
            self.loop.close()

    def nothing_after(self) -> None:
        for member in self.members:
            assert member.broken_rules() == []
            assert member.inside == 0


@pytest.mark.slow(kept_by="test_requests_that_ask_for_each_other_in_hooks_do_not_starve_the_loop")
@pytest.mark.row(10, 34)
@pytest.mark.fault("C09")
def test_a_storm_of_requests_from_eight_tasks_leads_to_no_impossible_state() -> None:
    run_state_machine_as_test(
        Storm,
        settings=settings(
            max_examples=ORDERS,
            stateful_step_count=50 if CAMPAIGN else 8,
            deadline=None,
            suppress_health_check=list(HealthCheck),
        ),
    )


@pytest.mark.fault("C09")
def test_requests_that_ask_for_each_other_in_hooks_do_not_starve_the_loop() -> None:
    async def main(clock: SimulatedClock) -> None:
        rounds = 0

        async def on() -> None:
            nonlocal rounds
            rounds += 1
            await doer.context.deactivate(doer)

        async def off() -> None:
            if rounds < 100_000:
                await doer.context.activate(doer)

        async with Kernel() as kernel:
            doer, idle = await kernel.add(Doer("doer", activated=on, deactivated=off)), await kernel.add(Idle("idle"))
            await kernel.start(EventContext(), doer, idle)
            asking = asyncio.create_task(doer.context.activate(doer))
            await asking
            for _ in range(5):
                await asyncio.sleep(0)
            assert rounds < 1000, "the loop got no turn"
            rounds = 100_000

    simulate(main)


@pytest.mark.fault("A06")
def test_a_component_that_joins_a_second_context_from_within_a_hook_is_not_entered_twice() -> None:
    async def main(clock: SimulatedClock) -> None:
        log: list[str] = []

        class Slow(Component):
            async def on_startup(self) -> None:
                log.append(f"startup in {self.context.name} at {clock.monotonic_ns() // MS}")

            async def on_execute(self) -> None:
                began, context = clock.monotonic_ns() // MS, self.context.name
                await self.sleep(0.1)
                assert self.context.name == context
                log.append(f"{context} {began} to {clock.monotonic_ns() // MS}")

        async with Kernel() as kernel:
            slow = await kernel.create(Slow, "slow")
            first = await kernel.start(ExternalContext(name="first"), slow, activate=True)
            start = clock.monotonic_ns() // MS
            tick = asyncio.create_task(first.tick())
            await asyncio.sleep(0.03)
            second = ExternalContext(name="second")
            starting = asyncio.create_task(kernel.start(second, slow, activate=True))
            await asyncio.sleep(0.01)
            # Observers come and go meanwhile: it is entered by one at a time all the same.
            kernel.bus.subscribe(HookBefore, lambda event: None)()
            await asyncio.gather(tick, starting)
            await asyncio.gather(first.tick(2), second.tick(2))
        assert log[1] == f"first {start} to {start + 100}"
        assert log[2] == f"startup in second at {start + 100}"
        spans = [tuple(map(int, line.split()[1::2])) for line in log if " to " in line]
        assert len(spans) == 5
        assert all(before[1] <= after[0] for before, after in itertools.pairwise(spans))

    simulate(main)
