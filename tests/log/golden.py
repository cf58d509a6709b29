"""Makes the files of `golden/`, which are kept forever: every later version has to read them. Never run it again."""

from __future__ import annotations

from pathlib import Path

from aiorts.types import Point3D, TimedDoubleSeq, TimedPoint3D, TimedString
from aiorts_log import RecordingOptions, RecordingWriter
from aiorts_log.mcap.format import record
from aiorts_log.mcap.index import read_index
from aiorts_log.mcap.source import Limits, Source
from log_parts import TRIPS, Trip

FOLDER = Path(__file__).parent / "golden"
BEGIN = 1_700_000_000_000_000_000


def fields() -> None:
    """Write those with fields that may be absent, moments, few values and maps of maps."""
    for encoding in ("msgpack", "json"):
        path = FOLDER / f"fields-{encoding}-1.0.mcap"
        if not path.exists():
            with RecordingWriter(path, RecordingOptions(min_free=0, encoding=encoding)) as writer:
                port = writer.add_port("trip", Trip)
                for number, trip in enumerate(TRIPS):
                    assert writer.write(port, trip, BEGIN + number)


def main() -> None:
    """Write the first two."""
    path = FOLDER / "format-1.0.mcap"
    with RecordingWriter(path, RecordingOptions(min_free=0), metadata={"kernel": "golden"}) as writer:
        ports = [
            writer.add_port("text", TimedString),
            writer.add_port("array", TimedDoubleSeq),
            writer.add_port("point", TimedPoint3D),
            writer.add_port("number", float),
            writer.add_port("octets", bytes),
        ]
        for i in range(2):
            time = BEGIN + i
            values = (
                TimedString(time, "äöü\x1b"),
                TimedDoubleSeq(time, [1.0, float("nan")]),
                TimedPoint3D(time, Point3D(1.0, 2.0, 3.0)),
                1.5,
                b"\0\xff",
            )
            for port, value in zip(ports, values, strict=True):
                writer.write(port, value, time)
    source = Source(path, Limits())
    found = read_index(source)
    assert found is not None
    summary, stop = found
    source.close()
    whole = path.read_bytes()
    # A newer minor version has records that this one does not know: one in the data, one in the summary.
    unknown = record(0x42, b"of the future")
    parts = summary.put(stop + len(unknown))
    body = parts[1] + unknown
    import struct
    import zlib

    crc = zlib.crc32(parts[2], zlib.crc32(body))
    newer = whole[:stop] + unknown + parts[0] + body + parts[2] + struct.pack("<I", crc) + parts[4]
    (FOLDER / "format-1.7.mcap").write_bytes(newer.replace(b"format 1.0", b"format 1.7", 1))


if __name__ == "__main__":
    fields()  # the first two are there: main() made them
