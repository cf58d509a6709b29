"""What `--compare` calls a change: property tests over noise that only makes things slower, and exact rows."""

from __future__ import annotations

import json
import random
from pathlib import Path

import click
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aiorts_bench.harness import compare as comparing
from aiorts_bench.harness.case import COST, LATENCY, RATE, Aim, Case, Measure, Reading, Sense
from aiorts_bench.harness.compare import compare, shift
from aiorts_bench.harness.report import Report, row_of

MACHINE = {"aiorts": "0", "commit": None, "python": "P", "cpu": None, "cores": 2, "system": "S", "load": None}
ROUNDS = 7


def unused(count: int) -> Reading:
    raise AssertionError(count)


def noisy(source: random.Random, cost: float) -> float:
    """A cost on a machine that somebody else uses as well: rarely less, often more."""
    return cost * (1 + abs(source.gauss(0, 0.02)) + (source.random() < 0.3) * source.random())


def document(
    seed: int, factor: float = 1.0, *, measure: Measure = COST, rows: int = 12, machine: float = 1.0
) -> Report:
    """A run in which row 3 is so many times as bad, on a machine so many times as slow."""
    source = random.Random(seed)

    def readings(cost: float) -> list[Reading]:
        costs = [noisy(source, cost * machine) for _ in range(ROUNDS)]
        return [Reading({"cost": one, "rate": 1e9 / one}, 10) for one in costs]

    found = {"base": readings(100.0)}
    sense = Sense.AT_MOST if measure is COST else Sense.AT_LEAST
    cases = [Case("base", "", measure, unused)]
    for number in range(rows):
        found[f"row {number}"] = readings(200.0 * (factor if number == 3 else 1.0))
        cases.append(Case(f"row {number}", "", measure, unused, aims=(Aim("base", sense),)))
    lines = tuple(row_of("asyncio", case, found) for case in cases)
    return Report("push", "c", {**MACHINE, "packages": {}}, ROUNDS, 1.0, lines)


def changed(old: Report, new: Report) -> list[str]:
    return [change.row for change in compare(json.loads(json.dumps(old.plain())), new.plain()).changes]


@pytest.mark.slow(kept_by="test_small_shift_is_no_change")
@pytest.mark.parametrize("slower", [0.5, 1.0, 2.0])
def test_equal_runs_have_no_change_even_on_a_slower_machine(slower: float) -> None:
    pairs = [changed(document(seed), document(seed + 20_000, machine=slower)) for seed in range(200)]
    assert sum(found != [] for found in pairs) <= 2  # chance finds one now and then: 1 % of runs at the most


@pytest.mark.parametrize("measure", [COST, RATE], ids=lambda measure: measure.name)
@pytest.mark.parametrize("factor", [1.35, 2.0])
def test_slow_down_of_one_row_is_found_and_of_no_other(measure: Measure, factor: float) -> None:
    for seed in range(20):
        old, new = document(seed, measure=measure), document(seed + 500, factor, measure=measure)
        change = compare(old.plain(), new.plain()).changes
        assert [(one.row, one.worse > 1) for one in change] == [("row 3 on asyncio", True)], seed
        back = compare(new.plain(), old.plain()).changes
        assert [(one.row, one.worse < 1) for one in back] == [("row 3 on asyncio", True)], seed


def test_small_shift_is_no_change() -> None:
    assert [changed(document(seed), document(seed + 500, 1.1)) for seed in range(20)] == [[]] * 20


def test_one_lucky_round_is_no_change() -> None:
    old, new = document(1).plain(), document(1).plain()
    row = next(row for row in new["rows"] if row["case"] == "row 3")
    row["measures"]["cost"]["rounds"][0] *= 0.1
    assert compare(old, new).changes == ()


def with_rounds(report: Report, rounds: list[float]) -> dict[str, object]:
    """The document whose row 3 took these costs, beside a baseline that took 100 in every round."""
    plain = report.plain()
    for row in plain["rows"]:
        if row["case"] in ("base", "row 3"):
            own = rounds if row["case"] == "row 3" else [100.0] * ROUNDS
            row["measures"]["cost"]["rounds"] = own
            for ratio in row["ratios"]:
                ratio["rounds"] = [value / 100.0 for value in own]
    return plain


def test_best_alone_is_no_change_and_a_busy_machine_is_not_judged() -> None:
    old = with_rounds(document(1), [200.0] * ROUNDS)
    slower = compare(old, with_rounds(document(1), [260.0] * ROUNDS))
    assert [change.row for change in slower.changes] == ["row 3 on asyncio"]
    best = compare(old, with_rounds(document(1), [160.0, 199.0, 199.0, *[200.0] * 4]))
    assert best.changes == ()
    busy = compare(old, with_rounds(document(1), [300.0, 350.0, 450.0, *[500.0] * 4]))
    assert busy.changes == ()
    assert any(line.startswith("1 rows not judged: the machine was busy") for line in busy.lines)


def test_percentiles_that_overlap_are_no_change() -> None:
    old, new = latencies(1, 1).plain(), latencies(1, 1).plain()
    for row, own in (
        (old["rows"][1], [1.0, 1.5, 1.0, 1.0, 1.5, 1.0, 1.0]),
        (new["rows"][1], [1.5, 1.0, 1.5] * 2 + [1.5]),
    ):
        row["ratios"][0]["rounds"] = own
    found = shift(old["rows"][1]["ratios"][0]["rounds"], new["rows"][1]["ratios"][0]["rounds"])
    assert found.p > comparing.ALPHA
    assert compare(old, new).changes == ()
    assert not shift([1.0] * 3 + [1.3], [1.3] * 3 + [1.31]).changed()


def latencies(seed: int, factor: float) -> Report:
    source = random.Random(seed)
    own = [Reading(pools={"latency": [source.gauss(20_000, 500) * factor] * 5}) for _ in range(ROUNDS)]
    base = [Reading(pools={"latency": [source.gauss(15_000, 500)] * 5}) for _ in range(ROUNDS)]
    cases = (Case("base", "", LATENCY, unused), Case("mine", "", LATENCY, unused, aims=(Aim("base"),)))
    found = {"mine": own, "base": base}
    return Report(
        "push", "c", {**MACHINE, "packages": {}}, ROUNDS, 1.0, tuple(row_of("l", one, found) for one in cases)
    )


def test_percentile_changes_when_the_rank_test_says_so() -> None:
    assert changed(latencies(1, 1), latencies(2, 1.5)) == ["mine on l"]
    assert [changed(latencies(seed, 1), latencies(seed + 100, 1)) for seed in range(50)] == [[]] * 50


@pytest.mark.slow(kept_by="first")
@given(st.lists(st.floats(1, 10), min_size=4, max_size=9), st.floats(0.2, 5))
def test_shift_is_antisymmetric_and_scales(values: list[float], factor: float) -> None:
    there = shift(values, [factor * value for value in values])
    back = shift([factor * value for value in values], values)
    assert there.factor * back.factor == pytest.approx(1.0)
    assert there.p == pytest.approx(back.p)
    assert shift(values, values).factor == pytest.approx(1.0)


def test_few_rounds_and_missing_rows_are_said() -> None:
    old, new = document(1).plain(), document(2).plain()
    for row in new["rows"]:
        for part in (*row["measures"].values(), *row["ratios"]):
            part["rounds"] = part["rounds"][:3]
    new["rows"] = [row for row in new["rows"] if row["case"] != "row 5"]
    lines = compare(old, new).lines
    assert "only in the old file: row 5 on asyncio" in lines
    assert f"11 rows not judged: below {comparing.FEWEST} rounds" in lines


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"schema": 2}', "nonsense"])
def test_what_is_no_document_is_refused(tmp_path: Path, text: str) -> None:
    file = tmp_path / "old.json"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(click.BadParameter):
        comparing.read(file)
