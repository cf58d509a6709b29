"""`aiorts bench push` as a user runs it, with tiny numbers: the document, the ledgers, the interleaving. No timing."""

from __future__ import annotations

import gc
import importlib.util
import json
from typing import TYPE_CHECKING, Any

import pytest
from click.testing import CliRunner

from aiorts.bench.case import Case, Metric, Reading
from aiorts.bench.cli import bench
from aiorts.bench.push import CASES
from aiorts.bench.results import main as write_results
from aiorts.bench.runner import choose_loops, measure

if TYPE_CHECKING:
    from pathlib import Path

HAS_UVLOOP = importlib.util.find_spec("uvloop") is not None
TINY = ("--quick", "--rounds", "2", "--scale", "0.02")
LOOPS = ["asyncio", pytest.param("uvloop", marks=pytest.mark.skipif(not HAS_UVLOOP, reason="uvloop is not installed"))]


@pytest.fixture(scope="module", params=LOOPS)
def document(request: pytest.FixtureRequest) -> dict[str, Any]:
    """What `--json` prints."""
    result = CliRunner().invoke(bench, ["push", "--json", "--loop", request.param, *TINY])
    assert result.exit_code == 0, result.output
    parsed: dict[str, Any] = json.loads(result.stdout)
    assert {row["loop"] for row in parsed["rows"]} == {request.param}
    return parsed


def test_document_says_how_and_where_it_was_measured(document: dict[str, Any]) -> None:
    assert (document["schema"], document["bench"], document["rounds"], document["scale"]) == (1, "push", 2, 0.02)
    assert document["command"].startswith("aiorts bench push --quick --loop")
    assert {"commit", "python", "cpu", "cores", "load", "system", "packages", "aiorts"} == document["machine"].keys()
    assert document["faults"] == []


def test_document_has_a_row_for_every_case(document: dict[str, Any]) -> None:
    assert [row["case"] for row in document["rows"]] == [case.name for case in CASES]
    for row in document["rows"]:
        assert 0 < row["ns"]["min"] <= row["ns"]["q1"] <= row["ns"]["median"] <= row["ns"]["q3"] <= row["ns"]["max"]
        assert (row["messages_per_second"] is None) is (row["metric"] == "p50")
        assert (row["p99_ns"] is None) is (row["metric"] == "cost")


def test_every_ledger_balances_and_promises_are_kept(document: dict[str, Any]) -> None:
    ledgers = {row["case"]: row["ledger"] for row in document["rows"] if row["ledger"] is not None}
    promised = {case.name for case in CASES if case.lossless}
    assert promised <= ledgers.keys()
    for name, ledger in ledgers.items():
        assert ledger["balanced"], name
        assert ledger["written"] == ledger["delivered"] + ledger["dropped"] + ledger["buffered"], name
        if name in promised:
            assert ledger["written"] == ledger["received"] > 0, name


def test_ratio_of_a_single_round_follows_from_the_two_rows() -> None:
    rows = {row.case.name: row for row in measure(CASES[:7], loop="asyncio", rounds=1, scale=0.02)}
    flush, deque = rows["flush"], rows["bare deque"]
    assert flush.ratios[0].measured.median == flush.spread.median / deque.spread.median
    assert flush.ratios[1].measured.median == rows["asyncio.Queue pair"].spread.median / flush.spread.median


def test_rounds_are_interleaved_in_a_turning_order_without_garbage_collection() -> None:
    ran: list[tuple[str, bool]] = []

    def make(name: str) -> Case:
        async def run(count: int) -> Reading:
            ran.append((name, gc.isenabled()))
            return Reading.timed(count, 1000)

        return Case(name, "", Metric.COST, run, 10)

    measure([make("a"), make("b"), make("c")], loop="asyncio", rounds=3)
    assert "".join(name for name, _ in ran) == "abcabcbcacab"
    assert not any(collecting for _, collecting in ran)
    assert gc.isenabled()


@pytest.mark.parametrize("rounds", [0, -1])
def test_no_round_is_refused(rounds: int) -> None:
    with pytest.raises(ValueError, match="rounds"):
        measure(CASES[:1], loop="asyncio", rounds=rounds)
    assert CliRunner().invoke(bench, ["push", "--rounds", str(rounds)]).exit_code == 2


def test_both_loops_are_the_default_where_both_are_there() -> None:
    assert choose_loops("asyncio") == ("asyncio",)
    assert choose_loops("both") == (("asyncio", "uvloop") if HAS_UVLOOP else ("asyncio",))
    assert choose_loops("auto") == (("uvloop",) if HAS_UVLOOP else ("asyncio",))


def test_table_names_every_case_and_the_machine() -> None:
    result = CliRunner().invoke(bench, ["push", "--loop", "asyncio", "--rounds", "1", "--scale", "0.01"])
    assert result.exit_code == 0, result.output
    assert "CPython" in result.stdout.splitlines()[0] or "PyPy" in result.stdout.splitlines()[0]
    for case in CASES:
        assert any(line.startswith(case.name) for line in result.stdout.splitlines()), case.name


def test_results_are_written_as_markdown_with_the_command(tmp_path: Path) -> None:
    file = tmp_path / "RESULTS.md"
    result = CliRunner().invoke(write_results, [str(file), "--loop", "asyncio", "--rounds", "1", "--scale", "0.01"])
    assert result.exit_code == 0, result.output
    text = file.read_text(encoding="utf-8")
    assert "Command: `aiorts bench push --loop asyncio --rounds 1 --scale 0.01`" in text
    assert "| flush |" in text
    assert text.endswith("\n")


def test_json_and_markdown_exclude_each_other() -> None:
    assert CliRunner().invoke(bench, ["push", "--json", "--markdown"]).exit_code == 2
