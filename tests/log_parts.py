"""What the tests of recordings share: small recordings, and what is in them."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from aiorts.types import Map, Point2D, Seq, TimedDouble, TimedDoubleSeq, TimedString, record
from aiorts_log import RecordingOptions, RecordingReader, RecordingWriter

BEGIN = 1_700_000_000_000_000_000
MS = 1_000_000
Sample = tuple[str, int, Any]
LATER = datetime(2026, 11, 22, 17, 45, 1, 234567, tzinfo=UTC)
NO_MAP: Any = {}


@record
class Trip:
    """What `log/golden/fields-*.mcap` hold: it stays as it is forever."""

    tm: int = 0
    speed: float | None = None
    note: str | None = None
    raw: bytes | None = None
    where: Point2D | None = None
    mode: Literal["auto", "manual"] = "auto"
    gear: Literal[1, 2, 3] | None = None
    begun: datetime = LATER
    ended: datetime | None = None
    stops: Seq[datetime] = ()  # type: ignore[assignment]
    data: Map = NO_MAP
    usual: float | None = 1.0


TRIPS = (
    Trip(),
    Trip(1, 2.5, "", b"\0", Point2D(1.0, 2.0), "manual", 3, LATER, LATER, [LATER], {"a": {"b": {"c": 1}}}),
    *(Trip(tm, speed=float(tm), usual=None) for tm in range(2, 10)),
)


def make(path: Path, count: int = 100, **options: Any) -> list[Sample]:
    """A recording of three ports, `count` samples of each, a millisecond apart; what is in it."""
    expected: list[Sample] = []
    with RecordingWriter(path, RecordingOptions(**{"min_free": 0, **options}), metadata={"kernel": "test"}) as writer:
        ports = {
            "pid0.command": writer.add_port("pid0.command", TimedDouble, {"unit": "m/s"}),
            "arm.joints": writer.add_port("arm.joints", TimedDoubleSeq),
            "log": writer.add_port("log", TimedString),
        }
        for i in range(count):
            time = BEGIN + i * MS
            for name, one in (
                ("pid0.command", TimedDouble(time - 5, i / 7)),
                ("arm.joints", TimedDoubleSeq(time, [i * 0.5, -float(i), 1e300, 0.0, 5.0, 6.0])),
                ("log", TimedString(time, f"line {i}")),
            ):
                assert writer.write(ports[name], one, time)
                expected.append((name, time, one))
    assert writer.failure is None
    assert writer.statistics.stored == 3 * count
    return expected


def read(path: Path, **chosen: Any) -> list[Sample]:
    """Everything that is in a recording."""
    with RecordingReader(path) as reader:
        return list(reader.records(**chosen))
