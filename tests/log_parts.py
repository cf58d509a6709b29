"""What the tests of recordings share: small recordings, and what is in them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from aiorts.types import TimedDouble, TimedDoubleSeq, TimedString
from aiorts_log import RecordingOptions, RecordingReader, RecordingWriter

BEGIN = 1_700_000_000_000_000_000
MS = 1_000_000
Sample = tuple[str, int, Any]


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
            for name, record in (
                ("pid0.command", TimedDouble(time - 5, i / 7)),
                ("arm.joints", TimedDoubleSeq(time, [i * 0.5, -float(i), 1e300, 0.0, 5.0, 6.0])),
                ("log", TimedString(time, f"line {i}")),
            ):
                assert writer.write(ports[name], record, time)
                expected.append((name, time, record))
    assert writer.failure is None
    assert writer.statistics.stored == 3 * count
    return expected


def read(path: Path, **chosen: Any) -> list[Sample]:
    """Everything that is in a recording."""
    with RecordingReader(path) as reader:
        return list(reader.records(**chosen))
