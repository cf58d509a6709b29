"""What is said beside OpenRTM-aist-Python's figures: never more than the figures give."""

from __future__ import annotations

import pytest

from aiorts_bench.cases import startup
from aiorts_bench.harness import openrtm
from aiorts_bench.harness.case import RATE, Case, Measure, Reading
from aiorts_bench.harness.openrtm import PEERS, Peer, sentences, times
from aiorts_bench.harness.report import Report, row_of
from aiorts_bench.punctuality.context import loop_cases
from aiorts_bench.punctuality.paper import cases as paper_cases
from aiorts_bench.push import push
from aiorts_bench.results import PARTS

LATE = Measure("late", "us", digits=1)


def unused(count: int) -> Reading:
    raise AssertionError(count)


def report(measure: Measure, **by_loop: float) -> Report:
    case = Case("mine", "", measure, unused)
    rows = tuple(row_of(loop, case, {"mine": [Reading({measure.name: value})]}) for loop, value in by_loop.items())
    return Report("push", "c", {}, 1, 1.0, rows)


@pytest.mark.parametrize(
    ("ours", "theirs", "better", "said"),
    [
        (600.0, 200.0, "more", "3.0 times better"),
        (200.0, 600.0, "more", "3.0 times worse"),
        (5.0, 60.0, "less", "12 times better"),
        (22.0, 7.0, "less", "3.1 times worse"),
        (500.0, 466.0, "more", "1.07 times better"),
        (101.0, 100.0, "less", "the same within 5 %"),
        (0.0, 100.0, "less", "not comparable"),
    ],
)
def test_how_many_times_is_in_the_sense_of_the_measure(ours: float, theirs: float, better: str, said: str) -> None:
    assert times(ours, theirs, better) == said


def test_sentence_takes_the_slower_loop_of_ours_and_the_better_round_of_theirs() -> None:
    rate = Peer("a", "push", "mine", RATE, (100e3, 200e3), "direct", "nothing")
    (said,) = sentences("push", report(RATE, asyncio=1e6, uvloop=2e6), [rate])
    assert "aiorts 1.00 M/s (asyncio), 2.00 M/s (uvloop)" in said
    assert "OpenRTM-aist-Python 100.0 k/s and 200.0 k/s (direct): 5.0 times better" in said
    late = Peer("b", "push", "mine", LATE, (7.0, 10.0), "direct", "nothing")
    (said,) = sentences("push", report(LATE, asyncio=35.0, uvloop=21.0), [late])
    assert "5.0 times worse" in said


def test_every_sentence_says_another_run_and_what_differs() -> None:
    peer = Peer("a", "push", "mine", RATE, (1.0,), "direct", "the whole of it")
    (said,) = sentences("push", report(RATE, none=2.0), [peer])
    assert "measured in another run" in said
    assert said.endswith("What differs: the whole of it.")
    assert "(none)" not in said
    assert "another run" in openrtm.HEAD


def test_nothing_is_said_of_a_row_that_was_not_measured() -> None:
    peer = Peer("a", "push", "other", RATE, (1.0,), "direct", "")
    assert sentences("push", report(RATE, asyncio=2.0), [peer]) == []
    assert sentences("context", report(RATE, asyncio=2.0), [Peer("a", "push", "mine", RATE, (1.0,), "", "")]) == []


def test_every_figure_of_theirs_stands_beside_a_row_that_there_is(tmp_path_factory: pytest.TempPathFactory) -> None:
    tables: dict[str, tuple[Case, ...]] = {
        "push": push.CASES,
        "context": loop_cases(),
        "context --paper": paper_cases(None, None, 0),
        "startup": startup.cases(tmp_path_factory.mktemp("startup")),
    }
    assert set(tables) <= {part.name for part in PARTS}
    for peer in PEERS:
        (case,) = [case for case in tables[peer.part] if case.name == peer.case]
        (measure,) = [one for one in (case.measure, *case.columns) if one.name == peer.measure.name]
        assert (measure.unit, measure.better) == (peer.measure.unit, peer.measure.better)
        assert peer.differs
        assert peer.theirs
