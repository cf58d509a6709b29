"""`aiorts bench` from its command line: exit statuses, documents, files, loops, and a bench that a plugin offers."""

from __future__ import annotations

import gc
import json
import textwrap
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from aiorts_bench import cli, registry
from aiorts_bench.harness.bench import Bench, Options
from aiorts_bench.harness.case import COST, Aim, Case, Ledger, Reading
from aiorts_bench.harness.report import SCHEMA, Report
from aiorts_bench.harness.runner import measure

TINY = ("--subscription", "flush,new", "--loop", "asyncio", "--scale", "0.05", "--rounds", "4")


def bench(*words: str) -> Result:
    return CliRunner().invoke(cli.bench, list(words))


@pytest.mark.slow(kept_by="bench/test_compare.py::test_what_is_no_document_is_refused")
def test_json_is_one_document_of_schema_2() -> None:
    result = bench("push", *TINY, "--json")
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert (found["schema"], found["bench"], found["rounds"], found["scale"]) == (2, "push", 4, 0.05)
    assert found["schema"] == SCHEMA
    assert {"command", "machine", "notes", "figures", "faults", "rows"} <= found.keys()
    for row in found["rows"]:
        assert row["ledger"]["balanced"], row
        figure = row["measures"][row["compared"]]
        assert figure["min"] <= figure["q1"] <= figure["median"] <= figure["q3"] <= figure["max"]
        assert len(figure["rounds"]) == 4


@pytest.mark.slow(kept_by="bench/test_plot.py::test_rows_are_drawn_for_each_loop_beside_the_figures")
def test_table_markdown_output_and_plot(tmp_path: Path) -> None:
    out, drawing = tmp_path / "table.md", tmp_path / "plot.html"
    result = bench("push", *TINY, "--markdown", "-o", str(out), "--plot", str(drawing))
    assert (result.exit_code, result.stdout) == (0, "")
    assert out.read_text(encoding="utf-8").startswith("# aiorts bench push")
    assert "<svg" in drawing.read_text(encoding="utf-8")
    assert "subscription" in bench("push", *TINY).stdout


@pytest.mark.slow(kept_by="bench/test_compare.py::test_small_shift_is_no_change")
def test_compare_with_itself_says_so(tmp_path: Path) -> None:
    old = tmp_path / "old.json"
    assert bench("push", *TINY, "--json", "-o", str(old)).exit_code == 0
    result = bench("push", *TINY, "--compare", str(old))
    assert result.exit_code == 0, result.output
    # On a machine that is too busy it judges none of the three rows, and says that.
    judged = ("CHANGED", "no change beyond the spread", "3 rows not judged")
    assert any(said in result.stdout for said in judged), result.stdout


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("push", "--subscription", "flsh"), "did you mean flush?"),
        (("push", "--json", "--markdown"), "exclude each other"),
        (("push", "--fail-on-change"), "needs --compare"),
        (("push", "--rounds", "0"), "--rounds"),
        (("push", "--plot", "x.pdf"), "FILE.html"),
        (("psh",), "did you mean 'push'?"),
        (("push", "--compare", "nowhere.json"), "nowhere.json"),
        (("startup", "--loop", "asyncio"), "--loop"),
    ],
)
def test_wrong_use_is_status_2_and_says_what_is_meant(words: tuple[str, ...], said: str) -> None:
    result = bench(*words)
    assert result.exit_code == 2
    assert said in result.output


def offered(case: Case) -> Bench:
    def report(options: Options) -> Report:
        return options.simple("own", (case,))

    return Bench("own", "Own.", report)


@pytest.mark.slow(kept_by="bench/test_results.py::test_a_missed_aim_is_written_and_a_fault_is_the_end")
def test_broken_promise_is_status_1_and_a_missed_aim_is_not(monkeypatch: pytest.MonkeyPatch) -> None:
    def torn(count: int) -> Reading:
        return Reading.timed(count, 10, Ledger(written=2, delivered=1, received=1))

    def slow(count: int) -> Reading:
        return Reading.timed(count, 10**9)

    found = {"torn": Case("torn", "", COST, torn), "slow": Case("slow", "", COST, slow, aims=(Aim("", factor=1.0),))}
    monkeypatch.setattr(registry, "load", lambda name: offered(found[name]))
    broken = bench("torn", "--quick", "--loop", "asyncio")
    assert (broken.exit_code, "FAULT torn on asyncio" in broken.stdout) == (1, True)
    missed = bench("slow", "--quick", "--loop", "asyncio")
    assert (missed.exit_code, " NO" in missed.stdout) == (0, True)


@pytest.mark.slow(kept_by="bench/test_results.py::test_all_benches_of_aiorts_have_a_part")
def test_bench_of_a_plugin_is_listed_and_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "fake_bench-1.0.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: fake-bench\nVersion: 1.0\n", encoding="utf-8")
    (folder / "entry_points.txt").write_text("[aiorts.benches]\nfaked = fake_bench:BENCH\n", encoding="utf-8")
    (tmp_path / "fake_bench.py").write_text(
        textwrap.dedent(
            """
            from aiorts_bench.harness.case import COST, Case, Reading
            from aiorts_bench.harness.bench import Bench

            def run(count):
                return Reading.timed(count, 1000 * count)

            CASES = (Case("one", "", COST, run, 10),)
            BENCH = Bench("faked", "Faked.", lambda o: o.simple("faked", CASES), loops=False)
            """
        ),
        encoding="utf-8",
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    assert "faked" in bench("--help").output
    result = bench("faked", "--quick", "--json")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["rows"][0]["measures"]["cost"]["median"] == 1000.0


@pytest.mark.slow(kept_by="bench/test_case.py::test_ratio_is_taken_round_by_round")
def test_rounds_are_interleaved_in_a_turning_order_with_the_collector_held() -> None:
    order: list[str] = []

    def case(name: str) -> Case:
        def run(count: int) -> Reading:
            assert not gc.isenabled()
            order.append(name)
            return Reading.timed(count, 10)

        return Case(name, "", COST, run, warm=False)

    measure(tuple(map(case, "abc")), loop="none", rounds=3)
    assert "".join(order) == "abcbcacab"
    assert gc.isenabled()
    assert gc.get_freeze_count() == 0


@pytest.mark.slow(kept_by="bench/test_case.py::test_ratio_is_taken_round_by_round")
def test_collector_is_restored_when_a_case_fails() -> None:
    def run(count: int) -> Reading:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        measure((Case("x", "", COST, run, warm=False),), loop="none", rounds=1)
    assert (gc.isenabled(), gc.get_freeze_count()) == (True, 0)
