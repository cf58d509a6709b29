"""Ratios, spreads and ledgers of `aiorts bench`, computed from readings that are known exactly."""

from __future__ import annotations

import pytest

from aiorts.bench import printer
from aiorts.bench.case import Aim, Case, Ledger, Metric, Reading, Sense
from aiorts.bench.push import CASES
from aiorts.bench.report import Report, Row, Spread, percentile, row_of


async def unused(count: int) -> Reading:
    raise AssertionError(f"{count}: never run here")


MACHINE = {"aiorts": "0", "commit": None, "python": "P", "cpu": None, "cores": 2, "system": "S", "load": None}
BASE = Case("base", "what base does", Metric.COST, unused, 1)


def case(*aims: Aim, metric: Metric = Metric.COST, lossless: bool = False) -> Case:
    return Case("mine", "what mine does", metric, unused, 1, aims, lossless)


def costs(*values: float, ledger: Ledger | None = None) -> list[Reading]:
    return [Reading(10, value, 1e9 / value, (), ledger) for value in values]


def report(*rows: Row) -> Report:
    return Report("push", "aiorts bench push", {**MACHINE, "packages": {"anyio": "4"}}, 1, 1.0, rows)


def test_ratio_at_most_is_time_taken_round_by_round() -> None:
    row = row_of("l", case(Aim("base", factor=3.0)), {"mine": costs(200, 900, 330), "base": costs(100, 300, 110)})
    assert row.ratios[0].measured == Spread(3.0, 2.5, 3.0, 2.0, 3.0)
    assert row.ratios[0].on_course is True
    assert row.messages == 30


def test_ratio_at_least_is_times_as_fast() -> None:
    row = row_of("l", case(Aim("base", Sense.AT_LEAST, 1.5)), {"mine": costs(200, 200), "base": costs(250, 300)})
    assert row.ratios[0].measured.median == 1.375
    assert row.ratios[0].on_course is False


def test_ratio_without_aim_is_shown_and_judged_by_nobody() -> None:
    row = row_of("l", case(Aim("base")), {"mine": costs(200), "base": costs(100)})
    assert (row.ratios[0].measured.median, row.ratios[0].on_course) == (2.0, None)


def test_ratio_to_several_baselines_and_an_extra() -> None:
    aim = Aim("base", factor=1.0, times=1.5, extra_ns=1_000_000)
    assert aim.ratio(1_006_000, 4_000) == 1.0
    assert aim.compared_with == "1 ms + 1.5 x base"


def test_latency_compares_medians_of_rounds_and_pools_the_percentile() -> None:
    mine = [Reading(3, latencies_ns=(1000, 3000, 2000)), Reading(3, latencies_ns=(6000, 4000, 5000))]
    base = [Reading(1, latencies_ns=(1000,)), Reading(1, latencies_ns=(2000,))]
    row = row_of("l", case(Aim("base", factor=1.5), metric=Metric.P50), {"mine": mine, "base": base})
    assert (row.spread.min, row.spread.max, row.p99_ns, row.max_ns) == (2000, 5000, 6000, 6000)
    assert row.ratios[0].measured.median == 2.25
    assert row.per_second is None


@pytest.mark.parametrize(("percent", "expected"), [(50, 50), (99, 99), (99.9, 100), (1, 1), (0, 1)])
def test_percentile_is_the_nearest_rank(percent: float, expected: float) -> None:
    assert percentile(list(range(100, 0, -1)), percent) == expected


def test_ledger_that_does_not_balance_and_lost_messages_are_faults() -> None:
    lost = Ledger(written=10, delivered=9, dropped=1, received=9)
    torn = Ledger(written=10, delivered=10, received=9)
    promised, free = case(lossless=True), case()
    assert "lost messages" in row_of("l", promised, {"mine": costs(1, ledger=lost)}).faults[0]
    assert row_of("l", free, {"mine": costs(1, ledger=lost)}).faults == ()
    assert "does not balance" in row_of("l", free, {"mine": costs(1, ledger=torn)}).faults[0]


def test_ledger_of_a_row_is_the_sum_of_its_rounds() -> None:
    ledger = Ledger(written=4, delivered=2, buffered=1, dropped=1, received=2)
    row = row_of("l", case(), {"mine": costs(1, 1, 1, ledger=ledger)})
    assert row.ledger == Ledger(12, 6, 3, 3, 6)


def test_table_is_aligned_and_says_aim_and_course() -> None:
    readings = {"mine": costs(200, 200), "base": costs(100, 100)}
    aims = (Aim("base", factor=3.0), Aim("base", Sense.AT_LEAST, 1.8))
    rows = [row_of("asyncio", one, readings) for one in (BASE, case(*aims))]
    lines = printer.table(report(*rows)).splitlines()
    start = lines.index("asyncio")
    head, base, mine, more = lines[start + 1 : start + 5]
    assert "commit unknown" in lines[0]
    assert (base.split()[:3], mine.split()[:3]) == (["base", "100", "ns"], ["mine", "200", "ns"])
    assert mine.endswith("yes")
    assert more.endswith("NO")
    assert head.index("ratio to") == mine.index("base") == more.index("base")


def test_markdown_has_one_line_of_equal_columns_for_each_ratio() -> None:
    readings = {"mine": costs(200), "base": costs(100)}
    text = printer.markdown(report(*(row_of("asyncio", one, readings) for one in (BASE, case(Aim("base"))))))
    rows = [line for line in text.splitlines() if line.startswith("|")]
    assert len(rows) == 4
    assert len({line.count("|") for line in rows}) == 1
    assert "Command: `aiorts bench push`" in text


def test_every_aim_of_the_push_bench_names_a_case_of_the_same_metric() -> None:
    cases = {one.name: one for one in CASES}
    assert len(cases) == len(CASES)
    for one in CASES:
        for aim in one.aims:
            assert cases[aim.baseline].metric is one.metric, f"{one.name}: {aim.baseline}"
