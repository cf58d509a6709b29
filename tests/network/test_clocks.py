"""The offset of two clocks: off by less than it says, whatever the network does and however the clocks drift."""

from __future__ import annotations

import asyncio
import json
import tempfile
import time
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("zenoh")

from aiorts import Component, InPort, Kernel, OutPort
from aiorts.cli.app import run_command
from aiorts.cli.commands.live.spans import within_text
from aiorts.clock import SystemClock
from aiorts.types import TimedLong
from aiorts_zenoh.clocks import DRIFT, LAST, ClockOffset, Offset
from network.network_parts import by_network_alone, free_port

SECOND = 1_000_000_000
TRIP = st.tuples(st.integers(0, 2 * SECOND), st.integers(0, SECOND // 2), st.integers(0, SECOND // 2))
"""How long it waits until it asks; how long the question and the answer are on their way."""


class Other:
    """The clock of another machine, by true time: this machine's clock is right."""

    def __init__(self, ahead: int, drift: float) -> None:
        self.ahead, self.drift = ahead, drift

    def offset(self, now: int) -> float:
        return self.ahead + self.drift * now


@pytest.mark.slow
@given(
    st.lists(TRIP, min_size=1, max_size=80),
    st.integers(-(10**18), 10**18),
    st.floats(-0.9 * DRIFT, 0.9 * DRIFT),
    st.integers(0, 100 * SECOND),
)
def test_it_is_off_by_less_than_it_says(trips: list[tuple[int, int, int]], ahead: int, drift: float, wait: int) -> None:
    other, clock, now = Other(ahead, drift), ClockOffset(), 0
    for pause, there, back in trips:
        asked = now + pause
        now = asked + there + back
        clock.add(asked, round(asked + there + other.offset(asked + there)), now)
        found = clock.at(now)
        assert found is not None
        assert abs(found.ahead_ns - other.offset(now)) <= found.within_ns + 1_000  # floats of 10**18 are that exact
        assert found.within_ns <= (there + back + 1) // 2 + round(DRIFT * (there + back))
    found = clock.at(now + wait)
    assert found is not None
    assert abs(found.ahead_ns - other.offset(now + wait)) <= found.within_ns + 1_000


@given(st.lists(TRIP, min_size=1, max_size=80), st.integers(-(10**15), 10**15))
def test_without_drift_it_is_the_shortest_of_the_last(trips: list[tuple[int, int, int]], ahead: int) -> None:
    clock, now = ClockOffset(), 0
    for pause, there, back in trips:
        clock.add(now + pause, now + pause + there + ahead, now + pause + there + back)
        now += pause + there + back
    found = clock.at(now)
    assert found is not None
    shortest = min(there + back for _, there, back in trips[-LAST:])
    assert found.within_ns >= (shortest + 1) // 2
    assert abs(found.ahead_ns - ahead) <= found.within_ns


@given(st.integers(-(10**15), 10**15), st.integers(-(10**15), 10**15), st.integers(0, 10**6))
def test_a_clock_that_is_set_is_followed(before: int, after: int, trip: int) -> None:
    clock = ClockOffset()
    for number in range(40):
        ahead, asked = before if number < 20 else after, number * SECOND
        clock.add(asked, asked + trip // 2 + ahead, asked + trip)
    found = clock.at(39 * SECOND + trip)
    assert found is not None
    assert abs(found.ahead_ns - after) <= found.within_ns


def test_nothing_is_known_before_the_first_answer_and_a_trip_into_the_past_says_nothing() -> None:
    clock = ClockOffset()
    assert clock.at(0) is None
    clock.add(100, 50, 90)
    assert clock.at(0) is None
    clock.add(100, 1_110, 120)
    assert clock.at(120) == Offset(1_000, 10)


class Source(Component):
    out = OutPort(TimedLong)


class Sink(Component):
    inp = InPort(TimedLong, length=100)


@pytest.mark.slow(kept_by="first")
@pytest.mark.parametrize("ahead", [3_600 * SECOND, -86_400 * SECOND])
def test_the_age_of_samples_of_another_machine_is_right_though_its_clock_is_wrong(
    ahead: int, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    async def main() -> tuple[Any, list[int]]:
        address = f"127.0.0.1:{free_port()}"
        far = {"zenoh": {"listen": address, "host": "far", "insecure": True}, "control": {"name": "reader"}}
        near = {"zenoh": {"connect": address, "host": "near", "insecure": True}}
        wrong = SystemClock(lambda: time.time_ns() + ahead)
        async with Kernel("reader", services=far) as reader, Kernel("writer", clock=wrong, services=near) as writer:
            by_network_alone(reader)
            by_network_alone(writer)
            sink, source = await reader.add(Sink("sink")), await writer.add(Source("source"))
            connector = await reader.connect("near/writer/source.out", sink.inp, measure=50)
            stamps = []
            async with asyncio.timeout(20.0):
                while (found := connector.statistics).age_within_ns in (None, 1 << 62) or not found.age.count:
                    source.out.write_nowait(TimedLong(wrong.time_ns(), 1))
                    await asyncio.sleep(0.02)
                    stamps += [one.tm for one in sink.inp.drain()]
            assert list(reader.connectors) == [connector.name]  # the one that was asked for, with its options
            assert (
                await asyncio.to_thread(run_command, ["delay", "sink.inp", "--count", "1", "--timeout", "10", "--json"])
                == 0
            )
            return found, stamps

    with tempfile.TemporaryDirectory(prefix="ai") as folder:  # short: a socket's path has 107 letters
        monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
        found, stamps = asyncio.run(main())
    assert 0 < found.age_within_ns < 2 * SECOND
    assert -found.age_within_ns <= found.age.p50_ns < 2 * SECOND  # an hour or a day off without it
    assert all(abs(tm - time.time_ns() - ahead) < 60 * SECOND for tm in stamps), "a stamp is the writer's"
    told = json.loads(capsys.readouterr().out)
    assert 0 < told["age_within_ns"] < 2 * SECOND
    assert -told["age_within_ns"] <= told["age"]["p50_ns"] < 2 * SECOND


def test_what_may_be_off_by_more_than_10_ms_is_a_question_mark() -> None:
    shown = [within_text(one) for one in (None, 210_000, 10_000_000, 10_000_001, 1 << 62)]
    assert shown == ["", " +- 210 us", " +- 10 ms", "?", "?"]
