"""`aiorts bench network`: real kernels at both ends, linked over the network, all counted, all ended."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

pytest.importorskip("zenoh")

from aiorts_bench.harness.case import LATENCY
from aiorts_bench.interprocess.network import WAYS, beside, cases
from aiorts_bench.interprocess.networked import SECURED, BesideEnds, NetworkEnds

TINY = ("network", "--loop", "asyncio", "--rounds", "1", "--scale", "0.1", "--json", "--no-peers")


def test_every_row_of_a_link_has_an_aim_and_a_baseline_that_is_there() -> None:
    found = {case.name: case for case in cases(NetworkEnds("asyncio"))}
    assert {aim.baseline for case in found.values() for aim in case.aims} - {""} <= found.keys()
    aimed = [name for name, case in found.items() if any(aim.factor for aim in case.aims)]
    assert aimed == ["hand-over", "link, there and back", "link, 1 MiB", "link, stream"]
    assert [case.name for case in beside(BesideEnds("asyncio", zmq=False))] == ["TCP, echo", "TCP, 1 MiB"]


def test_another_way_has_rows_of_its_own() -> None:
    plain = [case.name for case in cases(NetworkEnds("asyncio")) if case.name not in ("Zenoh, callbacks", "hand-over")]
    other = cases(NetworkEnds("asyncio", SECURED))
    assert [case.name for case in other] == [f"TLS: {name}" for name in plain]
    assert {aim.baseline for case in other for aim in case.aims} <= {case.name for case in other}


@pytest.mark.slow(kept_by="test_every_row_of_a_link_has_an_aim_and_a_baseline_that_is_there")
def test_bench_network_shows_its_rows() -> None:
    # In a process of its own: Zenoh keeps descriptors until the end of the process.
    words = [sys.executable, "-m", "aiorts", "bench", *TINY]
    found = json.loads(subprocess.run(words, capture_output=True, text=True, timeout=90, check=True).stdout)
    rows = {row["case"]: row for row in found["rows"]}
    bare, ways = BesideEnds("asyncio", zmq=False), [NetworkEnds("asyncio", way) for way in WAYS]
    assert list(rows) == [case.name for case in (*beside(bare), *(case for ends in ways for case in cases(ends)))]
    assert all(rows[f"{way.name}link, flush"]["measures"][LATENCY.name]["median"] > 0 for way in WAYS)
    assert all(row["ledger"]["balanced"] for row in found["rows"] if row["ledger"])
    assert not found["faults"]
