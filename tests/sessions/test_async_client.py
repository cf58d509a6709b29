"""The client on the running loop: many calls and streams at once, and nothing left of any of them."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import os
import socket
from contextlib import AsyncExitStack
from random import Random
from typing import Any

import pytest
from anyio import fail_after, move_on_after

from aiorts import Component, Kernel
from aiorts.control import Control
from aiorts.errors import AbsentError, AmbiguousError, ClosedError, NoAnswerError, WiringError
from aiorts.sessions import END, AsyncClient, CutOff, Entry, framed
from aiorts.sessions.protocol import NEWEST
from aiorts.sessions.session import WINDOW
from aiorts.types import TimedDouble
from campaign import cases, time_limit
from control_parts import WAIT, controlled, entry_of

pytestmark = pytest.mark.anyio


class Stuck(Component):
    """Waits where it is initialised."""

    async def on_initialize(self) -> None:
        await asyncio.Event().wait()


def taps(kernel: Kernel) -> int:
    """How many connectors there are at counter0.out."""
    return len(kernel.components["counter0"].ports["out"]._connectors)


def write(kernel: Kernel, count: int) -> None:
    """Let counter0 write its next numbers."""
    counter: Any = kernel.components.get("counter0")
    for _ in range(count):
        counter.count += counter.step
        counter.out.write_nowait(TimedDouble(data=counter.count))


def served(operation: str) -> bool:
    """Whether a kernel of this loop is carrying this operation out."""
    return any(task.get_name() == f"aiorts control {operation}" for task in asyncio.all_tasks())


async def until(holds: Any) -> None:
    with fail_after(WAIT):
        while not holds():
            await asyncio.sleep(0.001)


# -- targets -----------------------------------------------------------------------------------------------------------


async def test_a_kernel_is_meant_by_its_name_its_address_its_socket_and_its_entry_or_as_the_only_one() -> None:
    async with controlled("meant"):
        entry = entry_of("meant")
        for target in ("meant", entry.address, entry.path, entry, ""):
            async with AsyncClient.connect(target, timeout=WAIT) as client:
                assert (client.entry.epoch, client.right) == (entry.epoch, "code")
        with pytest.raises(AbsentError, match=r"mean: nothing that runs has this name; did you mean meant\?"):
            await AsyncClient.open("mean")
        async with controlled("other"):
            with pytest.raises(AmbiguousError, match=r"no kernel is named: 2 have this name: .*/meant, .*/other"):
                await AsyncClient.open()
    with pytest.raises(AbsentError, match="nothing runs that can be reached"):
        await AsyncClient.open()
    with pytest.raises(AbsentError, match="is gone"):
        await AsyncClient.open(entry)


# -- calls -------------------------------------------------------------------------------------------------------------


async def test_calls_go_on_at_once_and_each_has_its_own_answer() -> None:
    async with controlled("many"), AsyncClient.connect("many", timeout=WAIT) as client:
        names = ["counter0", "reader0"] * 50
        found = await asyncio.gather(*(client.call("outline", WAIT, components=[name]) for name in names))
    assert [list(one) for one in found] == [[name] for name in names]


async def test_a_call_that_is_cancelled_ends_in_the_kernel() -> None:
    async with controlled("left"), AsyncClient.connect("left", timeout=WAIT) as client:
        asked = asyncio.create_task(client.call("create", None, type=f"{__file__}:Stuck", name="stuck"))
        await until(lambda: served("create"))
        asked.cancel()
        await until(lambda: not served("create"))
        assert (await client.call("names"))["state"] == "open"


async def test_a_kernel_that_does_not_answer_in_time_is_said_to_be_so() -> None:
    ours, theirs = socket.socketpair()
    ours.setblocking(False)
    with theirs:
        theirs.sendall(framed({"hello": {"protocol": NEWEST, "epoch": "ab", "right": "code"}}))
        client = await AsyncClient(Entry("pc/k", 0, "", "")).begin(ours, WAIT)
        with pytest.raises(NoAnswerError, match="pc/k: no answer"):
            await client.call("names", 0.05)
        theirs.sendall(framed({"busy": 1.5}))
        with pytest.raises(NoAnswerError, match=r"its event loop has been busy for at least 1\.5 s"):
            await client.call("names", 0.05)
        await client.aclose()


@pytest.mark.slow
async def test_a_kernel_that_takes_nothing_any_more_holds_no_call_up_and_no_end() -> None:
    ours, theirs = socket.socketpair()
    ours.setblocking(False)
    with theirs:
        theirs.sendall(framed({"hello": {"protocol": NEWEST, "epoch": "ab", "right": "code"}}))
        client = await AsyncClient(Entry("pc/k", 0, "", "")).begin(ours, WAIT)
        said = ""
        with fail_after(WAIT):
            while "does not take what is sent" not in said:
                with pytest.raises(NoAnswerError) as raised:
                    await client.call("names", 0.001, components=["x" * 60_000] * 8)
                said = str(raised.value)
            await client.aclose()
        assert ours.fileno() == -1


# -- streams -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("way", ["break", "cancel", "close", "with", "forgotten"])
async def test_a_stream_that_is_left_ends_in_the_kernel(way: str) -> None:
    async with controlled("left") as kernel, AsyncClient.connect("left", timeout=WAIT) as client:
        usual = taps(kernel)

        async def follow() -> None:
            async for _ in client.stream("tap", WAIT, port="counter0.out"):
                if way == "break":
                    break

        if way in ("break", "cancel"):
            following = asyncio.create_task(follow())
            if way == "cancel":
                await until(lambda: taps(kernel) == usual + 1)
                following.cancel()
            await asyncio.wait([following])
        elif way == "with":
            async with client.stream("tap", WAIT, port="counter0.out") as stream:
                assert taps(kernel) == usual + 1
        else:
            stream = await client.stream("tap", WAIT, port="counter0.out").open()
            assert taps(kernel) == usual + 1
            if way == "close":
                stream.close()
                assert await stream.next() is END
            del stream
            gc.collect()
        await until(lambda: taps(kernel) == usual)
        await until(lambda: not client._session.calls)


async def test_a_stream_that_is_closed_before_it_could_begin_ends_in_the_kernel() -> None:
    async with controlled("early") as kernel, AsyncClient.connect("early", timeout=WAIT) as client:
        usual = taps(kernel)
        client._wire.takes.clear()  # as while the kernel takes nothing
        stream = client.stream("tap", WAIT, port="counter0.out")
        opening = asyncio.create_task(stream.open())
        await asyncio.sleep(0)
        stream.close()
        client._wire.takes.set()
        with pytest.raises(ClosedError, match="closed"):
            await opening
        await client.call("names")  # the kernel has heard all that was sent before
        await until(lambda: taps(kernel) == usual and not client._session.calls)


async def test_a_stream_that_nobody_reads_is_held_up_and_nothing_else_is() -> None:
    async with (
        controlled("held") as kernel,
        AsyncClient.connect("held", timeout=WAIT) as client,
        client.stream("tap", WAIT, port="counter0.out") as slow,
        client.stream("tap", WAIT, port="counter0.out") as fast,
    ):
        last = 0.0
        while last < 2 * WINDOW:
            write(kernel, 20)
            for _ in range(20):
                last = (await fast.next(WAIT))["data"]
        assert fast.missed == 0
        assert (await client.call("names", WAIT))["state"] == "open"
        found = [await slow.next(WAIT) for _ in range(WINDOW)]  # what there was credit for
        first = found[0]["data"]
        assert [one["data"] for one in found] == [first + number for number in range(WINDOW)]
        later = (await slow.next(WAIT))["data"]
        assert slow.missed == later - first - WINDOW > 0  # the kernel says how many it did not send


async def test_a_stream_that_is_closed_while_a_task_waits_for_an_item_is_over_for_it() -> None:
    async with controlled("over"), AsyncClient.connect("over", timeout=WAIT) as client:
        stream = await client.stream("events", WAIT, kinds=["ComponentAdded"]).open()
        waiting = asyncio.create_task(stream.next())
        await asyncio.sleep(0)
        with pytest.raises(RuntimeError, match="two tasks wait for the items of one stream"):
            await stream.next()
        stream.close()
        with fail_after(WAIT):
            assert await waiting is END


async def test_a_stream_ends_as_the_operation_does() -> None:
    async with controlled("over") as kernel, AsyncClient.connect("over", timeout=WAIT) as client:
        async with client.stream("tap", WAIT, port="counter0.out") as stream:
            assert stream.began["port"] == "counter0.out"
            await kernel.remove(kernel.components["counter0"])
            async for item in stream:
                assert item["data"] > 0
        assert (stream.ended, client.is_open) == (True, True)
        with pytest.raises(WiringError):
            await client.stream("tap", WAIT, port="counter0.out").open()


async def test_a_wait_for_an_item_may_be_given_up_and_none_is_lost() -> None:
    async with controlled("patient") as kernel, AsyncClient.connect("patient", timeout=WAIT) as client:
        found: list[float] = []
        async with client.stream("tap", WAIT, port="counter0.out") as stream:
            while len(found) < 10:
                with move_on_after(0.003):
                    found.append((await stream.next())["data"])
            await kernel.deactivate("counter0")
            with contextlib.suppress(NoAnswerError):
                while True:
                    found.append((await stream.next(0.1))["data"])
        assert found == [found[0] + number for number in range(len(found))]


# -- ends --------------------------------------------------------------------------------------------------------------


async def test_the_end_of_the_kernel_ends_all_calls_and_streams() -> None:
    async with AsyncExitStack() as stack:
        await stack.enter_async_context(controlled("ending"))
        async with AsyncClient.connect("ending", timeout=WAIT) as client:
            lost: list[int] = []
            client.lost = lambda: lost.append(1)
            asked = asyncio.create_task(client.call("create", None, type=f"{__file__}:Stuck", name="stuck"))
            await until(lambda: served("create"))
            stream = await client.stream("log", WAIT, follow=True).open()
            await stack.aclose()
            with fail_after(WAIT):
                with pytest.raises((ClosedError, AbsentError)):
                    await asked
                assert [one async for one in stream] == []
                await until(lambda: not client.is_open)
                with pytest.raises(ClosedError, match="/ending: has ended"):
                    await client.call("names")
            assert lost == [1]


async def test_a_client_that_is_cut_off_by_a_kernel_that_runs_on_is_told_so() -> None:
    async with controlled("cutting") as kernel, AsyncClient.connect("cutting", timeout=WAIT) as client:
        listener = kernel.service(Control)._listener
        assert listener is not None
        stream = await client.stream("log", WAIT, follow=True).open()
        (connection,) = listener._connections
        connection.closed = True  # as for one that takes nothing for too long
        with pytest.raises(CutOff, match="runs on, and has cut off this process"):
            await stream.next(WAIT)


async def test_after_its_end_nothing_is_asked() -> None:
    async with controlled("closed") as kernel:
        client = await AsyncClient.open("closed", timeout=WAIT)
        asked = asyncio.create_task(client.call("names", WAIT))
        waiting = asyncio.create_task(client.stream("log", WAIT, follow=True).open())
        await asyncio.sleep(0)
        await client.aclose()
        await client.aclose()
        for one in (asked, waiting):
            with fail_after(WAIT), pytest.raises(ClosedError, match="the session was closed"):
                await one
        with pytest.raises(ClosedError):
            await client.call("names")
        assert not kernel.closed


# -- any order ---------------------------------------------------------------------------------------------------------


class Schedule:
    """Calls and streams of one client, and what happens to them, in an order that a number decides."""

    def __init__(self, seed: int) -> None:
        self.chosen = Random(seed)
        self.over = False
        """Whether this end or the kernel has ended the session."""

    async def run(self) -> None:
        async with AsyncExitStack() as stack:
            kernel = await stack.enter_async_context(controlled("any"))
            usual = taps(kernel)
            self.client = client = await AsyncClient.open("any", timeout=WAIT)
            under_way = [asyncio.create_task(self._use(client)) for _ in range(self.chosen.randrange(1, 8))]
            for _ in range(self.chosen.randrange(1, 12)):
                what = self.chosen.choice(("cancel", "write", "write", "wait", "wait", "more"))
                if what == "cancel":
                    self.chosen.choice(under_way).cancel()
                elif what == "write":
                    write(kernel, self.chosen.choice((1, 50, 600)))
                elif what == "more":
                    under_way.append(asyncio.create_task(self._use(client)))
                await self._rest()
            how = self.chosen.choice(("close", "end", "end and close", "in order"))
            self.over = how != "in order"
            if "end" in how:
                await stack.aclose()
            if "close" in how:
                await client.aclose()
            with fail_after(WAIT):
                while not all(one.done() for one in under_way):
                    write(kernel, 0 if kernel.closed else 10)
                    await self._rest()
            for one in under_way:
                assert one.cancelled() or one.result() is None
            if how == "in order":
                assert (await client.call("names", WAIT))["state"] == "open"
                await until(lambda: taps(kernel) == usual)
                await until(lambda: not client._session.calls)
            await client.aclose()
        async with controlled("any"), AsyncClient.connect("any", timeout=WAIT) as again:
            assert (await again.call("names", WAIT))["state"] == "open"

    async def _use(self, client: AsyncClient) -> None:
        how = self.chosen.choice(("calls", "calls", "glances", "reads", "reads slowly", "reads nothing"))
        try:
            if how == "calls":
                for _ in range(self.chosen.randrange(1, 6)):
                    name = self.chosen.choice(("counter0", "reader0"))
                    assert list(await client.call("outline", WAIT, components=[name])) == [name]
                    await self._rest()
            elif how == "glances":
                await self._glance(client)
            else:
                await self._follow(client, how)
        except ClosedError:
            assert self.over

    async def _follow(self, client: AsyncClient, how: str) -> None:
        left, last, missed = self.chosen.randrange(1, 200), 0.0, 0
        async with client.stream("tap", WAIT, port="counter0.out") as stream:
            async for item in stream:
                if last:
                    assert item["data"] - last - 1 == stream.missed - missed
                last, missed = item["data"], stream.missed
                if how == "reads nothing":
                    await asyncio.sleep(0.05)
                    break
                if how == "reads slowly":
                    await self._rest()
                left -= 1
                if not left:
                    return

    async def _glance(self, client: AsyncClient) -> None:
        left = self.chosen.randrange(1, 20)
        async for _ in client.stream("tap", WAIT, port="counter0.out"):
            await self._rest()
            left -= 1
            if not left:
                break

    async def _rest(self) -> None:
        await asyncio.sleep(self.chosen.choice((0, 0, 0.0005, 0.003)))


@pytest.mark.slow(kept_by="first")
@pytest.mark.timeout(time_limit(1200))
@pytest.mark.parametrize("part", range(4))
async def test_in_any_order_no_answer_is_lost_and_nothing_is_left(part: int) -> None:
    tasks, descriptors = asyncio.all_tasks(), None
    for seed in range(part, cases(1_000), 4):
        await Schedule(seed).run()
        await asyncio.sleep(0)
        assert asyncio.all_tasks() == tasks, seed
        descriptors = descriptors or sorted(os.listdir("/proc/self/fd"))
        assert sorted(os.listdir("/proc/self/fd")) == descriptors, seed
