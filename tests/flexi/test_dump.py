"""FlexiDump: what a line looks like, that nothing is lost, and that a slow reader holds up nobody else."""

from __future__ import annotations

import asyncio
import contextlib
import csv
import json
import math
import os
import sys
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts import Component, EventContext, Kernel, LifecycleState, OutPort, PeriodicContext
from aiorts.testing import simulated
from aiorts.types import (
    Point2D,
    Pose2D,
    RangeData,
    TimedDouble,
    TimedDoubleSeq,
    TimedLong,
    TimedOctetSeq,
    TimedPose2D,
    TimedString,
)
from aiorts_flexi.common.text import line_of, news_of
from aiorts_flexi.dump import FlexiDump
from campaign import cases

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Iterator

TM = 1_700_000_000_000_000_042


@pytest.mark.parametrize(
    ("sample", "line"),
    [
        (TimedLong(TM, 6200), "in TimedLong 1700000000.000000042: 6200"),
        (TimedDouble(0, math.nan), 'in TimedDouble 0.000000000: "NaN"'),
        (TimedDoubleSeq(0, [1.0, -0.0]), "in TimedDoubleSeq 0.000000000: [1.0, -0.0]"),
        (TimedDoubleSeq(0, []), "in TimedDoubleSeq 0.000000000: []"),
        (TimedOctetSeq(0, b"\x00\xff"), None),
        (
            TimedPose2D(0, Pose2D(Point2D(1.0, 2.0), 3.0)),
            'in TimedPose2D 0.000000000: {"position": {"x": 1.0, "y": 2.0}, "heading": 3.0}',
        ),
        (2.5, "in float: 2.5"),
    ],
)
def test_a_line_is_name_type_time_and_data(sample: Any, line: str | None) -> None:
    made = line_of("text", "in", type(sample).__name__, sample)
    assert made == line if line is not None else made.startswith("in TimedOctetSeq")


def test_a_record_without_data_shows_its_fields() -> None:
    line = json.loads(line_of("json", "scan", "RangeData", RangeData(5, ranges=[1.0, math.inf])))
    assert (line["port"], line["type"], line["tm"]) == ("scan", "RangeData", 5)
    assert line["data"]["ranges"] == [1.0, "Infinity"]
    assert "tm" not in line["data"]


def test_field_paths_choose_what_is_shown() -> None:
    pose = TimedPose2D(0, Pose2D(Point2D(1.0, 2.0), 3.0))
    assert line_of("text", "p", "TimedPose2D", pose, ("position.x", "heading")).endswith(": position.x=1.0 heading=3.0")
    assert line_of("values", "p", "TimedPose2D", pose, ("heading",)) == "3.0"
    assert line_of("csv", "p", "TimedPose2D", pose) == "p,TimedPose2D,0.000000000,1.0,2.0,3.0"


@pytest.mark.slow(kept_by="first")
@pytest.mark.fault("D22")
@given(st.text(max_size=30))
@settings(max_examples=cases(5_000))
def test_no_text_can_command_a_terminal(text: str) -> None:
    try:
        sample = TimedString(0, text)
    except ValueError:
        return  # a lone surrogate is no text that travels
    for form in ("text", "json", "csv", "values"):
        assert line_of(form, "in", "TimedString", sample).isprintable()
    assert json.loads(line_of("json", "in", "TimedString", sample))["data"] == text
    assert len(next(csv.reader([line_of("csv", "in", "TimedString", sample)]))) == 4


@pytest.mark.parametrize(
    ("sample", "line"),
    [
        (TimedLong(TM, 6200), "in TimedLong 0.000000009 has new data"),
        (2.5, "in float 0.000000009 has new data"),
    ],
)
def test_a_line_may_tell_of_the_arrival_and_not_of_the_data(sample: Any, line: str) -> None:
    kind = type(sample).__name__
    assert news_of("in", kind, sample, 9) == line
    assert news_of("in", "TimedLong", TimedLong(TM, 6200)) == "in TimedLong 1700000000.000000042 has new data"
    assert news_of("in", "float", 2.5) == "in float has new data"
    assert line_of("text", "in", kind, sample, (), 9).startswith(f"in {kind} 0.000000009: ")
    assert json.loads(line_of("json", "in", kind, sample, (), 9))["tm"] == 9


@simulated
async def test_arrival_is_kernel_time_and_verbosity_hides_the_data(capsys: pytest.CaptureFixture[str]) -> None:
    async with Kernel() as kernel:
        dumps = [
            await kernel.create(FlexiDump, inputs=["TimedLong"], names=["n"], stamp="arrival", verbosity=verbosity)
            for verbosity in (0, -1)
        ]
        out = (await kernel.create(Component)).add_port("out", OutPort(TimedLong))
        for dump in dumps:
            await kernel.connect(out, dump.ports["n"])
        await kernel.start(EventContext(), *dumps, activate=True)
        await kernel.sleep(2.5)
        out.write_nowait(TimedLong(7, 6200))
        await kernel.sleep(0.1)
    assert capsys.readouterr().out.splitlines() == [
        "n TimedLong 2.500000000: 6200",
        "n TimedLong 2.500000000 has new data",
    ]


@contextlib.contextmanager
def piped() -> Iterator[Callable[[int], Awaitable[list[str]]]]:
    """Standard output is a pipe meanwhile; gives a function that reads so many lines from its other end."""
    reader, writer = os.pipe()
    os.set_blocking(reader, False)
    before, stream = sys.stdout, os.fdopen(writer, "w", encoding="utf-8")
    text = b""

    async def lines(count: int) -> list[str]:
        nonlocal text
        while text.count(b"\n") < count:
            try:
                text += os.read(reader, 65536)
            except BlockingIOError:
                await asyncio.sleep(0.001)
        return text.decode().splitlines()

    sys.stdout = stream
    try:
        yield lines
    finally:
        sys.stdout = before
        os.close(reader)
        with contextlib.suppress(BrokenPipeError):
            stream.close()


async def _dump(kernel: Kernel, **params: Any) -> OutPort[TimedLong]:
    """A FlexiDump in a context of its own, and a port that feeds it without loss."""
    dump = await kernel.create(FlexiDump, "dump", inputs=("TimedLong",), names=("n",), **params)
    feeder = await kernel.create(Component, "feeder")
    port = feeder.add_port("out", OutPort(TimedLong))
    await kernel.connect(port, dump.ports["n"], full="block", timeout=None)
    await kernel.start(EventContext(name="screen"), dump, activate=True)
    return port


@pytest.mark.row(123)
@pytest.mark.anyio
async def test_every_sample_is_a_line() -> None:
    with piped() as lines:
        async with Kernel() as kernel:
            port = await _dump(kernel, format="values")
            for number in range(300):
                await port.write(TimedLong(0, number))
            assert await lines(300) == [str(number) for number in range(300)]


@pytest.mark.anyio
async def test_the_rate_limit_shows_some_and_takes_all() -> None:
    with piped() as lines:
        async with Kernel() as kernel:
            port = await _dump(kernel, format="values", rate_limit=10.0, rate_clock="tm")
            for number in range(1_001):
                await port.write(TimedLong(number * 1_000_000, number))
            assert await lines(11) == [str(number) for number in range(0, 1_001, 100)]


@pytest.mark.slow
@pytest.mark.anyio
@pytest.mark.fault("F13")
@pytest.mark.skipif(not hasattr(os, "set_blocking"), reason="needs pipes that block")
async def test_a_reader_that_stalls_holds_up_no_other_context() -> None:
    ticks = written = 0

    class Other(Component):
        def on_execute(self) -> None:
            nonlocal ticks
            ticks += 1

    async def flood(port: OutPort[TimedLong]) -> None:
        nonlocal written
        while True:
            await port.write(TimedLong(0, written))
            written += 1

    with piped() as lines:
        async with Kernel() as kernel:
            port = await _dump(kernel)
            await kernel.start(PeriodicContext(rate=200.0), await kernel.create(Other), activate=True)
            flooding = asyncio.create_task(flood(port))
            stuck_at = -1
            while written != stuck_at:  # until the pipe is full, the buffers too, and nobody takes any more
                stuck_at = written
                await kernel.sleep(0.2)
            ticked = ticks
            await kernel.sleep(0.3)
            assert written == stuck_at > 1_000
            assert ticks - ticked > 10
            shown = await lines(stuck_at)
            flooding.cancel()
            assert [int(line.rpartition(" ")[2]) for line in shown] == list(range(len(shown)))
            await lines(written - 1)


@pytest.mark.anyio
@pytest.mark.fault("F11")
async def test_a_reader_that_has_gone_puts_the_dump_in_error_and_nobody_else() -> None:
    with piped():
        async with Kernel() as kernel:
            port = await _dump(kernel)
            other = await kernel.create(Component, "other")
            await kernel.start(EventContext(), other, activate=True)
            reader, writer = os.pipe()
            os.close(reader)
            dump = kernel.components["dump"]
            with os.fdopen(writer, "w") as broken, contextlib.redirect_stdout(broken):
                await port.write(TimedLong(0, 1))
                while dump.state is not LifecycleState.ERROR:
                    await kernel.sleep(0.001)
                with contextlib.suppress(BrokenPipeError):
                    broken.close()
            assert isinstance(dump.last_error, BrokenPipeError)
            assert other.state is LifecycleState.ACTIVE


@pytest.mark.anyio
@pytest.mark.parametrize(
    ("params", "said"),
    [
        ({"inputs": ("TimedLong",), "names": ("a", "b")}, "2 names for 1 in-ports"),
        ({"inputs": ("TimedLongg",)}, "did you mean"),
        ({"inputs": ("TimedPose2D",), "fields": ("position.q",)}, "position"),
        ({"format": "xml"}, "must be one of"),
        ({}, "at least one in-port"),
        ({"inputs": ("TimedLong", "TimedLong"), "names": ("a", "a")}, "of that name already"),
        ({"inputs": ("TimedLong", "TimedLong"), "names": ("input1",)}, "of that name already"),
    ],
)
async def test_bad_parameters_are_refused_at_creation(params: dict[str, Any], said: str) -> None:
    async with Kernel() as kernel:
        with pytest.raises(ValueError, match=said):  # ConfigurationError, and the WiringError of add_port
            await kernel.create(FlexiDump, "dump", **params)
