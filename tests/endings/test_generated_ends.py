"""Systems made at random end, in every way and at any moment, without an error, and each sample is accounted for."""

from __future__ import annotations

from pathlib import Path

import pytest

from endings.endings import left_by_with
from endings.generated import system_of


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("simulated", [True, False])
def test_left_by_with(seed: int, simulated: bool, tmp_path: Path) -> None:
    assert left_by_with(system_of(seed), tmp_path / "books", simulated=simulated) == []
