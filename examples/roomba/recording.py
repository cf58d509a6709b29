"""Plays a recording: one sample of each sensor for each row, when its time has come."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from aiorts import Component, OutPort, Param
from aiorts.types import TimedDouble, TimedDoubleSeq, TimedShortSeq

COLUMNS = 15


@dataclass(frozen=True)
class Row:
    """One line of the file as samples; NOTICE says what its columns are."""

    truth: TimedDouble
    gyro: TimedDoubleSeq
    acceleration: TimedDoubleSeq
    encoders: TimedShortSeq


class Recording(Component):
    """Sends the rows of a file at their own pace, `speed` times as fast, and finishes after the last."""

    encoders = OutPort(TimedShortSeq, unit="count", doc="left, right wheel; signed 16 bit, wraps")
    gyro = OutPort(TimedDoubleSeq, unit="deg/s", doc="angular rate x, y, z")
    acceleration = OutPort(TimedDoubleSeq, unit="m/s^2", doc="linear acceleration x, y, z")
    truth = OutPort(TimedDouble, unit="rad", doc="the robot's own heading, clockwise positive")

    path = Param(Path("imu.txt"), file="read", doc="the file to play")
    speed = Param(1.0, gt=0.0, doc="times as fast as recorded")

    def on_initialize(self) -> None:
        self.rows = read_rows(self.path)

    def on_activated(self) -> None:
        self.next = 0
        self.start = self.clock.monotonic_ns()

    async def on_execute(self) -> None:
        played = self.speed * (self.clock.monotonic_ns() - self.start)
        while self.next < len(self.rows) and self.rows[self.next].truth.tm <= played:
            row = self.rows[self.next]
            await self.truth.write(row.truth)
            await self.gyro.write(row.gyro)
            await self.acceleration.write(row.acceleration)
            await self.encoders.write(row.encoders)
            self.next += 1
        if self.next == len(self.rows):
            self.finish()


def read_rows(path: Path) -> list[Row]:
    """The rows of a recording; ValueError names the file and the line that is wrong."""
    rows = []
    for number, line in enumerate(path.read_text("utf-8", "replace").splitlines(), start=1):
        try:
            rows.append(parse(line))
        except (ValueError, OverflowError) as error:
            raise ValueError(f"{path}:{number}: {error}") from None
    return rows


def parse(line: str) -> Row:
    cells = line.split(",")
    if len(cells) != COLUMNS:
        raise ValueError(f"expected {COLUMNS} columns, got {len(cells)}")
    numbers = [float(cell) for cell in cells]
    tm = round(numbers[0] * 1e9)
    return Row(
        truth=TimedDouble(tm, numbers[14]),
        gyro=TimedDoubleSeq(tm, numbers[4:7]),
        acceleration=TimedDoubleSeq(tm, numbers[1:4]),
        encoders=TimedShortSeq(tm, [int(cells[12]), int(cells[13])]),
    )
