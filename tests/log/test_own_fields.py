"""Records with fields that may be absent, moments, few values and maps of maps: in recordings of every form."""

from __future__ import annotations

import json
import math
import random
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

import jsonschema
import pytest

from aiorts.cli.app import run_command
from aiorts.errors import ConfigurationError, RecordError
from aiorts.testing.invented import invent
from aiorts.types import Map, Point2D, Seq, record, ros
from aiorts.types.registry import _by_full_name
from aiorts_log import RecordingOptions, RecordingReader, RecordingWriter, open_recording
from aiorts_log.analysis.series import read_series
from aiorts_log.recorder.weight import SMALL, weigher
from aiorts_log.text.columns import cells_of, columns_of, taker_of

EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
LATER = datetime(2026, 11, 22, 17, 45, 1, 234567, tzinfo=UTC)
NO_MAP: Any = {}


@record
class Journey:
    """What a vehicle says of its journey."""

    tm: int = 0
    speed: float | None = None
    note: str | None = None
    raw: bytes | None = None
    where: Point2D | None = None
    door: bool | None = None
    count: int | None = None
    mode: Literal["auto", "manual", "=now", '"'] = "auto"
    maybe: Literal["", "x", '"'] | None = None
    gear: Literal[1, 2, 3] = 1
    begun: datetime = EPOCH
    ended: datetime | None = None
    stops: Seq[datetime] = ()  # type: ignore[assignment]
    texts: Seq[str] | None = None
    data: Map = NO_MAP


@record
class Moments:
    """Numbers alone."""

    tm: int = 0
    begun: datetime = EPOCH
    gear: Literal[1, 2] = 1


FULL = Journey(
    1, 2.5, "", b"", Point2D(1.0, 2.0), False, 0, "=now", "", 3, LATER, EPOCH, [LATER], [""], {"a": {"b": {"c": 1}}}
)


def samples() -> list[Journey]:
    dice = random.Random(3)
    odd = [Journey(note=text) for text in ('"', '"a"', "null", " ", "=1+1", "'", "\n")]
    return [Journey(), FULL, *odd, *(invent(Journey, dice) for _ in range(50))]


def made(path: Path, encoding: Any = "msgpack") -> Path:
    with RecordingWriter(path, RecordingOptions(min_free=0, encoding=encoding)) as writer:
        port, other = writer.add_port("a", Journey), writer.add_port("b", Moments)
        for number, one in enumerate(samples()):
            assert writer.write(port, one, number)
            assert writer.write(other, Moments(number, LATER, 2), number)
    return path


def log(*arguments: str | Path) -> None:
    assert run_command(["log", *map(str, arguments)]) == 0


@pytest.mark.slow
@pytest.mark.parametrize("encoding", ["msgpack", "json"])
@pytest.mark.parametrize("ending", ["mcap", "csv", "txt", "jsonl", "rows.csv"])
def test_every_form_gives_every_value_back(
    encoding: str, ending: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, other, back = made(tmp_path / "run.mcap", encoding), tmp_path / f"new.{ending}", tmp_path / "back.mcap"
    log("convert", path, other, *(["--by-time"] if ending == "rows.csv" else []))
    ports = ["--port", "a", "--type", "Journey", "--port", "b", "--type", "Moments"]
    log("convert", other, back, *(ports if ending.endswith("csv") else []))
    with RecordingReader(back) as reader:
        found = [one for _, _, one in reader.records()]
    assert [one for one in found if isinstance(one, Journey)] == samples()
    assert {one.begun for one in found if isinstance(one, Moments)} == {LATER}
    log("diff", path, back)


@pytest.mark.parametrize("ending", ["mcap", "csv", "txt", "jsonl"])
def test_a_moment_before_1970_comes_back_from_every_form(
    ending: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The stamp of a message of ROS stands in its header: its `tm`, by which nothing is earlier than 0, is no field."""
    path, other, back = tmp_path / "run.mcap", tmp_path / f"new.{ending}", tmp_path / "back.mcap"
    early = ros.TwistStamped(ros.Header(ros.Time(-5, 250), "map")), Moments(7, datetime(1960, 1, 2, tzinfo=UTC))
    with RecordingWriter(path, RecordingOptions(min_free=0)) as writer:
        for number, one in enumerate(early):
            assert writer.write(writer.add_port("ab"[number], type(one)), one, number)
    log("convert", path, other)
    ports = ["--port", "a", "--type", "geometry_msgs/TwistStamped", "--port", "b", "--type", "Moments"]
    log("convert", other, back, *(ports if ending == "csv" else []))
    with RecordingReader(back) as reader:
        found = [one for _, _, one in reader.records()]
    assert found == [*early]
    assert (found[0].header.stamp.ns, found[0].tm) == (-5 * 10**9 + 250, 0)
    with pytest.raises(RecordError, match="tm: expected nanoseconds since the epoch"):
        Moments(-1)


def test_cells_are_those_that_people_write() -> None:
    columns = [column.path for column in columns_of(Journey)]
    cells = dict(zip(columns, cells_of(Journey)(FULL), strict=True))
    assert (cells["speed"], cells["note"], cells["raw"]) == ("2.5", '""', '""')
    assert (cells["door"], cells["gear"], cells["mode"]) == ("false", "3", "'=now")
    assert (cells["begun"], cells["ended"]) == ("1795369501234567000", "0")
    absent = dict(zip(columns, cells_of(Journey)(Journey()), strict=True))
    assert {absent[name] for name in ("speed", "note", "raw", "where", "door", "count", "maybe", "ended")} == {""}
    take = taker_of(Moments, {"tm": 0, "begun": 1, "gear": 2})
    assert take(["5", "1000", "2"], 0) == Moments(5, datetime(1970, 1, 1, microsecond=1, tzinfo=UTC), 2)


@pytest.mark.slow
def test_the_schema_in_the_file_fits_the_messages_and_explains_them_to_who_does_not_know_the_type(
    tmp_path: Path,
) -> None:
    for encoding in ("json", "msgpack"):
        path = made(tmp_path / f"{encoding}.mcap", encoding)
        known = _by_full_name.pop(f"{__name__}.Journey")
        try:
            with RecordingReader(path) as reader:
                port = reader.ports["a"]
                assert "no type" in port.unknown
                plain = [port.plain(sample.data) for sample in reader.samples(ports=["a"])]
                assert port.schema is not None
                document = json.loads(port.schema.data)
        finally:
            _by_full_name[f"{__name__}.Journey"] = known
        full = plain[1]
        assert [plain[0].get(name) for name in ("speed", "where", "ended")] == [None, None, None]
        assert ("speed" in plain[0]) is (encoding == "msgpack")
        assert (full["where"], full["begun"], full["maybe"]) == ({"x": 1.0, "y": 2.0}, 1795369501234567000, "")
        if encoding == "json":
            for one in plain[:9]:  # numbers of the rest are not all finite
                jsonschema.validate(one, document)
            with pytest.raises(jsonschema.ValidationError):
                jsonschema.validate({**full, "mode": "other"}, document)
        else:
            assert full["data"] == {"a": {"b": {"c": 1}}}


def test_an_array_in_a_map_of_a_map_is_explained(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "run.mcap", RecordingOptions(min_free=0)) as writer:
        writer.write(writer.add_port("a", Journey), Journey(data={"a": {"b": memoryview(b"")}, "c": {"d": [1, 2]}}), 1)
    known = _by_full_name.pop(f"{__name__}.Journey")
    try:
        with RecordingReader(tmp_path / "run.mcap") as reader:
            (sample,) = reader.samples()
            assert sample.port.plain(sample.data)["data"] == {"a": {"b": []}, "c": {"d": [1, 2]}}
    finally:
        _by_full_name[f"{__name__}.Journey"] = known


def test_a_curve_has_a_gap_where_a_value_is_absent(tmp_path: Path) -> None:
    path = made(tmp_path / "run.mcap")
    names = ["a.speed", "a.where.x", "a.gear", "a.begun", "a.ended"]
    with open_recording(path) as reader:
        found = [curves[0].values for curves in read_series(reader, names, None, None, lambda _: None)]
        values = [(math.nan, 2.5), (math.nan, 1.0), (1.0, 3.0), (0.0, 1795369501234567000.0), (math.nan, 0.0)]
        for curve, (absent, there) in zip(found, values, strict=True):
            assert curve[0] == pytest.approx(absent, nan_ok=True)
            assert curve[1] == there
        with pytest.raises(ConfigurationError, match=r"a\.mode: is str, not a number"):
            read_series(reader, ["a.mode"], None, None, lambda _: None)
        with pytest.raises(ConfigurationError, match="no field 'z'"):
            read_series(reader, ["a.where.z"], None, None, lambda _: None)


def test_a_queue_counts_what_may_be_absent() -> None:
    weigh = weigher(Journey)
    assert weigh is not None
    assert weigh(Journey(note="x" * 1000)) - weigh(Journey(note="")) == 1000
    assert SMALL <= weigh(Journey()) < SMALL + 200
