"""Filters with several in-ports: lines count in their order, however they arrive, and none of them stands still."""

from __future__ import annotations

import time
from typing import Any

import pytest

from aiorts import Component, EventContext, InPort, Kernel, OutPort
from aiorts.errors import WriteTimeout
from aiorts.system.stdio.pipes import Feed
from aiorts.testing import simulated
from aiorts.types import TimedLong
from run_parts import here

pytestmark = pytest.mark.row(123)
LINES = [("input0", 1), ("selection", 1), ("input1", 2), ("input0", 3), ("selection", 0), ("input0", 4), ("input1", 5)]


def line(port: str, data: float) -> str:
    return f'{{"port": "{port}", "tm": 1, "data": {data}}}\n'


def ran(*arguments: str, stdin: str) -> tuple[int, list[str], list[str]]:
    """Exit status, `data` of each line written, and what was said."""
    done = here(*arguments, stdin=stdin)
    values = [written.rpartition(": ")[2].rstrip("}") for written in done.stdout.splitlines()]
    return done.returncode, values, done.stderr.splitlines()


@pytest.mark.parametrize("order", ["cycle", "tm"])
def test_a_selection_counts_for_the_lines_after_it(order: str) -> None:
    stdin = "".join(line(port, data) for port, data in LINES)
    arguments = ("flexiselect", "-p", "TimedLong:2", "--order", order)
    assert ran(*arguments, stdin=stdin) == (0, ["1", "2", "4"], [])
    status, values, err = ran(*arguments, stdin=stdin + line("selection", 7))
    assert (status, values) == (3, ["1", "2", "4"])
    assert len(err) == 1
    assert "E-SELECT" in err[0]


@pytest.mark.slow
def test_each_line_makes_a_sum_with_the_last_of_the_others() -> None:
    stdin = "".join(line(f"input{number % 2}", number) for number in range(1, 2001))
    status, values, err = ran("flexiadd", "-p", "TimedLong:2", stdin=stdin)
    assert (status, err) == (0, [])
    assert values == ["1", *(str(number * 2 - 1) for number in range(2, 2001))]


@pytest.mark.slow(kept_by="test_sums_of_all_wait_for_partners_that_come_much_later")
def test_a_hundred_thousand_lines_of_two_ports_in_runs_stay_fast() -> None:
    stdin = "".join(line(f"input{number // 1000 % 2}", number) for number in range(50_000))
    began = time.monotonic()
    status, values, _ = ran("flexiselect", "-p", "TimedLong:2", stdin=stdin)
    assert (status, len(values)) == (0, 25_000)
    assert time.monotonic() - began < 40.0


def test_sums_of_all_wait_for_partners_that_come_much_later() -> None:
    stdin = "".join(line(f"input{port}", number) for port in (0, 1) for number in range(3000))
    status, values, err = ran("flexiadd", "-p", "TimedLong:2", "--wait", "all", stdin=stdin)
    assert (status, err) == (0, [])
    assert values == [str(2 * number) for number in range(3000)]


@pytest.mark.fault("F18")
def test_a_sample_that_cannot_be_converted_is_a_bad_line() -> None:
    status, values, err = ran(
        "flexifilter", "-i", "TimedDouble", "-o", "TimedLong", stdin="1\n1e20\n\nx\n3\n-1e20\n4\n"
    )
    assert (status, values) == (1, ["1", "3", "4"])
    places = sorted(said.split(":")[2] for said in err)
    assert places == [f" standard input, line {number}" for number in (2, 4, 6)]
    assert all(said.startswith("aiorts: E-LINE: ") for said in err)


@pytest.mark.fault("F18")
def test_a_bad_line_changes_no_pin() -> None:
    arguments = ("-i", "TimedDoubleSeq:2", "-i", "TimedLong", "-o", "TimedLongSeq:3", "-m", "0:0>0:0,0:1>0:1,1>0:2")
    data = '{"port": "input0", "tm": 1, "data": %s}\n'
    stdin = data % "[1, 2]" + data % "[5, 1e20]" + line("input1", 7)
    done = here("flexifilter", *arguments, stdin=stdin)
    assert done.returncode == 1
    assert "line 2: " in done.stderr
    assert [text.rpartition('"data": ')[2] for text in done.stdout.splitlines()] == ["[1, 2, 0]}", "[1, 2, 7]}"]


class Two(Component):
    """Reads a only when there is a b."""

    a = InPort(TimedLong)
    b = InPort(TimedLong)

    def on_execute(self) -> None:
        if self.b.is_new:
            self.a.drain()
            self.b.drain()


@pytest.mark.parametrize("held_up", [False, True])
@simulated
async def test_a_full_port_of_who_waits_for_another_one_is_an_error_and_one_that_is_held_up_is_waited_for(
    held_up: bool,
) -> None:
    async with Kernel() as kernel:
        reader = await kernel.create(Two, "two")
        writer = await kernel.create(Component, "writer")
        outs: dict[str, OutPort[Any]] = {name: writer.add_port(name, OutPort(TimedLong)) for name in ("a", "b")}
        for name, port in outs.items():
            await kernel.connect(port, reader.ports[name], length=2, full="block", timeout=None)
        await kernel.start(EventContext(), writer, reader, activate=True)
        asked = 0

        def is_held_up() -> bool:
            nonlocal asked
            asked += 1
            if asked == 3:
                outs["b"].write_nowait(TimedLong(1, 1))
            return held_up

        feed = Feed(outs, ordered=False, held_up=is_held_up)
        for number in (1, 2):
            await feed.write("a", number, TimedLong(1, number))
        if held_up:
            await feed.write("a", 3, TimedLong(1, 3))
            assert asked == 3
        else:
            with pytest.raises(WriteTimeout, match="in-port a is full, with 2 samples, and its component waits for b"):
                await feed.write("a", 3, TimedLong(1, 3))
            assert asked == 1


@simulated
async def test_the_line_of_a_late_sample_is_known_as_long_as_it_may_be_asked_for() -> None:
    async with Kernel() as kernel:
        writer = await kernel.create(Component, "writer")
        feed = Feed({"a": writer.add_port("a", OutPort(TimedLong))}, ordered=True)
        for number in range(10, 10_010):
            await feed.write("a", number, TimedLong(1, 1))
        assert feed.line_of("a", 10_000) == 10_009
        assert feed.line_of("a", 8_000) == 8_009
        assert (feed.line_of("a", 1), feed.line_of("a", 10_001)) == (0, 0)
