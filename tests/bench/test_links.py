"""`aiorts bench links`: real processes at both ends, all counted, all ended."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from importlib.util import find_spec

import pytest
from click.testing import CliRunner

from aiorts_bench import cli
from aiorts_bench.harness.case import LATENCY
from aiorts_bench.interprocess.links import cases
from aiorts_bench.interprocess.near import Ends, own_folder

TINY = ("links", "--loop", "asyncio", "--rounds", "1", "--scale", "0.1", "--json")


def test_every_row_of_a_link_has_an_aim_and_a_baseline_that_is_there() -> None:
    found = {case.name: case for case in cases(Ends("asyncio", peers=True))}
    assert {aim.baseline for case in found.values() for aim in case.aims} - {""} <= found.keys()
    assert all(any(aim.factor for aim in case.aims) for name, case in found.items() if name.startswith("link"))
    without = [case.name for case in cases(Ends("asyncio", peers=False))]
    assert without == [name for name in found if "Zenoh" not in name]


def test_its_kernels_meet_no_others(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", "/of-the-user")
    with own_folder():
        assert os.environ["XDG_RUNTIME_DIR"] != "/of-the-user"
    assert os.environ["XDG_RUNTIME_DIR"] == "/of-the-user"


@pytest.mark.slow(kept_by="test_every_row_of_a_link_has_an_aim_and_a_baseline_that_is_there")
def test_bench_links_shows_its_rows_and_leaves_no_process() -> None:
    result = CliRunner().invoke(cli.bench, [*TINY, "--no-peers"])
    assert result.exit_code == 0, result.output
    check(result.stdout, peers=False)
    with pytest.raises(ChildProcessError):
        os.waitpid(-1, os.WNOHANG)


@pytest.mark.slow(kept_by="test_every_row_of_a_link_has_an_aim_and_a_baseline_that_is_there")
@pytest.mark.skipif(find_spec("zenoh") is None, reason="Zenoh is not installed: pip install aiorts[bench]")
def test_bench_links_beside_zenoh() -> None:
    # In a process of its own: Zenoh keeps descriptors until the end of the process.
    words = [sys.executable, "-m", "aiorts", "bench", *TINY]
    check(subprocess.run(words, capture_output=True, text=True, timeout=60, check=True).stdout, peers=True)


def check(output: str, *, peers: bool) -> None:
    found = json.loads(output)
    rows = {row["case"]: row for row in found["rows"]}
    assert list(rows) == [case.name for case in cases(Ends("asyncio", peers=peers))]
    assert rows["link, flush"]["measures"][LATENCY.name]["median"] > 0
    assert all(row["ledger"]["balanced"] for row in found["rows"] if row["ledger"])
    assert not found["faults"]
