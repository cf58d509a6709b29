"""`python -m aiorts_bench.results`: parts of a file, each with its machine and command; `--check` judges aims."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from click.testing import CliRunner

from aiorts_bench import registry, results
from aiorts_bench.harness import runner
from aiorts_bench.harness.bench import Bench, Options, with_aims
from aiorts_bench.harness.case import COST, Aim, Case, Reading
from aiorts_bench.harness.report import Report
from aiorts_bench.results import Part, compose, main, parts_of
from campaign import CAMPAIGN, time_limit


def cost(value: float) -> Any:
    return lambda count: Reading({"cost": value}, count)


def bench(name: str, own: float, *faults: str) -> Bench:
    """A bench whose only aim is at most 2 of its baseline, of which it takes `own`."""
    cases = (
        Case("base", "", COST, cost(100.0)),
        Case(
            "mine",
            "",
            COST,
            lambda count: Reading({"cost": own * 100}, count, faults=faults),
            aims=(Aim("base", factor=2.0),),
        ),
        Case("shown", "", COST, cost(1.0), aims=(Aim("mine"),)),
    )

    def report(options: Options) -> Report:
        return options.simple(name, cases)

    return Bench(name, "", report, quick_rounds=1, rounds=2, loops=False)


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Any:
    """The command over two benches of which the second misses its aim by so much."""

    def command(*words: str, own: float = 1.5, faults: tuple[str, ...] = ()) -> Any:
        benches = {"one": bench("one", 1.0), "two": bench("two", own, *faults)}
        monkeypatch.setattr(registry, "load", benches.__getitem__)
        monkeypatch.setattr(results, "PARTS", tuple(Part(name) for name in benches))
        # What a case leaves is collected before the next one: nothing here, but all that the test session holds.
        monkeypatch.setattr(runner.gc, "collect", lambda: 0)
        outcome = CliRunner().invoke(main, [str(tmp_path / "R.md"), *words])
        file = tmp_path / "R.md"
        return SimpleNamespace(
            code=outcome.exit_code,
            said=outcome.output,
            text=file.read_text(encoding="utf-8") if file.exists() else None,
        )

    return command


@pytest.mark.slow
def test_every_part_has_a_table_its_machine_and_its_command(run: Any) -> None:
    done = run("--quick")
    assert done.code == 0
    assert list(parts_of(done.text)) == ["one", "two"]
    for name, part in parts_of(done.text).items():
        assert f"`aiorts bench {name} --quick`" in part
        assert "Measured on: aiorts" in part
        assert "| mine |" in part


@pytest.mark.slow
def test_only_measures_a_part_and_keeps_the_others(run: Any) -> None:
    before = parts_of(run().text)
    after = parts_of(run("--quick", "--only", "two").text)
    assert after["one"] == before["one"]
    assert after["two"] != before["two"]
    wrong = run("--only", "tow")
    assert wrong.code == 2
    assert "expected some of one, two" in wrong.said


@pytest.mark.parametrize(("own", "code"), [(1.9, 0), (2.15, 0), (2.25, 1)])
def test_check_fails_only_beyond_ten_per_cent_and_writes_nothing(run: Any, own: float, code: int) -> None:
    done = run("--check", own=own)
    assert (done.code, done.text) == (code, None)
    assert ("two: mine: cost 2.25, aim at most 2, base" in done.said) is (code == 1)


def test_a_missed_aim_is_written_and_a_fault_is_the_end(run: Any) -> None:
    missed = run(own=5.0)
    assert missed.code == 0
    assert "two: mine: cost 5" in missed.said
    broken = run(faults=("lost",))
    assert broken.code == 1
    assert "**Fault:** mine: lost" in parts_of(broken.text)["two"]


def test_check_runs_what_has_an_aim_and_its_baselines_only() -> None:
    cases = (
        *(Case(name, "", COST, cost(1.0)) for name in ("base", "other")),
        Case("aimed", "", COST, cost(1.0), aims=(Aim("base", factor=2.0), Aim("shown"))),
        Case("shown", "", COST, cost(1.0), aims=(Aim("other"),)),
        Case("unaimed", "", COST, cost(1.0), aims=(Aim("base"),)),
    )
    # what a ratio that is only shown needs is measured for a case that is needed
    chosen = with_aims(cases)
    assert [case.name for case in chosen] == ["base", "other", "aimed", "shown"]
    names = {case.name for case in chosen}
    assert {aim.baseline for case in chosen for aim in case.aims} <= names


def test_parts_come_in_one_order_and_the_sentences_last() -> None:
    parts = {
        "beside startup": "- s",
        "startup": "S",
        "beside push": "- p",
        "push": "P",
        "codec": "C",
        "beside codec": "",
    }
    text = compose(parts)
    assert list(parts_of(text)) == ["push", "codec", "startup", "beside head", "beside push", "beside startup"]
    assert compose(parts_of(text)) == text
    assert "## Beside OpenRTM-aist-Python" in text


def test_all_benches_of_aiorts_have_a_part() -> None:
    assert {part.bench for part in results.PARTS} == set(registry.OWN)
    assert len({part.name for part in results.PARTS}) == len(results.PARTS)


@pytest.mark.campaign
@pytest.mark.skipif(not CAMPAIGN, reason="ten minutes; AIORTS_CAMPAIGN=1")
@pytest.mark.timeout(time_limit(1200))
def test_every_aim_is_met_or_weaker_by_no_more_than_ten_per_cent() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "aiorts_bench.results", "--check"],
        capture_output=True,
        text=True,
        timeout=time_limit(1200) - 10,
    )
    assert done.returncode == 0, done.stdout
