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
    """CSV to MCAP by hand, three ports at a time; `aiorts log convert` does it port by port."""
    with RecordingWriter(target) as writer:
        ports = {name: writer.add_port(name, cls, {"unit": unit}) for name, (cls, unit) in PORTS.items()}
        for row in samples(source):
            for name, sample in row.items():
                writer.write(ports[name], sample, sample.tm)


async def replay(path: Path) -> int:
    """Play it through the system of replay.toml; the exit status that its checker asked for."""
    async with Kernel() as kernel:
        await build(kernel, load(ROOMBA / "replay.toml", [f"player.logfile={path}"]))
        await wait_finished(kernel)
    return kernel.exit_status


def main() -> int:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "drive.mcap")
        convert(ROOMBA / "imu.txt", path)
        with RecordingReader(path) as reader:
            seconds = (reader.end - reader.start) / 1e9
            print(f"recorded: {reader.count} samples of {len(reader.ports)} ports, {seconds:.1f} s")
        return run(lambda: replay(path))


if __name__ == "__main__":
    sys.exit(main())
