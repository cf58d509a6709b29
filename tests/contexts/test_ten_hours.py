"""Ten hours at 1 kHz: every tick comes, each exactly when it is due, and none too many."""

from __future__ import annotations

import pytest

from aiorts import Component, InPort, Kernel, OutPort, PeriodicContext, SimulatedClock
from aiorts.contexts.schedule import Schedule
from aiorts.testing.simulation import simulate
from aiorts.types import TimedLong
from campaign import CAMPAIGN

RATE = 1000.0
HOURS = 10
CHUNK = 5 if CAMPAIGN else 1
"""Virtual minutes of one test: below a minute of processor time."""
CHUNKS = HOURS * 60 // CHUNK if CAMPAIGN else 10


class Beat(Component):
    """Writes the number of its cycle; notes when a cycle does not come on the millisecond."""

    out = OutPort(TimedLong)

    def __init__(self) -> None:
        super().__init__("beat")
        self.start_ns = -1
        self.cycles = 0
        self.late = 0

    async def on_execute(self) -> None:
        now = self.clock.monotonic_ns()
        if self.start_ns < 0:
            self.start_ns = now
        self.late += now != self.start_ns + self.cycles * 1_000_000
        self.cycles += 1
        self.out.write_nowait(TimedLong(0, self.cycles))


class Reader(Component):
    inp = InPort(TimedLong)


@pytest.mark.slow(kept_by="test_ticks_counted_one_by_one_neither_drift_nor_get_lost")
@pytest.mark.fault("C13")
@pytest.mark.campaign
@pytest.mark.parametrize("chunk", range(CHUNKS))
def test_a_context_of_1_khz_has_exactly_sixty_thousand_cycles_a_minute(chunk: int) -> None:
    """Each chunk begins that far into the ten hours: what accumulated on the clock before it counts."""

    async def main(clock: SimulatedClock) -> None:
        await clock.advance(chunk * CHUNK * 60.0)
        async with Kernel() as kernel:
            beat, reader = await kernel.add(Beat()), await kernel.add(Reader("reader"))
            connector = await kernel.connect(beat.out, reader.inp)
            context = await kernel.start(PeriodicContext(rate=RATE), beat, activate=True)
            await kernel.sleep(CHUNK * 60.0 - 0.0005)  # between two ticks
            assert beat.cycles == 60_000 * CHUNK
            assert beat.late == 0
            assert context.statistics.overruns == context.statistics.skipped == 0
            assert connector.statistics.written == beat.cycles
            assert connector.statistics.balanced

    simulate(main)


@pytest.mark.fault("C13")
@pytest.mark.parametrize("start_ns", [0, 123_456_789_012_345_678])
def test_the_last_tick_of_ten_hours_is_due_on_the_nanosecond(start_ns: int) -> None:
    schedule = Schedule(RATE)
    schedule.start(start_ns)
    ticks = HOURS * 3600 * 1000
    assert schedule._due(ticks) == start_ns + ticks * 1_000_000
    assert schedule._newest(start_ns + ticks * 1_000_000) == ticks
    assert schedule._newest(start_ns + ticks * 1_000_000 - 1) == ticks - 1


@pytest.mark.fault("C13")
@pytest.mark.campaign
@pytest.mark.parametrize("rate", [1000.0, 999.9, 3000.0])
@pytest.mark.parametrize("hour", range(HOURS if CAMPAIGN else 1))
def test_ticks_counted_one_by_one_neither_drift_nor_get_lost(rate: float, hour: int) -> None:
    """Every tick of the hour in turn, as a context asks for it; a short run takes its last minute."""
    schedule = Schedule(rate)
    schedule.start(7)
    numerator, denominator = rate.as_integer_ratio()
    first = round(rate * 3600) * (hour if CAMPAIGN else HOURS - 1)
    last = first + round(rate * (3600 if CAMPAIGN else 10))
    schedule._tick, schedule.due_ns = first, schedule._due(first)
    for tick in range(first, last):
        due = schedule.due_ns
        if tick % 1000 == 0:
            assert due == 7 + -(-tick * 1_000_000_000 * denominator // numerator)
        assert schedule.begin(due) is None
        schedule.end(due)
    assert schedule._tick == last
    assert schedule.due_ns == 7 + -(-last * 1_000_000_000 * denominator // numerator)
    assert schedule.skipped == schedule.overruns == schedule.lateness.total_ns == 0
