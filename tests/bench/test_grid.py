"""The grid of `aiorts bench push`: what is measured, what is left out, and ledgers of real short rounds."""

from __future__ import annotations

import pytest

from aiorts_bench.harness.runner import measure
from aiorts_bench.push import grid, load
from aiorts_bench.push.load import Load


def test_what_differs_in_nothing_is_measured_once_and_said_in_one_line() -> None:
    planned = grid.plan({"subscription": "flush,new,periodic", "push": "all,new"})
    assert len(planned.loads) == 5
    assert planned.left_out == ("left out 1 of 6 combinations that differ in nothing: flush has no push policy",)
    assert planned.fixed["payload"] == "float"
    assert grid.plan({"subscription": "new", "push": "all"}).left_out == ()


def test_only_periodic_has_a_push_rate() -> None:
    planned = grid.plan({"subscription": "new,periodic", "push": "all", "push-rate": "none,100"})
    assert [one.push_rate for _, one in planned.loads] == [None, 100.0]
    assert len(planned.left_out) == 1
    assert grid.plan({"subscription": "periodic", "push-rate": "none"}).loads == ()


def test_a_periodic_connector_pushes_at_the_rate_of_its_reader_unless_another_is_said() -> None:
    given = {"subscription": "flush,periodic", "push": "new", "consumer-rate": "5,20"}
    planned = grid.plan(given)
    periodic = [one for _, one in planned.loads if one.subscription == "periodic"]
    assert [(one.consumer_rate, one.push_rate) for one in periodic] == [(5.0, 5.0), (20.0, 20.0)]
    assert planned.fixed["push-rate"] == "that of the reader"
    planned = grid.plan({**given, "push-rate": "200"})
    assert {one.push_rate for _, one in planned.loads} == {None, 200.0}
    assert planned.fixed["push-rate"] == "200"
    for given in ({"subscription": "periodic"}, {"subscription": "periodic", "consumer-rate": "max"}):
        planned = grid.plan(given)
        assert ({one.push_rate for _, one in planned.loads}, planned.fixed["push-rate"]) == ({200.0}, "200")


@pytest.mark.slow(kept_by="bench/test_case.py::test_broken_ledger_is_a_fault")
@pytest.mark.parametrize(
    "one",
    [
        Load("flush"),
        Load("flush", full="block", consumer_rate=200.0, producer_rate=None),
        Load("flush", full="reject", consumer_rate=200.0, length=2),
        Load("new", "skip", fan_in=2, fan_out=2),
        Load("new", "new", length=None, producer_rate=10_000.0),
        Load("periodic", "all", push_rate=200.0, payload=1000),
        Load("periodic", "fifo", push_rate=200.0, full="reject", length=1),
    ],
    ids=str,
)
@pytest.mark.parametrize("loop", ["asyncio", "uvloop"])
def test_ledger_of_a_real_round_balances(one: Load, loop: str) -> None:
    for scale in (0.2, 2.0):  # on a busy machine a short round may be over before the first sample is let through
        (row,) = measure((load.case("x", one, {}),), loop=loop, rounds=1, scale=scale)
        assert row.ledger is not None
        assert row.ledger.balanced, row.ledger
        if row.ledger.received > 0:
            break
    assert row.ledger.received > 0
    assert set(row.figures) >= {"rate", "offered", "latency p50", "age p50", "cpu"}


@pytest.mark.slow(kept_by="test_only_periodic_has_a_push_rate")
def test_reader_with_a_rate_takes_no_more_than_that() -> None:
    one = Load("flush", consumer_rate=200.0, producer_rate=2000.0)
    (row,) = measure((load.case("x", one, {}),), loop="asyncio", rounds=1, scale=1.0)
    assert row.figures["rate"].spread.median <= 220
    assert row.ledger is not None
    assert row.ledger.dropped.keys() == {"overwritten"}
