"""The share of the loop that clients have: what is owed for what they took has a bound, whatever a clock says."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from aiorts.control.server import pace
from aiorts.control.server.pace import Pace


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    now = [0.0]
    monkeypatch.setattr(pace, "time", SimpleNamespace(monotonic=lambda: now[0]))
    return now


def test_what_is_used_is_waited_for_and_no_debt_is_longer_than_what_can_be_saved(clock: list[float]) -> None:
    one = Pace(0.2, 0.5)
    one.spend(0.6)
    assert one.due() == pytest.approx(0.5)
    clock[0] += 0.5
    assert one.due() == pytest.approx(0.0, abs=1e-9)
    one.spend(3_600.0)
    assert one.due() == pytest.approx(2.5)
    one.spend(3_600.0)
    assert one.due() == pytest.approx(2.5)
