"""`aiorts bench scale`: small crowds in fresh processes; what a process cannot do is a fault and no hang."""

from __future__ import annotations

import asyncio

import pytest
from click.testing import CliRunner

from aiorts.bench import child, crowd, scale
from aiorts.bench.case import Reading
from aiorts.cli.app import aiorts as command


@pytest.mark.parametrize("count", [1, 2, 30])
def test_a_crowd_delivers_everything_and_gives_every_measure(count: int) -> None:
    found = asyncio.run(crowd.measure(count, 60))
    assert found["faults"] == []
    assert {"create", "connect", "start", "stop", "total", "memory", "message", "faults"} == found.keys()
    parts = sum(float(found[step]) for step in ("create", "connect", "start", "stop"))  # type: ignore[arg-type]
    assert found["total"] == pytest.approx(parts, abs=0.05)


def test_a_size_is_measured_in_fresh_processes() -> None:
    reading = scale._measured(20, 40)
    assert reading.faults == ()
    for measure in (scale.TOTAL, scale.TRACED, scale.MESSAGE):
        assert (measure.of([reading]) or 0) > 0, measure.name
    # 1 to 100 kB: a component is no page and no megabyte.
    assert 1_000 < reading.values[scale.TRACED.name] < 100_000


def test_a_child_that_fails_or_hangs_is_said_and_ended() -> None:
    with pytest.raises(OSError, match="status 3"):
        child.run(["-c", "raise SystemExit(3)"], timeout=20)
    with pytest.raises(OSError, match="was ended"):
        child.run(["-c", "import time; time.sleep(60)"], timeout=0.5)


def test_a_size_that_fails_is_a_fault_of_its_row(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scale, "_TIMEOUT_S", 0.01)
    reading = scale.cases((5,))[0].run(1)
    assert isinstance(reading, Reading)
    assert "was ended" in reading.faults[0]


def test_ten_thousand_have_the_aims_of_the_table() -> None:
    largest = {case.name: case for case in scale.cases()}["10,000"]
    aims = {(aim.baseline, (aim.measure or largest.measure).name, aim.factor) for aim in largest.aims}
    assert {("", "total", 5000.0), ("", "traced each", 6144.0), ("1", "message", None)} == aims


def test_help_of_scale() -> None:
    result = CliRunner().invoke(command, ["bench", "scale", "--help"])
    assert result.exit_code == 0, result.output
    assert "components" in result.output
