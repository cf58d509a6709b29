"""`kernel.samples` gives what an out-port writes; the system is with it what it is without."""

from __future__ import annotations

import asyncio
import threading
from pathlib import Path

import pytest
from anyio import fail_after

from aiorts import Component, EventContext, InPort, Kernel, OutPort, PeriodicContext, ThreadContext
from aiorts.errors import BusyError, ClosedError, ConfigurationError, WiringError
from aiorts.observe import Samples
from aiorts.testing import simulate, simulated
from aiorts.types import TimedLong
from reload_files import Source as SourceFile

pytestmark = pytest.mark.row(81)


class Counter(Component):
    count = OutPort(TimedLong)

    def on_initialize(self) -> None:
        self.sent = 0

    def on_execute(self) -> None:
        self.sent += 1
        self.count.write_nowait(TimedLong(0, self.sent))

    def on_deactivated(self) -> None:
        self.count.write_nowait(TimedLong(0, -1))


class Reader(Component):
    count = InPort(TimedLong, length=1000)

    def on_execute(self) -> None:
        self.count.drain()


async def counter(kernel: Kernel, rate: float = 10.0) -> Counter:
    made = await kernel.create(Counter, "counter")
    await kernel.start(PeriodicContext(rate), made, activate=True)
    return made


@simulated
async def test_it_gives_each_sample_from_now_on() -> None:
    async with Kernel() as kernel:
        made = await counter(kernel)
        await kernel.sleep(0.45)
        got = []
        async for sample in kernel.samples(made.count):
            got.append(sample.data)
            if len(got) == 3:
                break
        assert got == [6, 7, 8]


@simulated
async def test_it_begins_with_the_last_one_where_it_is_to_keep_it() -> None:
    async with Kernel() as kernel:
        made = await counter(kernel)
        await kernel.sleep(0.45)
        stream = kernel.samples("counter.count", keep_last=True)
        assert (await anext(stream)).data == made.sent == 5
        assert (await anext(stream)).data == 6


@simulated
async def test_the_system_is_what_it_is_without() -> None:
    async with Kernel() as kernel:
        made, reader = await counter(kernel), await kernel.create(Reader)
        await kernel.connect(made.count, reader.count)
        before = kernel.profile()
        stream = kernel.samples(made.count)
        now = kernel.profile()
        assert (now.components, now.connectors) == (before.components, before.connectors)
        assert [one.in_.path for one in made.count.connectors] == ["reader0.count"]
        await anext(stream)


def test_it_ends_with_the_kernel_and_gives_the_last_sample() -> None:
    async def main() -> list[int]:
        kernel = await Kernel().open()
        made = await counter(kernel)
        stream = kernel.samples(made.count)
        await kernel.sleep(0.25)
        await kernel.aclose()
        assert stream.closed
        return [sample.data async for sample in stream]

    assert simulate(main()) == [2, 3, -1]


def test_a_reader_that_waits_is_woken_by_the_end() -> None:
    async def main() -> list[int]:
        async with Kernel() as kernel:
            made = await counter(kernel)

            async def collect(stream: Samples[TimedLong]) -> list[int]:
                return [sample.data async for sample in stream]

            task = asyncio.create_task(collect(kernel.samples(made.count)))
            await kernel.sleep(0.05)
        return await task

    assert simulate(main()) == [-1]


@simulated
async def test_it_ends_with_its_port() -> None:
    async with Kernel() as kernel:
        made = await counter(kernel)
        port = made.add_port("more", OutPort(TimedLong))
        of_component, of_port = kernel.samples(made.count), kernel.samples("counter.more")
        port.write_nowait(TimedLong(0, 7))
        made.remove_port("more")
        assert [sample.data async for sample in of_port] == [7]
        await kernel.remove(made)
        assert [sample.data async for sample in of_component] == [-1]


@simulated
async def test_what_a_slow_reader_has_no_room_for_is_counted_and_holds_nobody_up() -> None:
    async with Kernel() as kernel:
        made = await counter(kernel)
        small, usual = kernel.samples(made.count, length=3), kernel.samples(made.count)
        await kernel.sleep(9.95)
        assert made.sent == 100
        assert (small.dropped, usual.dropped) == (96, 35)
        assert [(await anext(small)).data for _ in range(3)] == [98, 99, 100]
        assert (await anext(usual)).data == 37


@simulated
async def test_leaving_the_loop_ends_it() -> None:
    async with Kernel() as kernel:
        made = await counter(kernel)
        async for _ in kernel.samples(made.count):
            break
        assert made.count._connectors == ()
        async with kernel.samples(made.count) as stream:
            await anext(stream)
        assert (stream.closed, made.count._connectors) == (True, ())
        stream = kernel.samples(made.count)
        await kernel.sleep(0.2)
        await stream.aclose()
        await stream.aclose()
        assert [sample async for sample in stream] == []


@simulated
async def test_one_that_is_kept_goes_on_after_a_break() -> None:
    async with Kernel() as kernel:
        stream = kernel.samples((await counter(kernel)).count)
        got = []
        for _ in range(2):
            async for sample in stream:
                got.append(sample.data)
                break
        assert got == [2, 3]


@simulated
async def test_one_task_iterates_it() -> None:
    async with Kernel() as kernel:
        made = await kernel.create(Counter)
        stream = kernel.samples(made.count)
        waits = asyncio.ensure_future(anext(stream))
        await asyncio.sleep(0)
        with pytest.raises(BusyError, match=r"counter0\.count: another task iterates these samples"):
            await anext(stream)
        made.count.write_nowait(TimedLong(0, 1))
        assert (await waits).data == 1


@simulated
async def test_a_wait_that_is_cancelled_takes_no_sample() -> None:
    async with Kernel() as kernel:
        made = await kernel.create(Counter)
        stream = kernel.samples(made.count)
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(anext(stream), 1.0)
        made.count.write_nowait(TimedLong(0, 1))
        assert (await anext(stream)).data == 1


@simulated
async def test_what_it_cannot_give_is_refused() -> None:
    async with Kernel() as kernel, Kernel("other") as other:
        made = await kernel.create(Reader)
        with pytest.raises(WiringError, match="is an in-port; look at the out-port"):
            kernel.samples("reader0.count")
        with pytest.raises(WiringError, match="no component 'nobody'"):
            kernel.samples("nobody.count")
        with pytest.raises(WiringError, match=r'await kernel\.stand_in\("far/counter"\)'):
            kernel.samples("far/counter.count")
        for wrong in (made.count, Counter.count, (await other.create(Counter)).count, 7):
            with pytest.raises(WiringError, match="expected an out-port of a component of this kernel"):
                kernel.samples(wrong)  # type: ignore[call-overload]
        await kernel.create(Counter)
        with pytest.raises(ConfigurationError, match="length = 0"):
            kernel.samples("counter0.count", length=0)
        with pytest.raises(ConfigurationError, match="keep_last = 'yes'"):
            kernel.samples("counter0.count", keep_last="yes")  # type: ignore[call-overload]
    with pytest.raises(ClosedError):
        kernel.samples("counter0.count")


@pytest.mark.anyio
async def test_samples_of_a_thread_come_in_order_and_are_all_counted() -> None:
    class Burst(Component):
        out = OutPort(TimedLong)

        def on_execute(self) -> None:
            for number in range(1, 101):
                self.out.write_nowait(TimedLong(0, number))
            self.finish()

    with fail_after(10.0):
        async with Kernel() as kernel:
            burst = await kernel.create(Burst)
            all_of_it, some = kernel.samples(burst.out, length=100), kernel.samples(burst.out, length=5)
            await kernel.start(ThreadContext(), burst, activate=True)
            assert [(await anext(all_of_it)).data for _ in range(100)] == list(range(1, 101))
            got = [(await anext(some)).data for _ in range(5)]
            assert got == sorted(got)
            assert (got[-1], some.dropped) == (100, 95)


@pytest.mark.anyio
async def test_one_that_another_thread_lets_go_ends_on_the_loop() -> None:
    with fail_after(10.0):
        async with Kernel() as kernel:
            made = await kernel.create(Counter)
            held = [kernel.samples(made.count)]
            thread = threading.Thread(target=held.clear)
            thread.start()
            thread.join()
            await asyncio.sleep(0)
            assert made.count._connectors == ()


@pytest.mark.anyio
async def test_it_goes_on_when_code_is_replaced(tmp_path: Path) -> None:
    file = SourceFile(
        tmp_path,
        """
        class Const(Component):
            out = OutPort(TimedLong)
            def on_execute(self) -> None:
                self.out.write_nowait(TimedLong(0, 1))
        """,
    )
    try:
        with fail_after(20.0):
            async with Kernel() as kernel:
                made = await kernel.create(file.get("Const"), "const")
                await kernel.start(PeriodicContext(100.0), made, activate=True)
                stream = kernel.samples("const.out")
                assert (await anext(stream)).data == 1
                file.replace("TimedLong(0, 1)", "TimedLong(0, 2)")
                await kernel.reload(file.get("Const"), cycles=1)
                async for sample in stream:
                    if sample.data == 2:
                        break
                else:
                    pytest.fail("it has ended")
    finally:
        file.forget()


@pytest.mark.anyio
async def test_a_port_that_only_a_tap_reads_writes_as_any_other() -> None:
    with fail_after(10.0):
        async with Kernel() as kernel:
            made = await kernel.create(Counter)
            stream = kernel.samples(made.count, keep_last=True)
            await kernel.start(EventContext(), made, activate=True)
            assert made.count.write_nowait(TimedLong(0, 5))
            assert (await anext(stream)).data == 5
