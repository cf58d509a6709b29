"""Samples lost at a connector with default options are said once, then counted; who chose to lose some is not told."""

from __future__ import annotations

import logging
from typing import Any

import pytest

from aiorts import (
    Component,
    Connector,
    EventPort,
    InPort,
    Kernel,
    KernelService,
    OutPort,
    PeriodicContext,
    StateMachineComponent,
    Supervision,
    ThreadContext,
)
from aiorts.errors import SLOW_READER
from aiorts.events import Connected
from aiorts.statechart import Chart, On, State
from aiorts.testing import MemoryNetwork, simulated
from aiorts.types import TimedLong
from links.memory_kernels import kernel_of, until


class Source(Component):
    out = OutPort(TimedLong)


class Sink(Component):
    inp = InPort(TimedLong)


class Blocking(Component):
    """In a thread of its own; takes nothing."""

    inp = InPort(TimedLong)


def lines(caplog: pytest.LogCaptureFixture) -> list[str]:
    """What was said since the last time."""
    said = [record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING]
    caplog.clear()
    return said


async def connected(kernel: Kernel, **options: Any) -> tuple[Source, Sink, Connector]:
    source, sink = await kernel.create(Source), await kernel.create(Sink)
    return source, sink, await kernel.connect(source.out, sink.inp, **options)


def write(source: Source, count: int) -> None:
    for number in range(count):
        assert source.out.write_nowait(TimedLong(0, number))


@pytest.mark.parametrize("readers", [1, 2], ids=["one writer", "two writers"])
@simulated
async def test_the_first_is_said_at_once_and_more_are_counted_ever_rarer(
    readers: int, caplog: pytest.LogCaptureFixture
) -> None:
    async with Kernel() as kernel:
        source, sink, connector = await connected(kernel)
        if readers == 2:  # what comes through both is kept in the order of arrival
            await kernel.connect((await kernel.create(Source)).out, sink.inp)
        write(source, 8)
        await kernel.sleep(60.0)
        assert lines(caplog) == []
        write(source, 1)
        assert lines(caplog) == []  # no log handler runs inside a write
        await kernel.sleep(0.0)
        (line,) = lines(caplog)
        assert line.startswith(
            f"{source.out.path} -> {sink.inp.path}: 1 sample lost so far: overwritten, the reader is slower"
        )
        assert line.endswith(SLOW_READER)
        write(source, 100)
        await kernel.sleep(9.9)
        assert lines(caplog) == []
        await kernel.sleep(0.2)
        assert lines(caplog) == [f"{source.out.path} -> {sink.inp.path}: 100 samples more lost"]
        write(source, 1)
        await kernel.sleep(19.8)
        assert lines(caplog) == []
        await kernel.sleep(0.2)
        assert lines(caplog) == [f"{source.out.path} -> {sink.inp.path}: 1 sample more lost"]
        await kernel.sleep(40.0)  # nothing was lost: the next one is the first again
        assert lines(caplog) == []
        write(source, 3)
        await kernel.sleep(0.0)
        assert "105 samples lost so far: overwritten" in lines(caplog)[0]
        write(source, 5)
        assert connector.statistics.dropped == {"overwritten": 110}
    assert lines(caplog) == [f"{source.out.path} -> {sink.inp.path}: 5 samples more lost"]


@pytest.mark.parametrize(
    "options",
    [
        {"length": 8},
        {"full": "overwrite"},
        {"push": "all"},
        {"dataport.inport.buffer.length": 8},
        {"dataport.buffer.write.full_policy": "overwrite"},
        {"subscription": "new"},
        {"subscription": "periodic", "push_rate": 1.0},
        {"dataflow": "pull"},
    ],
    ids=repr,
)
@simulated
async def test_who_chose_what_is_lost_hears_nothing(options: dict[str, Any], caplog: pytest.LogCaptureFixture) -> None:
    async with Kernel() as kernel:
        source, _, connector = await connected(kernel, **options)
        write(source, 20)
        await kernel.sleep(60.0)
        assert connector.statistics.dropped
    assert lines(caplog) == []


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"out_length": 5},
        {"dataport.outport.buffer.length": 5},
        {"push": "new"},
        {"dataport.publisher.push_policy": "new"},
    ],
    ids=repr,
)
@simulated
async def test_other_options_change_nothing(options: dict[str, Any], caplog: pytest.LogCaptureFixture) -> None:
    async with Kernel() as kernel:
        source, _, _ = await connected(kernel, name="wire", stamp="send", subscription="flush", length=None, **options)
        lines(caplog)
        write(source, 9)
        await kernel.sleep(0.0)
        assert len(lines(caplog)) == 1


@simulated
async def test_of_many_connectors_a_few_are_named(caplog: pytest.LogCaptureFixture) -> None:
    async with Kernel() as kernel:
        made = [await connected(kernel) for _ in range(30)]
        for source, *_ in made:
            write(source, 9)
        await kernel.sleep(0.0)
        assert len(lines(caplog)) == 8
        await kernel.sleep(10.5)
        assert lines(caplog) == ["kernel: 22 more connectors lost samples; kernel.connectors has each"]


@pytest.mark.anyio
async def test_a_loss_at_a_thread_is_said_too(caplog: pytest.LogCaptureFixture) -> None:
    async with Kernel() as kernel:
        source, blocking = await kernel.create(Source), await kernel.create(Blocking)
        await kernel.connect(source.out, blocking.inp)
        await kernel.start(ThreadContext(100.0), blocking, activate=True)
        write(source, 20)
        await kernel.sleep(0.0)
        await kernel.sleep(0.0)
        assert "12 samples lost so far: overwritten" in lines(caplog)[0]


class Deep(Component):
    inp = InPort(TimedLong, length=8)


@simulated
async def test_a_length_that_the_port_declares_was_chosen(caplog: pytest.LogCaptureFixture) -> None:
    async with Kernel() as kernel:
        source, deep, plain = [await kernel.create(kind) for kind in (Source, Deep, Sink)]
        await kernel.connect(source.out, deep.inp, plain.inp)
        write(source, 20)
        await kernel.sleep(0.0)
        (line,) = lines(caplog)
        assert line.startswith(f"{source.out.path} -> {plain.inp.path}: 12 samples lost so far")


class Told(StateMachineComponent):
    knock = EventPort(TimedLong)
    chart = Chart(State("only", On("knock", to="only"), initial=True))


@pytest.mark.slow
@simulated
async def test_events_that_find_no_room_are_told_by_their_machine_alone(caplog: pytest.LogCaptureFixture) -> None:
    async with Kernel() as kernel:
        source, told = await kernel.create(Source), await kernel.create(Told)
        await kernel.connect(source.out, told.knock)
        await kernel.start(PeriodicContext(100.0), told, activate=True)
        write(source, 9000)
        await kernel.sleep(1.0)
        (line,) = lines(caplog)
        assert "808 events were dropped: more than 8192 waited" in line


class Failing(Source):
    made = 0

    def on_initialize(self) -> None:
        type(self).made += 1

    def on_execute(self) -> None:
        if self.made == 1:
            write(self, 20)  # told soon: not yet when its place is noted
            raise ValueError("this one only")


@pytest.mark.parametrize("options", [{}, {"length": 8}], ids=["", "chosen"])
@simulated
async def test_what_is_lost_after_a_restart_is_told_as_before(
    options: dict[str, Any], caplog: pytest.LogCaptureFixture
) -> None:
    class Once(Failing):
        """Its own count."""

    async with Kernel() as kernel:
        source, sink = await kernel.create(Once), await kernel.create(Sink)
        before = await kernel.connect(source.out, sink.inp, name="wire", **options)
        kernel.supervise(source, Supervision("restart"))
        await kernel.start(PeriodicContext(100.0), source, activate=True)
        await kernel.sleep(5.0)
        assert kernel.connectors["wire"] is not before
        lines(caplog)
        new: Any = kernel.components[source.name]
        write(new, 20)
        await kernel.sleep(0.0)
        assert [line.partition(": ")[2][:22] for line in lines(caplog)] == (
            [] if options else ["12 samples lost so far"]
        )


# -- samples that come before their reader ever was active -----------------------------------------------------------

EARLY = (
    "W-INACTIVE: source0.out -> sink0.inp: the first sample was dropped, sink0 was not active yet: connect with "
    'keep_last = true, or have the writer start later (start.after = "sink0 active"); further ones are counted in '
    "connector.statistics"
)


@pytest.mark.parametrize("before", ["the context", "the activation"])
@simulated
async def test_the_first_sample_that_came_too_early_is_said_with_the_cure(
    before: str, caplog: pytest.LogCaptureFixture
) -> None:
    async with Kernel() as kernel:
        source, sink, connector = await connected(kernel)
        others = [await kernel.create(Source) for _ in range(2)]
        await kernel.connect(others[0].out, others[1].out, sink.inp)
        if before == "the context":
            write(source, 1)
        context = await kernel.start(PeriodicContext(rate=10.0), sink)
        if before == "the activation":
            write(source, 2)
        write(others[0], 1)  # in the same turn
        await kernel.sleep(1.0)
        assert lines(caplog) == [EARLY]
        write(source, 3)
        write(others[1], 1)
        await kernel.sleep(1.0)
        assert lines(caplog) == []  # once is enough
        await context.activate(sink)
        assert connector.statistics.dropped == {"inactive": 4 if before == "the context" else 5}
        assert [one.statistics.dropped["inactive"] for one in kernel.connectors.values()][1:] == [1, 1]


class Tool(KernelService):
    """Writes to an in-port, beside the system."""

    name = "tool"


@pytest.mark.parametrize(
    "why", ["was active", "keeps the last", "joins readers", "joins a stream", "hears a tool", "others follow"]
)
@simulated
async def test_what_no_component_waits_for_is_not_said(why: str, caplog: pytest.LogCaptureFixture) -> None:
    async with Kernel() as kernel:
        source, sink = await kernel.create(Source), await kernel.create(Sink)
        if why == "joins readers":
            other = await kernel.create(Sink)
            await kernel.connect(source.out, other.inp)
            await kernel.start(PeriodicContext(rate=10.0), other, activate=True)
            write(source, 1)
            assert other.inp.read_nowait().data == 0
        elif why == "joins a stream":
            write(source, 1)
        context = await kernel.start(PeriodicContext(rate=10.0), sink, activate=why == "was active")
        connector = await kernel.connect(source.out, sink.inp, keep_last=why == "keeps the last")
        if why == "was active":
            await context.deactivate(sink)
        if why == "hears a tool":
            connector = kernel.connections.inject(kernel.service(Tool), sink.inp, {"length": 8})
            assert connector.out.write_nowait(TimedLong(0, 0))
            assert connector.out.write_nowait(TimedLong(0, 1))
        else:
            write(source, 2)
        if why == "others follow":
            await context.activate(sink)
            write(source, 1)
            assert sink.inp.read_nowait().data == 0
        await kernel.sleep(1.0)
        assert connector.statistics.dropped["inactive"] == 2
    assert lines(caplog) == []


@simulated
async def test_what_comes_while_the_kernel_closes_comes_too_late_and_not_too_early(
    caplog: pytest.LogCaptureFixture,
) -> None:
    class Parting(Source):
        def on_deactivated(self) -> None:
            write(self, 1)

    async with Kernel() as kernel:
        source, sink = await kernel.create(Parting), await kernel.create(Sink)
        connector = await kernel.connect(source.out, sink.inp)
        await kernel.start(PeriodicContext(rate=10.0), sink)
        await kernel.start(PeriodicContext(rate=10.0), source, activate=True)
    assert (connector.statistics.dropped, lines(caplog)) == ({"inactive": 1}, [])


@simulated
async def test_of_a_link_the_readers_kernel_says_it_with_the_cure_that_it_has(caplog: pytest.LogCaptureFixture) -> None:
    """No rule for the start of a component names one of another kernel."""
    network = MemoryNetwork()
    async with kernel_of(network, "one") as one, kernel_of(network, "two") as two:
        source, sink = await one.create(Source), await two.create(Sink)
        connector = await two.connect(sink.inp, "one/source0.out")
        await two.start(PeriodicContext(rate=10.0), sink)
        write(source, 2)
        await until(lambda: connector.statistics.dropped.get("inactive") == 2)
        await two.sleep(0.1)
    assert lines(caplog) == [
        "W-INACTIVE: one/source0.out -> sink0.inp: the first sample was dropped, sink0 was not active yet: connect "
        "with keep_last = true; further ones are counted in connector.statistics"
    ]


@simulated
async def test_a_restarted_reader_is_none_that_was_not_active_yet(caplog: pytest.LogCaptureFixture) -> None:
    class Once(Sink):
        failed = False

        def on_execute(self) -> None:
            if not Once.failed:
                Once.failed = True
                raise ValueError("once")

    async with Kernel() as kernel:
        source, sink = await kernel.create(Source), await kernel.create(Once)
        await kernel.connect(source.out, sink.inp, name="wire")
        kernel.supervise(sink, Supervision(restart="restart", backoff=0.1))
        await kernel.start(PeriodicContext(rate=100.0), sink, activate=True)
        kernel.bus.subscribe(Connected, lambda _event: write(source, 1))  # before the new one is active
        await kernel.sleep(1.0)
        assert kernel.components[sink.name] is not sink
        new: Any = kernel.connectors["wire"]
        assert new.statistics.dropped == {"inactive": 1}
    assert [line for line in lines(caplog) if "W-INACTIVE" in line] == []
