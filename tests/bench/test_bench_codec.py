"""`aiorts bench codec`: every payload through every codec, and what comes back is what was sent."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner

from aiorts.bench import codec
from aiorts.bench.case import Case, Reading
from aiorts.cli.app import aiorts as command


@pytest.mark.parametrize("case", codec.cases(), ids=lambda case: case.name)
def test_payload_comes_back_and_every_measure_is_there(case: Case) -> None:
    reading = case.run(2)
    assert isinstance(reading, Reading)
    assert reading.faults == ()
    values = {measure.name: measure.of([reading]) for measure in (case.measure, *case.columns)}
    assert None not in values.values()
    assert min(value for value in values.values() if value is not None) > 0
    assert values["cost"] == pytest.approx(values["encode"] + values["decode"], rel=1e-6)  # type: ignore[operator]


def test_a_frame_is_as_large_as_its_array() -> None:
    sizes = {case.name: case.run(1).values["frame"] for case in codec.cases()}  # type: ignore[union-attr]
    assert 80_000 < sizes["aiorts, 80 kB"] < 80_200
    assert 2**20 < sizes["aiorts, 1 MB image"] < 2**20 + 200


def test_what_does_not_come_back_is_a_fault() -> None:
    lossy = (lambda value: b"x", lambda frame: 0)
    assert codec._run(lossy, 1, lambda back: bool(back == 1), 1).faults


def test_codec_as_a_user_runs_it() -> None:
    result = CliRunner().invoke(command, ["bench", "codec", "--json", "--rounds", "2", "--scale", "0.02"])
    assert result.exit_code == 0, result.output
    document = json.loads(result.stdout)
    assert [row["case"] for row in document["rows"]] == [case.name for case in codec.cases()]
    ours = [row for row in document["rows"] if row["case"].startswith("aiorts")]
    assert len(ours) == len(codec.PAYLOADS)
    assert {ratio["baseline"].split(",")[0] for row in ours for ratio in row["ratios"]} == {"msgpack", "pickle 5"}
