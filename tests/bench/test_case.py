"""Ratios, aims, ledgers, comparison, grid and plot of `aiorts bench`, from figures that are known exactly."""

from __future__ import annotations

import asyncio
import xml.etree.ElementTree as ElementTree

import click
import pytest

from aiorts.types import describe
from aiorts_bench.harness import plot
from aiorts_bench.harness.case import COST, Aim, Case, Ledger, Reading, Sense
from aiorts_bench.harness.compare import compare
from aiorts_bench.harness.report import Report, Spread, row_of
from aiorts_bench.push import flow, grid, push

MACHINE = {"aiorts": "0", "commit": None, "python": "P", "cpu": None, "cores": 2, "system": "S", "load": None}


def unused(count: int) -> Reading:
    raise AssertionError(count)


def costs(*values: float, ledger: Ledger | None = None) -> list[Reading]:
    return [Reading({"cost": value}, 10, ledger=ledger) for value in values]


def report(own: list[Reading], base: list[Reading]) -> Report:
    readings = {"mine": own, "base": base}
    cases = (Case("base", "", COST, unused), Case("mine", "", COST, unused, aims=(Aim("base", factor=3.0),)))
    rows = tuple(row_of("l", case, readings) for case in cases)
    return Report("push", "c", {**MACHINE, "packages": {}}, len(own), 1.0, rows)


def test_ratio_is_taken_round_by_round() -> None:
    ratio = report(costs(200, 900, 330), costs(100, 300, 110)).rows[1].ratios[0]
    assert ratio.measured == Spread(3.0, 2.5, 3.0, 2.0, 3.0)
    assert ratio.on_course is True


def test_aim_has_a_sense_a_floor_and_a_slack() -> None:
    assert Aim("b", Sense.AT_LEAST, 1.5).ratio(200, 300) == 1.5
    assert Aim("b", times=1.5, floor=1000.0).ratio(500, 10) == 0.5
    assert (Aim("b", factor=1.0).met(1.05), Aim("b", factor=1.0).met(1.05, 0.1)) == (False, True)


def test_broken_ledger_is_a_fault() -> None:
    torn = Ledger(written=10, delivered=10, received=9)
    assert "does not balance" in report(costs(1, ledger=torn), costs(1)).faults[0]


def test_comparison_names_the_row_that_changed_and_another_schema() -> None:
    base = costs(*(100 + number for number in range(9)))
    old = report(costs(*(200 + number for number in range(9))), base).plain()
    new = report(costs(*(260 + number for number in range(9))), base).plain()
    assert [change.row for change in compare(old, new).changes] == ["mine on l"]
    assert compare(old, old).changes == ()
    assert "schema 1" in compare({**old, "schema": 1}, new).lines[0]


@pytest.mark.parametrize(
    ("axis", "text", "said"), [("subscription", "flsh", "flush"), ("payload", "1XB", "1"), ("length", "0", "from 1")]
)
def test_grid_says_what_was_expected(axis: str, text: str, said: str) -> None:
    with pytest.raises(click.BadParameter, match=said):
        grid.parse({axis: text})


def test_plot_parses_and_loads_nothing() -> None:
    text = plot.html(report(costs(200, 210), costs(100, 110)))
    ElementTree.fromstring(text.split("\n", 1)[1])
    assert not any(word in text for word in ("http:", "https:", "src=", "url(", "@import"))


def test_push_measures_a_users_dataclass_too() -> None:
    (case,) = [case for case in push.CASES if case.name == "flush, dataclass"]
    assert not describe(flow.Pose).checked
    reading = asyncio.run(case.run(20))
    assert (reading.ledger.written, reading.ledger.received) == (20, 20)


def test_every_aim_names_a_case_of_its_table() -> None:
    for table in (push.CASES, push.CROWD_CASES):
        names = {case.name for case in table}
        assert {aim.baseline for case in table for aim in case.aims} - {""} <= names
