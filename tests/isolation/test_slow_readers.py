"""A slow reader in a process of its own: its connector's policy bounds what waits ahead of it, as in one process."""

from __future__ import annotations

import json
import time
from typing import Any

import pytest
from anyio import create_task_group, fail_after, sleep

from aiorts import EventContext, Kernel
from aiorts.links import Links
from aiorts.types import TimedLong
from control_parts import commanded
from isolation.isolated_parts import Aged, Sink, Source

pytestmark = pytest.mark.anyio
kept = pytest.mark.slow(kept_by="test_what_a_reader_in_a_process_loses_is_known_here_by_reason")


async def _aged(kernel: Kernel, *, blocks: bool = False, **options: Any) -> tuple[Source, Sink, Any]:
    """source -> reader, slow and in a process -> sink, active; and the connector to the reader."""
    source, sink = await kernel.add(Source("source")), await kernel.add(Sink("sink"))
    reader = await kernel.create_isolated(Aged, "reader", blocks=blocks)
    connector = await kernel.connect(source.out, "reader.inp", **options)
    await kernel.connect("reader.out", sink.inp)
    await kernel.start(EventContext(name="apart"), reader, activate=True)
    return source, sink, connector


async def _ledger(kernel: Kernel, connector: Any) -> Any:
    """Of both ends, when the reader has ended: it would read the rest, one sample in 50 ms, as its kernel ends."""
    ledger = await kernel.service(Links).ledger(connector)
    await kernel.contexts["apart"].deactivate()
    return ledger


@kept
@pytest.mark.parametrize("blocks", [False, True], ids=["waits", "blocks its process"])
async def test_what_a_slow_reader_in_a_process_reads_is_as_new_as_its_buffer_is_long(blocks: bool) -> None:
    async with Kernel() as kernel:
        source, sink, connector = await _aged(kernel, blocks=blocks)
        for value in range(400):
            source.out.write_nowait(TimedLong(time.time_ns(), value))
            await sleep(0.005)
        ages = [one.data / 1e6 for one in sink.inp.drain()]
        assert len(ages) > 10
        assert max(ages[-5:]) < 0.6  # eight samples of 5 ms, and those that wait for a moment; all of them: 1.8 s
        ledger = await _ledger(kernel, connector)
        assert (ledger.written, ledger.unexplained) == (400, 0)
        assert ledger.dropped["overwritten"] > 200
        assert ledger.buffered + ledger.in_flight < 40


@kept
async def test_a_writer_that_is_to_wait_waits_for_a_slow_reader_in_a_process_as_for_one_here() -> None:
    async with Kernel() as kernel:
        source, sink, connector = await _aged(kernel, full="block")
        written = 0

        async def write() -> None:
            nonlocal written
            while True:
                await source.out.write(TimedLong(time.time_ns(), written))
                written += 1

        async with create_task_group() as tasks:
            tasks.start_soon(write)
            await sleep(2.0)
            read, begun = len(sink.inp.drain()), written
            assert read > 10
            assert begun < read + 40  # eight at either end, and as many between them
            tasks.cancel_scope.cancel()
        ledger = await _ledger(kernel, connector)
        assert (ledger.unexplained, dict(ledger.dropped)) == (0, {})


@kept
async def test_a_write_that_a_slow_reader_in_a_process_has_no_room_for_is_rejected_as_here() -> None:
    async with Kernel() as kernel:
        source, _, connector = await _aged(kernel, full="reject")
        done = []
        for value in range(200):
            done.append(source.out.write_nowait(TimedLong(time.time_ns(), value)))
            await sleep(0.002)
        ledger = await _ledger(kernel, connector)
        assert (ledger.written, ledger.unexplained) == (200, 0)
        assert ledger.dropped == {"rejected": done.count(False)}
        assert done.count(True) < 60  # eight at either end, as many between them, and what was read


@kept
async def test_how_late_samples_are_says_where_it_is_measured(capsys: pytest.CaptureFixture[str]) -> None:
    async with Kernel(services={"control": {"name": "unit"}}) as kernel:
        source, _, connector = await _aged(kernel, measure=100)
        source.out.write_nowait(TimedLong(time.time_ns(), 1))
        for words in (("delay", "reader.inp", "--count", "1"), ("cat", "-l", "reader")):
            status, text = await commanded(capsys, *words)
            assert status == 0
            assert [", up to the link" in line for line in text.splitlines() if "latency" in line] == [True], text
        await _ledger(kernel, connector)


@pytest.mark.slow
async def test_how_old_samples_are_as_a_reader_in_a_process_reads_them_is_asked_for_there(
    capsys: pytest.CaptureFixture[str],
) -> None:
    async with Kernel(services={"control": {"name": "unit"}}) as kernel, create_task_group() as tasks:
        source, _, connector = await _aged(kernel)

        async def write() -> None:
            while True:
                source.out.write_nowait(TimedLong(time.time_ns(), 0))
                await sleep(0.005)

        tasks.start_soon(write)
        with fail_after(30):
            words = ("--count", "2", "--interval", "1", "--json")
            status, text = await commanded(capsys, "delay", "source.out", *words)
            lines = [json.loads(line) for line in text.splitlines() if line.startswith("{")]
            assert (status, lines[-1]["to_link"]) == (0, True), text
            # Eight samples wait for a reader that takes one in 50 ms; the newest of them is 25 to 50 ms old at once.
            assert lines[-1]["read"]["age"]["p50_ns"] > 20_000_000 > lines[-1]["age"]["p50_ns"], text
            assert 2 <= lines[-1]["read"]["waited"]["samples"] < 100, text
            status, text = await commanded(capsys, "con", "source.out", "reader.inp", "--both-ends")
            assert (status, "at the read" in text) == (0, False), text  # measured as long as `delay` ran
            assert [line for line in text.splitlines() if "written" in line and "both ends" not in line] == [], text
            kernel.connections.measure(connector, 100)
            found = {}
            while not found.get("read"):
                status, text = await commanded(capsys, "con", "reader.inp", "source.out", "--both-ends", "--json")
                (found,) = json.loads(text)["kernels"][0]["connectors"]
            assert found["read"]["age"][1] > 20_000_000, text
            status, text = await commanded(capsys, "con", "reader.inp", "--both-ends")
            assert (status, "at the read: age p50" in text) == (0, True), text
        tasks.cancel_scope.cancel()
        await _ledger(kernel, connector)


async def test_what_a_reader_in_a_process_loses_is_known_here_by_reason(caplog: pytest.LogCaptureFixture) -> None:
    async with Kernel() as kernel:
        source, _, connector = await _aged(kernel)
        for value in range(200):
            source.out.write_nowait(TimedLong(time.time_ns(), value))
            await sleep(0.002)
        await sleep(0.3)
        lost = connector.statistics.dropped
        ledger = await _ledger(kernel, connector)
        assert lost["overwritten"] > 100
        assert connector.statistics.balanced
        assert (ledger.dropped, ledger.unexplained) == (lost, 0)
        assert any("source.out -> reader.inp" in line and "overwritten" in line for line in caplog.messages)


@kept
async def test_commands_say_what_a_reader_in_a_process_has_lost(capsys: pytest.CaptureFixture[str]) -> None:
    async with Kernel(services={"control": {"name": "unit"}}) as kernel:
        source, _, connector = await _aged(kernel)
        for value in range(200):
            source.out.write_nowait(TimedLong(time.time_ns(), value))
            await sleep(0.002)
        await sleep(0.3)
        lost = connector.statistics.dropped["overwritten"]
        _, text = await commanded(capsys, "cat", "-l", "reader")
        assert f"dropped {lost} overwritten" in text
        _, text = await commanded(capsys, "top", "--once")
        assert f"overwritten {lost}" in text
        _, text = await commanded(capsys, "check", "unit")
        assert f"connectors.source.out-reader.inp: {lost} of 200 samples were dropped ({lost} overwritten)" in text
        await _ledger(kernel, connector)


@kept
async def test_what_a_reader_loses_that_moved_into_a_process_and_back_is_logged(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async with Kernel() as kernel:
        source, reader = await kernel.add(Source("source")), await kernel.add(Aged("reader"))
        await kernel.connect(source.out, reader.inp)
        here = EventContext(name="here")
        await kernel.start(here, reader, activate=True)
        for to in ("process", here):
            caplog.clear()
            with fail_after(30):
                reader = await kernel.move(reader, to)
                while not any("source.out -> reader.inp" in line and "lost so far" in line for line in caplog.messages):
                    source.out.write_nowait(TimedLong(time.time_ns(), 0))
                    await sleep(0.002)
