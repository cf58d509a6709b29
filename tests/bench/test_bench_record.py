"""`aiorts bench record`: what is built, and beside what."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner

from aiorts.bench import record
from aiorts.cli.app import aiorts as command
from aiorts.errors import RecordError


def test_every_maker_makes_what_its_row_says() -> None:
    made = {name: make() for name, _, make, _ in record._MAKERS}
    assert made["tuple"] == (1.0, 2.0, 3.0)
    assert made["NamedTuple"] == (1.0, 2.0, 3.0)
    for name in ("slotted dataclass", "frozen dataclass", "Point3D", "@record"):
        assert (made[name].x, made[name].y, made[name].z) == (1.0, 2.0, 3.0)
    for name in ("TimedDoubleSeq, list", "TimedDoubleSeq, array"):
        assert made[name].data.tolist() == record._LIST
        assert not made[name].data.flags.writeable
    assert isinstance(made["array copy"], np.ndarray)


def test_the_checked_rows_check_and_the_others_do_not() -> None:
    with pytest.raises(RecordError):
        record.Own("x", 2.0, 3.0)  # type: ignore[arg-type]
    record.Slotted("x", 2.0, 3.0)  # type: ignore[arg-type]


def test_record_as_a_user_runs_it() -> None:
    result = CliRunner().invoke(command, ["bench", "record", "--json", "--rounds", "2", "--scale", "0.01"])
    assert result.exit_code == 0, result.output
    rows = {row["case"]: row for row in json.loads(result.stdout)["rows"]}
    assert list(rows) == [case.name for case in record.CASES]
    for name in ("Point3D", "@record", "TimedDouble"):
        assert [ratio["baseline"] for ratio in rows[name]["ratios"]] == ["slotted dataclass", "frozen dataclass"]
    assert all(row["measures"]["cost"]["median"] > 0 for row in rows.values())
