"""Ports of components in processes of their own: looked at by tools, recorded, and connected with one another."""

from __future__ import annotations

import asyncio
import json
import os
import signal
from pathlib import Path
from typing import Any

import pytest

from aiorts import EventContext, Kernel, KernelService, PeriodicContext
from aiorts.errors import StateError, WiringError
from aiorts.links import Links
from aiorts.model.links.negotiation import NegotiationState
from aiorts.types import TimedLong
from aiorts_log import RecordingReader
from aiorts_log.recorder.beside import Beside
from control_parts import commanded
from isolation.isolated_parts import Asked, Careful, OneByOne, Scale, Single, Sink, Source, Ticker
from isolation.test_isolated import ERROR, answer, chain, until

pytestmark = pytest.mark.anyio
fault, row = pytest.mark.fault, pytest.mark.row


class Looker(KernelService):
    """Takes what a port sends."""

    name = "looker"


@pytest.mark.slow(kept_by="isolation/test_isolated.py::test_it_looks_like_any_other_and_runs_in_a_process_of_its_own")
@row("51")
async def test_a_tap_sees_every_sample_and_the_system_does_not_know() -> None:
    async with Kernel() as kernel:
        source, scale, sink, _ = await chain(kernel)
        before = kernel.profile().structure().to_json()
        looker, seen, other = kernel.service(Looker), list[int](), list[int]()
        tap = kernel.connections.tap(
            looker, scale.out, lambda port: seen.extend(one.data for one in port.drain()), length=100
        )
        two = kernel.connections.tap(
            looker, scale.out, lambda port: other.extend(one.data for one in port.drain()), length=100
        )
        await until(lambda: all(map(kernel.service(Links).ends.offered.name_of, _links(kernel, tap, two))))
        assert [await answer(source, sink, value) for value in range(20)] == list(range(0, 40, 2))
        await until(lambda: len(seen) == len(other) == 20)
        assert seen == other == list(range(0, 40, 2))
        assert kernel.profile().structure().to_json() == before
        assert set(kernel.service(Links).report()) == {"source.out-scale.inp", "scale.out-sink.inp"}
        assert (tap.statistics.written, tap.statistics.delivered, tap.statistics.balanced) == (20, 20, True)
        assert (await kernel.service(Links).ledger(tap)).unexplained == 0
        os.kill(scale.pid, signal.SIGKILL)
        await until(lambda: scale.state is ERROR)
        await scale.context.reset()
        await scale.context.activate()
        await until(lambda: _up(kernel, tap))
        assert await answer(source, sink, 4) == 8
        await until(lambda: seen[-1] == 8)
        tap.close()
        two.close()
        await answer(source, sink, 5)
        assert (seen[-1], len(kernel.service(Links).ends.readers)) == (8, 1)


def _links(kernel: Kernel, *connectors: Any) -> list[Any]:
    return [kernel.service(Links).ends.readers[one] for one in connectors]


def _up(kernel: Kernel, connector: Any) -> bool:
    return all(end.negotiation.state is NegotiationState.UP for end in kernel.service(Links).ends.of(connector))


@pytest.mark.slow(kept_by="isolation/test_isolated.py::test_it_looks_like_any_other_and_runs_in_a_process_of_its_own")
async def test_an_injected_sample_arrives_there_and_takes_no_place() -> None:
    async with Kernel() as kernel:
        _source, scale, sink, _ = await chain(kernel)
        looker = kernel.service(Looker)
        one = kernel.connections.inject(looker, scale.inp, {"length": 8, "full": "reject"})
        two = kernel.connections.inject(looker, scale.inp, {"length": 8, "full": "reject"})
        assert (one.out.write_nowait(TimedLong(0, 7)), two.out.write_nowait(TimedLong(0, 8))) == (True, True)
        assert {(await sink.inp.read(timeout=5)).data for _ in range(2)} == {14, 16}
        await until(lambda: one.statistics.acknowledged == 1)
        assert (len(scale.inp.connectors), one.statistics.balanced) == (1, True)
        one.close()
        two.close()
        assert len(kernel.service(Links).ends.writers) == 1


@pytest.mark.slow(kept_by="isolation/test_isolated.py::test_it_looks_like_any_other_and_runs_in_a_process_of_its_own")
async def test_what_it_sends_is_recorded_from_its_first_sample(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    async with Kernel(services={"record": {"file": str(path)}}) as kernel:
        ticker = await kernel.create_isolated(Ticker, "ticker")
        context = await kernel.start(PeriodicContext(rate=200.0), ticker)
        await context.activate()
        await until(lambda: ticker.has_finished)
        assert kernel.service(Beside).report()["ports"] == 1
    with RecordingReader(path) as reader:
        assert [record.data for _, _, record in reader.records()] == list(range(1, 21))


@pytest.mark.slow(kept_by="isolation/test_isolated.py::test_it_looks_like_any_other_and_runs_in_a_process_of_its_own")
async def test_commands_print_and_measure_what_it_sends(capsys: pytest.CaptureFixture[str]) -> None:
    async with Kernel(services={"control": {"name": "unit"}}) as kernel:
        source, _scale, sink, _ = await chain(kernel)
        status, text = await commanded(capsys, "inject", "scale.inp", "21", "--count", "2")
        assert (status, [(await sink.inp.read(timeout=20)).data for _ in range(2)]) == (0, [42, 42]), text
        printed = asyncio.create_task(commanded(capsys, "print", "scale.out", "--count", "2"))
        await until(lambda: any(one.out.path == "scale.out" for one in _taps(kernel)))
        await until(lambda: all(_up(kernel, one) for one in _taps(kernel)))
        assert [await answer(source, sink, value) for value in (1, 2)] == [2, 4]
        status, text = await printed
        assert (status, [json.loads(line)["data"] for line in text.splitlines()]) == (0, [2, 4])


def _taps(kernel: Kernel) -> list[Any]:
    return [one for one in kernel.service(Links).ends.readers if one.in_.is_tap]


@pytest.mark.slow(kept_by="isolation/test_isolated.py::test_it_looks_like_any_other_and_runs_in_a_process_of_its_own")
@row("51")
@fault("A13")
async def test_two_in_processes_of_their_own_are_connected_and_survive_the_end_of_either() -> None:
    async with Kernel() as kernel:
        source, sink = await kernel.add(Source("source")), await kernel.add(Sink("sink"))
        one, two = [await kernel.create_isolated(Scale, name) for name in ("one", "two")]
        between = await kernel.connect("one.out", "two.inp", length=100)
        await kernel.connect(source.out, "one.inp", length=100)
        await kernel.connect("two.out", sink.inp, length=100)
        contexts = [await kernel.start(EventContext(), each, activate=True) for each in (one, two)]
        assert await answer(source, sink, 3) == 12
        assert (between.name, between.profile.ports) == ("one.out-two.inp", ("one.out", "two.inp"))
        assert (one.out.connectors, two.inp.connectors) == ((between,), (between,))
        with pytest.raises(WiringError, match=r"one.out -> two.inp: connected already"):
            await kernel.connect(one.out, two.inp)
        for each, context in zip((one, two), contexts, strict=True):
            os.kill(each.pid, signal.SIGKILL)
            await until(lambda each=each: each.state is ERROR)
            await context.reset()
            await context.activate()
            await until(lambda: all(_up(kernel, connector) for connector in kernel.connectors.values()))
            assert await answer(source, sink, 5) == 20
        ledger = await kernel.service(Links).ledger(between)
        assert (ledger.written, ledger.unexplained, between.statistics.balanced) == (3, 0, True), str(ledger)
        assert "up" in kernel.service(Links).report()[between.name]
        between.close()
        await until(lambda: len(kernel.service(Links).ends.all()) == 2)
        source.out.write_nowait(TimedLong(0, 1))
        await until(lambda: kernel.connectors["source.out-one.inp"].statistics.in_flight == 0)
        await kernel.connect(one.out, two.inp, name="again", length=4, full="reject")
        assert await answer(source, sink, 5) == 20


@pytest.mark.slow(kept_by="isolation/test_isolated.py::test_it_looks_like_any_other_and_runs_in_a_process_of_its_own")
@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"dataflow": "pull"}, "dataflow = pull: both ends are in other processes"),
        ({"subscription": "periodic", "push_rate": 5.0}, "subscription = periodic: the writer is in another kernel"),
    ],
)
async def test_what_such_a_connector_cannot_do_is_refused(options: dict[str, Any], said: str) -> None:
    async with Kernel() as kernel:
        for name in ("one", "two"):
            await kernel.create_isolated(Scale, name)
        with pytest.raises(WiringError, match=f"one.out -> two.inp: {said}"):
            await kernel.connect("one.out", "two.inp", **options)


@pytest.mark.slow(kept_by="isolation/test_isolated.py::test_it_looks_like_any_other_and_runs_in_a_process_of_its_own")
async def test_a_port_there_takes_as_many_connectors_as_it_says_without_those_of_tools() -> None:
    async with Kernel() as kernel:
        source, other = await kernel.add(Source("source")), await kernel.add(Source("other"))
        single = await kernel.create_isolated(Single, "single")
        await kernel.connect(source.out, single.inp)
        kernel.connections.inject(kernel.service(Looker), single.inp, {"length": 8})
        with pytest.raises(WiringError, match=r"single.inp: takes 1 connectors at the most, has 1"):
            await kernel.connect(other.out, single.inp)


@pytest.mark.slow(kept_by="isolation/test_isolated.py::test_it_looks_like_any_other_and_runs_in_a_process_of_its_own")
async def test_the_process_of_the_writer_does_what_the_writers_end_does_alone() -> None:
    async with Kernel() as kernel:
        source, every, sink = [await kernel.add(kind(name)) for kind, name in
                               ((Source, "source"), (Sink, "every"), (Sink, "sink"))]  # fmt: skip
        scale: Any = await kernel.create_isolated(Scale, "scale")
        await kernel.connect(source.ports["out"], scale.inp, length=100)
        skipped = await kernel.connect(scale.out, sink.ports["inp"], push="skip", skip=1, stamp="send")
        paced = await kernel.connect(scale.out, every.ports["inp"], subscription="periodic", push_rate=20.0, push="all")
        await kernel.start(EventContext(), scale, activate=True)
        for value in range(6):
            source.ports["out"].write_nowait(TimedLong(7, value))
        await until(lambda: skipped.statistics.written == 3)
        samples = sink.ports["inp"].drain()
        assert [one.data for one in samples] == [2, 6, 10]
        assert all(one.tm > 1_000 for one in samples)
        periodic = [(await every.ports["inp"].read(timeout=5)).data for _ in range(6)]
        assert periodic == list(range(0, 12, 2))
        assert skipped.profile.push == "skip"
        with pytest.raises(StateError, match="push_rate: its period is in the process of the writer"):
            paced.change(push_rate=1.0)


async def flushed(kernel: Kernel, **options: Any) -> tuple[Any, ...]:
    """source -> careful, in a process -> asked, in another one -> sink, active; the middle connector is flush."""
    source, ask = await kernel.add(Source("source")), await kernel.add(Source("ask"))
    said, sink = await kernel.add(Sink("said")), await kernel.add(Sink("sink"))
    careful: Any = await kernel.create_isolated(Careful, "careful")
    asked: Any = await kernel.create_isolated(Asked, "asked")
    between = await kernel.connect(careful.out, asked.inp, subscription="flush", timeout=60.0, **options)
    await kernel.connect(source.out, careful.inp, length=100)
    await kernel.connect(ask.out, asked.ask, length=100)
    await kernel.connect(careful.taken, said.inp, length=100)
    await kernel.connect(asked.out, sink.inp, length=100)
    for each in (careful, asked):
        await kernel.start(EventContext(), each, activate=True)
    return source, ask, said, sink, careful, asked, between


@pytest.mark.slow
async def test_a_flush_is_over_when_the_reader_in_the_other_process_has_the_sample_or_refuses_it() -> None:
    async with Kernel() as kernel:
        source, ask, said, sink, *_, between = await flushed(kernel, length=1, full="reject")
        assert [await answer(source, said, value) for value in (1, 2)] == [1, -2]
        ledger = await kernel.service(Links).ledger(between)
        counts = (ledger.written, ledger.buffered, ledger.in_flight, dict(ledger.dropped), ledger.unexplained)
        assert counts == (2, 1, 0, {"rejected": 1}, 0), str(ledger)
        assert await answer(ask, sink, 0) == 1
        assert await answer(source, said, 3) == 3


@pytest.mark.slow
async def test_a_flush_waits_for_room_at_the_reader_in_the_other_process() -> None:
    async with Kernel() as kernel:
        source, ask, said, sink, *_, between = await flushed(kernel, length=1, full="block")
        assert await answer(source, said, 1) == 1
        source.out.write_nowait(TimedLong(0, 2))
        await until(lambda: between.statistics.in_flight == 1)
        ledger = await kernel.service(Links).ledger(between)
        assert (ledger.written, ledger.buffered, ledger.in_flight, ledger.unexplained) == (2, 2, 0, 0), str(ledger)
        assert said.inp.drain() == []
        assert await answer(ask, sink, 0) == 1
        assert (await said.inp.read(timeout=5)).data == 2
        assert await answer(ask, sink, 0) == 2
        ledger = await kernel.service(Links).ledger(between)
        assert (ledger.written, ledger.delivered, ledger.unexplained) == (2, 2, 0), str(ledger)


@pytest.mark.slow
@row("51")
@fault("A13")
async def test_a_flush_goes_on_when_either_process_was_killed_in_it() -> None:
    async with Kernel() as kernel:
        source, ask, said, sink, careful, asked, between = await flushed(kernel, length=1, full="block")
        value = 0
        for victims in ((asked,), (careful,), (asked,), (careful,), (careful, asked)):
            for _ in range(2):  # one lies there, one waits
                value += 1
                source.out.write_nowait(TimedLong(0, value))
            await until(lambda: between.statistics.in_flight == 1)
            for victim in victims:
                os.kill(victim.pid, signal.SIGKILL)
            for victim in victims:
                await until(lambda victim=victim: victim.state is ERROR)
                await victim.context.reset()
                await victim.context.activate()
            await until(lambda: all(_up(kernel, connector) for connector in kernel.connectors.values()))
            await emptied(kernel, ask, between)
            said.inp.drain(), sink.inp.drain()
            assert between.statistics.balanced
        value += 1
        assert await answer(source, said, value) == value
        assert await answer(ask, sink, 0) == value
        ledger = await kernel.service(Links).ledger(between)
        assert (ledger.unexplained, ledger.in_flight, ledger.buffered) == (0, 0, 0), str(ledger)
        # Of those on their way to a reader that was killed, it is said that nobody knows.
        assert set(ledger.dropped) <= {"unknown_fate"}, str(ledger)


async def emptied(kernel: Kernel, ask: Any, between: Any) -> None:
    """Have the reader take what it has, until nothing is on its way."""
    while (ledger := await kernel.service(Links).ledger(between)).buffered + ledger.in_flight:
        assert ledger.unexplained == 0, str(ledger)
        for _ in range(ledger.buffered):
            ask.out.write_nowait(TimedLong(0, 0))
        await asyncio.sleep(0.1)


@pytest.mark.anyio
async def test_one_that_ends_with_its_kernel_reads_what_was_written_and_what_it_writes_last_is_read() -> None:
    class Last(Sink):
        def on_execute(self) -> None:
            seen.extend(sample.data for sample in self.inp.drain())

    seen: list[int] = []
    async with Kernel() as kernel:
        source, last = await kernel.add(Source("source")), await kernel.add(Last("last"))
        apart = await kernel.create_isolated(OneByOne, "apart")
        await kernel.connect(source.out, "apart.inp", length=1000)
        await kernel.connect("apart.out", last.inp)
        await kernel.start(EventContext(), last, activate=True)
        await kernel.start(EventContext(name="apart"), apart, activate=True)
        for number in range(200):
            source.out.write_nowait(TimedLong(0, number))
    assert seen == [200]
