"""Standard input and output as components: every line is taken or reported, and a slow side holds the other back."""

from __future__ import annotations

import asyncio
import io
import json
import os
import threading
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import aiorts
from aiorts import Component, EventContext, InPort, Kernel, LifecycleState, OutPort
from aiorts.system import LineStream, StandardInput, StandardOutput, wait_finished
from aiorts.types import TimedLong

WAYS = {"length": 100, "full": "block", "timeout": None}


class Double(Component):
    """Passes twice the number on."""

    inp = InPort(TimedLong)
    out = OutPort(TimedLong)

    async def on_execute(self) -> None:
        for sample in self.inp.drain():
            await self.out.write(TimedLong(sample.tm, 2 * sample.data))


class Filter:
    """A system of input, Double and output, and what it said."""

    def __init__(self) -> None:
        self.text = io.StringIO()
        self.bad: list[tuple[int, str]] = []
        self.done = 0

    @asynccontextmanager
    async def running(self, descriptor: int, count: int | None = None) -> AsyncIterator[Kernel]:
        async with Kernel() as kernel:
            double = await kernel.add(Double("double"))
            self.source = StandardInput("stdin", {"inp": TimedLong}, lambda *what: self.bad.append(what), descriptor)
            source = await kernel.add(self.source)
            self.sink = StandardOutput(
                "stdout", {"out": TimedLong}, stream=LineStream(self.text), count=count, done=self._over
            )
            sink = await kernel.add(self.sink)
            await kernel.connect(source.ports["inp"], double.inp, **WAYS)
            await kernel.connect(double.out, sink.ports["out"], **WAYS)
            for component in (sink, double, source):
                await kernel.start(EventContext(), component, activate=True)
            yield kernel

    async def run(self, descriptor: int, count: int | None = None) -> list[int]:
        async with self.running(descriptor, count) as kernel:
            assert await wait_finished(kernel) == ()
        return self.numbers

    @property
    def numbers(self) -> list[int]:
        return [json.loads(line)["data"] for line in self.text.getvalue().splitlines()]

    def _over(self) -> None:
        self.done += 1


def piped(data: bytes, cuts: list[int] | None = None) -> tuple[int, threading.Thread]:
    """A descriptor that gives `data`, written in pieces by a thread."""
    reading, writing = os.pipe()

    def write() -> None:
        with open(writing, "wb", buffering=0) as stream:
            last = 0
            for cut in [*sorted(cuts or []), len(data)]:
                stream.write(data[last:cut])
                last = cut

    thread = threading.Thread(target=write)
    thread.start()
    return reading, thread


def through(data: bytes, cuts: list[int] | None = None, loop: str = "asyncio") -> Filter:
    descriptor, thread = piped(data, cuts)
    filter_ = Filter()
    try:
        aiorts.run(filter_.run(descriptor), loop=loop)
    finally:
        os.close(descriptor)  # first: a writer whose pipe is full would be waited for without end
        thread.join()
    return filter_


@pytest.mark.slow(kept_by="first")
@pytest.mark.parametrize("loop", ["asyncio", "uvloop"])
def test_every_line_goes_through_in_order(loop: str) -> None:
    data = b"".join(b'{"data": %d}\n' % number for number in range(5000))
    assert through(data, loop=loop).numbers == [2 * number for number in range(5000)]


@pytest.mark.slow(kept_by="test_every_line_goes_through_in_order")
@settings(max_examples=30, deadline=None)
@given(st.lists(st.integers(0, 60), max_size=8), st.sampled_from([b"\n", b"\r\n"]), st.booleans())
def test_where_the_bytes_are_cut_does_not_matter(cuts: list[int], end: bytes, ended: bool) -> None:
    data = end.join([b'{"data": 1}', b"", b'  {"tm": 5, "data": 2} ', b"3"]) + (end if ended else b"")
    found = through(data, cuts)
    assert found.numbers == [2, 4, 6]
    assert (found.bad, found.source.lines) == ([], 3)


def test_a_bad_line_is_reported_with_its_number_and_the_others_go_on() -> None:
    found = through(b'1\n{"data": "x"}\n2\n\xff\n\nnonsense\n3')
    assert found.numbers == [2, 4, 6]
    assert [number for number, _ in found.bad] == [2, 4, 6]
    assert "TimedLong.data" in found.bad[0][1]
    assert "no UTF-8" in found.bad[1][1]
    assert "no JSON" in found.bad[2][1]
    assert (found.source.lines, found.source.bad) == (6, 3)


def test_a_line_without_end_is_refused_and_takes_no_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("aiorts.system.stdio.pipes._LONGEST", 100_000)
    found = through(b"1" * 500_000 + b"\n2\n" + b"3" * 300_000)
    assert found.numbers == [4]
    assert [number for number, _ in found.bad] == [1, 3]
    assert "longer than" in found.bad[0][1]


@pytest.mark.parametrize("what", ["file", "empty", "null", "closed"])
def test_input_of_every_kind_comes_to_its_end(what: str, tmp_path: Path) -> None:
    path = tmp_path / "lines"
    path.write_bytes(b"1\n2" if what == "file" else b"")
    never_opened = 900
    descriptor = never_opened if what == "closed" else os.open("/dev/null" if what == "null" else path, os.O_RDONLY)
    found = Filter()
    assert aiorts.run(found.run(descriptor)) == ([2, 4] if what == "file" else [])
    if what != "closed":
        os.close(descriptor)


@pytest.mark.slow(kept_by="test_input_of_every_kind_comes_to_its_end")
def test_a_directory_is_an_error_of_the_component(tmp_path: Path) -> None:
    async def main() -> None:
        found = Filter()
        descriptor = os.open(tmp_path, os.O_RDONLY)
        try:
            async with found.running(descriptor):
                while found.source.state is not LifecycleState.ERROR:
                    await asyncio.sleep(0.01)
                assert isinstance(found.source.last_error, IsADirectoryError)
        finally:
            os.close(descriptor)

    aiorts.run(main)


def test_after_count_samples_no_more_are_written_and_somebody_is_told() -> None:
    data = b"1\n" * 1000
    descriptor, thread = piped(data)
    found = Filter()
    aiorts.run(found.run(descriptor, count=7))
    thread.join()
    os.close(descriptor)
    assert found.numbers == [2] * 7
    assert (found.sink.written, found.done) == (7, 1)


class Stuck(Double):
    async def on_execute(self) -> None:
        await asyncio.Event().wait()


@pytest.mark.slow(kept_by="test_after_count_samples_no_more_are_written_and_somebody_is_told")
def test_a_reader_that_takes_nothing_holds_back_who_writes_to_us() -> None:
    """Otherwise a fast writer would fill our memory."""

    async def main() -> int:
        reading, writing = os.pipe()
        os.set_blocking(writing, False)
        async with Kernel() as kernel:
            stuck = await kernel.add(Stuck("stuck"))
            source = await kernel.add(StandardInput("stdin", {"inp": TimedLong}, lambda *_: None, reading))
            await kernel.connect(source.ports["inp"], stuck.inp, **WAYS)
            for component in (stuck, source):
                await kernel.start(EventContext(), component, activate=True)
            written = 0
            for _ in range(200):
                try:
                    written += os.write(writing, b"1\n" * 1000)
                except BlockingIOError:
                    await asyncio.sleep(0.001)
            os.close(writing)
        os.close(reading)
        return written

    # One chunk with the component, one pipe full of bytes, and nothing more.
    assert aiorts.run(main) <= 65_536 + 2 * 65_536
