"""A robot's drive as a recording: CSV becomes MCAP, which is replayed at 100 times its speed through the odometry.

Run: python examples/recording/replay.py

Data, NOTICE, system file and its parts are those of examples/roomba.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from aiorts import Kernel, run
from aiorts.system import build, load, wait_finished
from aiorts.types import TimedDouble, TimedDoubleSeq, TimedShortSeq
from aiorts_log import RecordingReader, RecordingWriter

ROOMBA = Path(__file__).parents[1] / "roomba"
PORTS = {
    "encoders": (TimedShortSeq, "count"),
    "gyro": (TimedDoubleSeq, "deg/s"),
    "truth": (TimedDouble, "rad"),
}


def samples(path: Path) -> Iterator[dict[str, Any]]:
    """What the robot measured, row by row; NOTICE says what the columns are."""
    for line in path.read_text().splitlines():
        cells = line.split(",")
        tm = round(float(cells[0]) * 1e9)
        yield {
            "encoders": TimedShortSeq(tm, [int(cells[12]), int(cells[13])]),
            "gyro": TimedDoubleSeq(tm, [float(cell) for cell in cells[4:7]]),
            "truth": TimedDouble(tm, float(cells[14])),
        }


def convert(source: Path, target: Path) -> None:
    """CSV to MCAP by hand; README.md has the command that does it."""
    with RecordingWriter(target) as writer:
        ports = {name: writer.add_port(name, cls, {"unit": unit}) for name, (cls, unit) in PORTS.items()}
        for row in samples(source):
            for name, sample in row.items():
                writer.write(ports[name], sample, sample.tm)


async def replay(drive: Path, driven: Path) -> int:
    """Play it through the system of replay.toml, which records the poses; returns the exit status of its checker."""
    changes = [f"player.logfile={drive}", f"recorder.logfile={driven}", "recorder.min_free=0"]
    async with Kernel() as kernel:
        await build(kernel, load(ROOMBA / "replay.toml", changes))
        await wait_finished(kernel)
    return kernel.exit_status


def main() -> int:
    with tempfile.TemporaryDirectory() as folder:
        drive, driven = Path(folder, "drive.mcap"), Path(folder, "driven.mcap")
        convert(ROOMBA / "imu.txt", drive)
        with RecordingReader(drive) as reader:
            seconds = (reader.end - reader.start) / 1e9
            print(f"recorded: {reader.count} samples of {len(reader.ports)} ports, {seconds:.1f} s")
        status = run(lambda: replay(drive, driven))
        with RecordingReader(driven) as reader:
            print(f"recorded: {reader.count} poses in {(reader.end - reader.start) / 1e9:.2f} s")
        return status


if __name__ == "__main__":
    sys.exit(main())
