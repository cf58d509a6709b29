"""Long work shows what is done and what is left on a terminal's standard error, and nothing elsewhere."""

from __future__ import annotations

import io
import sys

import pytest

from aiorts.progress import progress
from aiorts_bench.harness.case import COST, Case, Reading
from aiorts_bench.harness.runner import measure


class Screen(io.StringIO):
    def isatty(self) -> bool:
        return True


def worked(monkeypatch: pytest.MonkeyPatch, stream: io.StringIO | None, total: int = 4) -> str:
    monkeypatch.setattr(sys, "stderr", stream)
    with progress("working", total) as step:
        for _ in range(total):
            step(1)
    return "" if stream is None else stream.getvalue()


def test_a_bar_on_a_terminal_says_how_much_is_done(monkeypatch: pytest.MonkeyPatch) -> None:
    shown = worked(monkeypatch, Screen())
    assert "working" in shown
    assert "100%" in shown


@pytest.mark.parametrize("stream", [io.StringIO(), None])
def test_nothing_is_shown_elsewhere(monkeypatch: pytest.MonkeyPatch, stream: io.StringIO | None) -> None:
    assert worked(monkeypatch, stream) == ""


def test_work_of_an_unknown_amount_has_no_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    assert worked(monkeypatch, Screen(), 0) == ""


@pytest.mark.slow(kept_by="test_a_bar_on_a_terminal_says_how_much_is_done")
def test_a_bench_counts_each_case_of_each_round(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = Screen()
    monkeypatch.setattr(sys, "stderr", screen)
    cases = tuple(Case(name, "", COST, lambda count: Reading.timed(count, 1000)) for name in ("one", "two"))
    measure(cases, loop="none", rounds=3, progress=progress)
    assert "measuring" in screen.getvalue()
    assert "100%" in screen.getvalue()
