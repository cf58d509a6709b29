"""`aiorts bench context`: bare loops, contexts, the paper's four components. Virtual time where the arm is judged."""

from __future__ import annotations

import asyncio
import dataclasses
import shutil
import statistics
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

import aiorts
from aiorts import ExternalContext, Kernel, PeriodicContext, SimulatedClock, ThreadContext
from aiorts.bench import bare_c, bare_clock, context, manipulator, paper, ticking
from aiorts.bench.case import Reading
from aiorts.bench.pacing import Ticks, Timing, best_deviation
from aiorts.cli.app import aiorts as command
from aiorts.testing import simulate

MS = 1_000_000
HAS_COMPILER = any(shutil.which(name) for name in bare_c.COMPILERS)


# -- arithmetic ---------------------------------------------------------------------------------------------------


def series(lateness: list[int], *, left_out: tuple[int, ...] = (), period: int = 2 * MS, skipped: int = 0) -> Ticks:
    numbers = [n for n in range(len(lateness) + len(left_out)) if n not in left_out]
    due = [1000 + n * period for n in numbers]
    return Ticks(period, due, [when + late for when, late in zip(due, lateness, strict=True)], skipped)


def test_figures_of_a_series_by_hand() -> None:
    timing = Timing.of(series([10_000, 30_000, 20_000, 20_000]))
    assert (timing.ticks, timing.lateness_p50, timing.lateness_max) == (4, 20_000, 30_000)
    assert (timing.period_min, timing.period_max) == (2 * MS - 10_000, 2 * MS + 20_000)
    assert timing.period_deviation == statistics.pstdev([2_020_000, 1_990_000, 2_000_000])


def test_the_best_99_percent_leave_the_worst_period_out() -> None:
    periods = [2 * MS, 2 * MS + 100] * 100 + [9 * MS, 12 * MS]
    assert best_deviation(periods, 2 * MS) == pytest.approx(50.0, rel=1e-3)
    assert statistics.pstdev(periods) > 100_000


def test_a_drift_is_a_rate_error_and_one_late_tick_is_none() -> None:
    drifting = series([n * 200 for n in range(1000)])
    assert drifting.rate_error == pytest.approx(-1e-4, rel=1e-3)
    assert abs(series([0] * 999 + [50 * MS]).rate_error) < 1e-9
    assert abs(series([30 * MS] + [0] * 999).rate_error) < 1e-9


def test_ticks_left_out_must_be_counted() -> None:
    assert series([0, 0, 0, 0], left_out=(2,), skipped=1).complete
    assert not series([0, 0, 0, 0], left_out=(2,), skipped=0).complete
    assert not series([0, 0, 0, 0], skipped=1).complete
    assert ticking.reading_of(series([0, 0, 0, 0, 5], left_out=(2,))).faults
    assert 2 * 2 * MS not in series([0, 0, 0, 0], left_out=(2,)).periods_ns


def test_a_miscount_of_the_context_is_a_fault() -> None:
    right = dataclasses.replace(series([0] * 8), counted=8)
    assert ticking.reading_of(right).faults == ()
    assert ticking.reading_of(dataclasses.replace(right, counted=7)).faults


# -- bare loops ---------------------------------------------------------------------------------------------------


LOOPS: dict[str, Any] = {"asyncio": bare_clock.asyncio_sleep, "time": bare_clock.time_sleep}
if bare_clock.has_clock_nanosleep():
    LOOPS["nanosleep"] = bare_clock.clock_nanosleep
    LOOPS["fifo"] = partial(bare_clock.clock_nanosleep, priority=1)


@pytest.mark.parametrize("name", LOOPS)
@pytest.mark.parametrize("loop", ["asyncio", "auto"])
def test_bare_loop_runs_at_absolute_deadlines(name: str, loop: str) -> None:
    ticks = aiorts.run(lambda: LOOPS[name](2 * MS, 30), loop=loop)
    check_loop(ticks)


def test_bare_loop_leaves_out_what_it_missed_except_the_newest() -> None:
    marks = bare_clock.Marks(2 * MS, 3)
    start = marks.next_ns
    marks.ran_now(start + 10 * MS + 1)
    assert (marks.next_ns, marks.skipped, marks.overruns) == (start + 10 * MS, 4, 1)
    marks.ran_now(start + 10 * MS - 5)
    assert (marks.next_ns, marks.skipped) == (start + 12 * MS, 4)
    marks.ran_now(start + 90 * MS)
    ticks = marks.ticks()
    assert ticks.complete, "what is missed after the last tick is nobody's"
    assert ticks.lateness_ns == [10 * MS + 1, -5, 78 * MS]


def check_loop(ticks: Ticks) -> None:
    assert len(ticks.ran_ns) == 30
    assert ticks.complete
    # A loop of coarse timers may wake a millisecond early; nothing else may.
    assert min(ticks.lateness_ns) > -2 * MS
    assert all(step % (2 * MS) == 0 for step in (b - a for a, b in zip(ticks.due_ns, ticks.due_ns[1:], strict=False)))


@pytest.mark.skipif(not HAS_COMPILER, reason="no C compiler")
def test_loop_in_c_compiles_and_gives_ticks_of_the_same_clock(tmp_path: Path) -> None:
    built = bare_c.build(tmp_path)
    assert isinstance(built, bare_c.CLoop), built
    before = bare_clock.monotonic_ns()
    ticks = asyncio.run(built.run(2 * MS, 30, priority=1))
    check_loop(ticks)
    assert min(ticks.lateness_ns) >= 0
    assert before < ticks.due_ns[0] < ticks.ran_ns[-1] < bare_clock.monotonic_ns()


def test_without_a_compiler_the_bench_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    said = bare_c.build(tmp_path)
    assert isinstance(said, str)
    assert "compiler" in said or "Linux" in said
    assert not any(case.name.startswith("C") for case in context.thread_cases(None))
    assert "C" not in [case.name for case in paper.cases(None, None, 1)]


def test_a_program_that_gives_no_ticks_is_an_error(tmp_path: Path) -> None:
    program = tmp_path / "nothing"
    program.write_text("#!/bin/sh\nexit 0\n", encoding="utf-8")
    program.chmod(0o755)
    with pytest.raises(OSError, match="0 octets"):
        asyncio.run(bare_c.CLoop(program).run(2 * MS, 5))


# -- contexts -----------------------------------------------------------------------------------------------------

WORKLOADS: dict[str, Any] = {
    "periodic": partial(ticking.in_context, PeriodicContext, 2),
    "thread": partial(context.in_plain, ThreadContext, 2),
    "event": ticking.event_paced,
    "external": ticking.external,
    "manipulator": partial(ticking.manipulator, PeriodicContext),
    "manipulator, thread": partial(ticking.manipulator, ThreadContext),
}
if (make := context.realtime()) is not None:
    WORKLOADS["realtime"] = partial(context.in_plain, make, 2)
    WORKLOADS["manipulator, realtime"] = partial(ticking.manipulator, make)


@pytest.mark.parametrize("name", WORKLOADS)
def test_workload_gives_every_measure_and_no_fault(name: str) -> None:
    reading: Reading = aiorts.run(lambda: WORKLOADS[name](20), loop="asyncio")
    assert reading.faults == ()
    measures = (context.LATENESS, *context.loop_cases()[0].columns)
    figures = {measure.name: measure.of([reading]) for measure in measures}
    assert None not in figures.values(), figures
    assert reading.messages == 20
    assert min(reading.pools["lateness"]) >= 0
    if reading.ledger is not None:
        assert reading.ledger.balanced


def test_the_cost_of_a_cycle_is_of_timed_hooks() -> None:
    ours, bare = aiorts.run(ticking.cycles(3)), aiorts.run(ticking.bare_awaits(3))
    assert ours.faults == bare.faults == ()
    assert ours.messages == bare.messages == 3 * ticking.COMPONENTS
    assert 0 < bare.values["cost"] < ours.values["cost"]


def test_cycles_whose_hooks_are_not_timed_are_a_fault() -> None:
    async def main() -> tuple[str, ...]:
        async with Kernel() as kernel:
            quiet = ExternalContext(timing=False)
            await kernel.start(quiet, await kernel.add(ticking.Empty("one")), activate=True)
            await quiet.tick()
            return ticking._untimed(quiet, 1)

    assert asyncio.run(main())


# -- the paper's four components -----------------------------------------------------------------------------------


async def forces(cycles: int, **damper: float) -> tuple[list[float], manipulator.Cell]:
    clock = aiorts.testing.current_clock()
    async with Kernel(clock=clock) as kernel:
        cell = await manipulator.assemble(kernel)
        if damper:
            await cell.damper.configure(**damper)
        loop = await kernel.start(ExternalContext(), *cell.members, activate=True)
        found = []
        for _ in range(cycles):
            await loop.tick()
            found.append(cell.damper.force_x)
        return found, cell


def test_the_wall_answers_what_the_operator_pushes() -> None:
    found, cell = simulate(lambda _: forces(1500))
    assert found[: round(0.1 / manipulator.PERIOD)] == pytest.approx([0.0] * 50, abs=0.2)
    push = cell.damper.push_x
    assert push == pytest.approx(10.0, abs=0.3)
    assert found[-100:] == pytest.approx([-push] * 100, abs=0.2)
    assert -1.6 * push < min(found) < -push, "it meets the wall with a moderate overshoot"
    assert cell.settled
    assert all(one.statistics.balanced and one.statistics.written >= 1499 for one in cell.connectors)


def test_without_the_damper_the_contact_does_not_come_to_rest() -> None:
    found, _ = simulate(lambda _: forces(1500, damping=0.0))
    assert max(found[-200:]) - min(found[-200:]) > 2.0


def test_the_arm_comes_to_the_same_force_every_time() -> None:
    assert simulate(lambda _: forces(300))[0] == simulate(lambda _: forces(300))[0]


def test_the_jacobian_inverse_moves_the_tip_as_asked() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel(clock=clock) as kernel:
            cell = await manipulator.assemble(kernel, wall=9.0)
            loop = await kernel.start(ExternalContext(), *cell.members, activate=True)
            places = []
            for _ in range(600):
                await loop.tick()
                places.append(cell.arm._forward())
            moved, before = places[-1], places[-101]
            # 10 N over 80 N s/m: 0.125 m/s along x, and nothing along y.
            assert moved.x - before.x == pytest.approx(0.125 * 100 * manipulator.PERIOD, rel=0.02)
            assert moved.y == pytest.approx(places[0].y, abs=1e-4)

    simulate(main)


def test_an_arm_that_does_not_rest_at_the_wall_is_a_fault() -> None:
    _, cell = simulate(lambda _: forces(60))
    told = ticking._faults(cell, series([0] * 300))
    assert any("the wall answers" in fault for fault in told)
    assert any("samples were written" in fault for fault in told)


def test_the_paper_table_stands_beside_ours() -> None:
    rows = {case.name: case for case in paper.cases(None, None, 1)}
    printed = rows["paper, table 1"]
    reading = printed.run(1)
    assert isinstance(reading, Reading)
    shown = {measure.name: measure.of([reading]) for measure in (printed.measure, *printed.columns)}
    assert (shown["period min"], shown["period mean"], shown["period max"]) == (1.99, 2.00, 2.01)
    assert shown["deviation"] == 4.41
    assert {"asyncio.sleep", "periodic", "thread"} <= rows.keys()


# -- the command ---------------------------------------------------------------------------------------------------


def test_help_names_the_paper() -> None:
    result = CliRunner().invoke(command, ["bench", "context", "--help"])
    assert result.exit_code == 0, result.output
    assert "--paper" in result.output
    assert "table 1" in " ".join(result.output.split())


def test_paper_as_a_user_runs_it() -> None:
    result = CliRunner().invoke(
        command, ["bench", "context", "--paper", "--rounds", "1", "--scale", "0.05", "--loop", "asyncio"]
    )
    assert result.exit_code == 0, result.output
    for word in ("paper, table 1", "periodic", "thread", "asyncio.sleep", "4.41", "host took away"):
        assert word in result.stdout, word
