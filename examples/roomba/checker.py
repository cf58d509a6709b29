"""Compares every heading with the one that the robot computed itself, and says at the end whether all were right."""

from __future__ import annotations

from collections import deque

from aiorts import Component, InPort, Param
from aiorts.types import Pose2D, TimedDouble, TimedPose2D

ORIGIN = Pose2D()


class Checker(Component):
    """Compares each pose with the truth of its row. Exit status 1 and the first wrong row, unless all are right.

    Where the odometry runs in a process of its own that is started anew, it begins at the origin again: from there on
    its heading counts from the truth of that moment, and rows of which no pose has come are counted as lost; the exit
    status is 1 then, too.
    """

    pose = InPort(TimedPose2D)
    truth = InPort(TimedDouble, unit="rad")

    within = Param(1e-6, gt=0.0, unit="rad")

    def on_activated(self) -> None:
        self.poses: deque[TimedPose2D] = deque()
        self.truths: deque[TimedDouble] = deque()
        self.rows = 0
        self.sent = 0
        self.lost = 0
        self.starts, self.anew = 0, False
        self.offset = 0.0
        self.last = ORIGIN
        self.fault = ""

    def on_execute(self) -> None:
        self.sent = max(self.sent, sum(connector.statistics.written for connector in self.truth.connectors))
        self.poses.extend(self.pose.drain())
        self.truths.extend(self.truth.drain())
        while self.poses and self.truths:
            self.compare(self.poses.popleft(), self.truths.popleft())

    def compare(self, pose: TimedPose2D, truth: TimedDouble) -> None:
        if pose.data == ORIGIN and not self.anew and (self.last != ORIGIN or pose.tm > truth.tm):
            self.starts, self.anew = self.starts + 1, True
        self.last = pose.data
        if self.starts and pose.tm > truth.tm:
            self.poses.appendleft(pose)
            self.lost += 1
            return
        if self.anew:
            self.offset, self.anew = truth.data, False
        got, expected = self.offset + pose.data.heading, truth.data
        if not self.fault and pose.tm != truth.tm:
            self.fault = f"row {self.rows} is of time {truth.tm} ns, its pose of {pose.tm} ns"
        if not self.fault and not abs(got - expected) <= self.within:
            self.fault = f"row {self.rows} is wrong: got {got:.6f} rad, expected {expected:.6f} rad"
        self.rows += 1

    def on_deactivated(self) -> None:
        if self.starts:
            self.lost += len(self.truths)
            self.truths.clear()
        if self.truths or self.poses:
            self.fault = self.fault or f"row {self.rows} has no {'pose' if self.truths else 'truth'}"
        sent = max(self.sent, sum(connector.statistics.written for connector in self.truth.connectors))
        if self.rows + self.lost != sent or not self.rows:
            self.fault = self.fault or f"{self.rows} of {sent} rows arrived"
        if self.fault:
            print(f"heading not verified: {self.fault}")
            self.kernel.request_stop(1)
        else:
            within = f"{self.within:g}".replace("e-0", "e-")
            anew = f"; {self.lost} rows were lost, the odometry began anew {self.starts} time(s)" if self.starts else ""
            print(f"heading verified: {self.rows} of {sent} within {within} rad{anew}")
            if self.starts:
                self.kernel.request_stop(1)
