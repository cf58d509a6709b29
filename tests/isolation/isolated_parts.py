"""Components for processes of their own; the processes import this file."""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import logging
import os
import subprocess
import sys
import time
from collections.abc import Mapping
from typing import Any, ClassVar, Protocol

import numpy as np

from aiorts import Component, Goal, InPort, OutPort, Param, Provided, Required
from aiorts.errors import ServiceError
from aiorts.statechart import Chart, On, State
from aiorts.statemachines import MultiModeComponent, StateMachineComponent
from aiorts.types import TimedDoubleSeq, TimedLong, TimedOctetSeq, TimedPose2D
from campaign import CAMPAIGN

LINES = 15_625 if CAMPAIGN else 500
"""Thousands of lines of 66 bytes that the flood writes: about 1 GB."""
BOMB = "import os\nwhile True:\n    try:\n        os.fork()\n    except OSError:\n        pass"


class Source(Component):
    out = OutPort(TimedLong)
    large = OutPort(TimedDoubleSeq)


class Sink(Component):
    inp = InPort(TimedLong, length=10_000)
    large = InPort(TimedDoubleSeq)


class Scale(Component):
    """Multiplies whole numbers; some numbers make it fail in a way of their own."""

    inp = InPort(TimedLong, length=10_000)
    out = OutPort(TimedLong)
    factor: int = Param(2, ge=0)
    configurations: ClassVar[Mapping[str, Mapping[str, object]]] = {"large": {"factor": 1000}}
    secret = "only there"

    async def on_execute(self) -> None:
        for sample in self.inp.drain():
            if sample.data < 0:
                misbehave(sample.data)
            self.out.write_nowait(TimedLong(sample.tm, sample.data * self.factor))

    def check_configuration(self, values: Mapping[str, Any]) -> None:
        if values["factor"] == 13:
            raise ValueError("13 is no factor")


class OneByOne(Component):
    """Takes its time for each sample, and says how many there were when it ends."""

    inp = InPort(TimedLong, length=10_000)
    out = OutPort(TimedLong)
    count = 0

    async def on_execute(self) -> None:
        self.inp.read_nowait()
        await self.sleep(0.001)
        self.count += 1

    def on_deactivated(self) -> None:
        self.out.write_nowait(TimedLong(0, self.count))


class Stubborn(Scale):
    """Its hook goes on for two seconds, whatever cancels it; its process answers meanwhile."""

    async def on_execute(self) -> None:
        for _ in self.inp.drain():
            until = time.monotonic() + 2.0
            while time.monotonic() < until:
                with contextlib.suppress(asyncio.CancelledError):
                    await asyncio.sleep(0.05)


def misbehave(what: int) -> None:
    """Fail in one of several ways."""
    match what:
        case -1:
            raise ValueError("negative")
        case -2:
            ctypes.string_at(0)
        case -3:
            os._exit(3)
        case -4:
            while True:
                pass
        case -5:
            print("word\n" * 49 + "word")
            print("to standard error", file=sys.stderr)
            logging.getLogger("camera").info("to the log")
        case -6:
            keep = [np.ones(1 << 20) for _ in range(10_000)]
            del keep
        case -7:
            subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"], start_new_session=True)
        case -8:
            for _ in range(LINES):
                sys.stdout.write(f"{'word ' * 13}\n" * 1_000)
            sys.stdout.flush()
        case -9:
            subprocess.run([sys.executable, "-c", BOMB], check=False, timeout=60)
        case -10:
            os.execv("/bin/sleep", ["sleep", "60"])
        case -11:
            raise KeyboardInterrupt
        case -12:
            raise ValueError("long " * 600_000)


class SlowStart(Scale):
    """Takes a while to become active, for whoever wants to kill it meanwhile."""

    async def on_activated(self) -> None:
        await self.sleep(0.15)


class Lingers(Component):
    """Does not end while its process is asked to."""

    def on_finalize(self) -> None:
        time.sleep(20.0)


class Spinner(Component):
    """Uses its processor for a quarter of a second for each sample, and says from when until when."""

    inp = InPort(TimedLong)
    out = OutPort(TimedDoubleSeq)

    def on_execute(self) -> None:
        for _ in self.inp.drain():
            began, until = time.monotonic(), time.process_time() + 0.25
            while time.process_time() < until:
                pass
            self.out.write_nowait(TimedDoubleSeq(0, [began, time.monotonic()]))


class Beat(Component):
    """Writes a number in each cycle."""

    out = OutPort(TimedLong)
    beats = 0

    def on_execute(self) -> None:
        self.out.write_nowait(TimedLong(0, self.beats))
        self.beats += 1


class Counted(Component):
    """Reads numbers and sees whether each follows the one before."""

    inp = InPort(TimedLong, length=1_000)
    seen = 0
    wrong = 0

    def on_execute(self) -> None:
        for sample in self.inp.drain():
            self.wrong += sample.data != self.seen
            self.seen += 1


class Ticker(Component):
    """Says which tick it is, twenty times."""

    out = OutPort(TimedLong)
    ticks = 0

    def on_execute(self) -> None:
        self.ticks += 1
        self.out.write_nowait(TimedLong(0, self.ticks))
        if self.ticks == 20:
            self.finish()


class Held(Component):
    """Holds its fifth cycle up for five more ticks of 100 Hz."""

    cycles = 0

    def on_execute(self) -> None:
        self.cycles += 1
        if self.cycles == 5:
            time.sleep(0.055)


class Echo(Component):
    """Gives arrays back."""

    inp = InPort(TimedDoubleSeq)
    out = OutPort(TimedDoubleSeq)

    async def on_execute(self) -> None:
        for sample in self.inp.drain():
            self.out.write_nowait(sample)


class Unmakeable(Component):
    """Refuses to come in."""

    def on_initialize(self) -> None:
        raise RuntimeError("no camera there")


class Single(Component):
    """Takes one connector."""

    inp = InPort(TimedLong, max_connectors=1)


class Growing(Component):
    """Has a port that its class does not declare, and another after every other sample."""

    inp = InPort(TimedLong)

    def on_initialize(self) -> None:
        self.add_port("first", OutPort(TimedDoubleSeq, unit="m", shape=(3,), doc="the first"))

    async def on_execute(self) -> None:
        for sample in self.inp.drain():
            if "more" in self.ports:
                self.remove_port("more")
            else:
                self.add_port("more", OutPort(TimedLong))
            if sample.data:
                self.ports["first"].write_nowait(TimedDoubleSeq(0, np.zeros(3)))  # type: ignore[attr-defined]


class Arm(Protocol):
    """What an arm can do."""

    async def add(self, left: float, right: float = 1.0) -> float: ...
    async def place(self, pose: TimedPose2D) -> list[float]: ...
    async def wait(self, seconds: float) -> str: ...
    async def fail(self, text: str) -> None: ...
    async def die(self) -> None: ...
    async def reach(self, steps: int, end: bool) -> Goal[float, str]: ...
    async def where(self) -> int: ...


class Robot(Component):
    """Has an arm."""

    arm = Provided[Arm](cancel_timeout=0.3)

    async def add(self, left: float, right: float = 1.0) -> float:
        return left + right

    async def place(self, pose: TimedPose2D) -> list[float]:
        return [pose.data.position.x, pose.data.heading]

    async def wait(self, seconds: float) -> str:
        await asyncio.sleep(seconds)
        return "waited"

    async def fail(self, text: str) -> None:
        raise OSError(text)

    async def die(self) -> None:
        os._exit(4)

    async def reach(self, steps: int, end: bool) -> Goal[float, str]:
        goal: Goal[float, str] = Goal()
        goal.on_cancel = goal.cancelled
        for step in range(steps):
            goal.feedback(float(step))
        if end:
            goal.succeed("there")
        return goal

    async def where(self) -> int:
        return os.getpid()


class Client(Component):
    """Calls an arm."""

    arm = Required[Arm](timeout=5.0)


class Caller(Component):
    """Asks its arm for the sum of each number and 1, and what it heard."""

    inp = InPort(TimedLong, length=100)
    out = OutPort(TimedLong)
    arm = Required[Arm](timeout=5.0)

    async def on_execute(self) -> None:
        for sample in self.inp.drain():
            try:
                found = int(await self.arm.proxy.add(sample.data))
                if sample.data == 100:
                    found = int(await (await self.arm.proxy.reach(3, True)).result() == "there")
            except ServiceError as error:
                found = {"ServiceUnavailable": -1, "ServiceFailed": -2}.get(type(error).__name__, -3)
            self.out.write_nowait(TimedLong(sample.tm, found))


class Quick(Protocol):
    """May not wait."""

    def look(self) -> int: ...


class Looker(Component):
    quick = Provided[Quick]()

    def look(self) -> int:
        return 1


class Careful(Component):
    """Writes numbers on, and says of each whether the write was taken, once it knows."""

    inp = InPort(TimedLong, length=10_000)
    out = OutPort(TimedLong)
    taken = OutPort(TimedLong)

    async def on_execute(self) -> None:
        for sample in self.inp.drain():
            taken = await self.out.write(sample)
            self.taken.write_nowait(TimedLong(sample.tm, sample.data if taken else -sample.data))


class Asked(Component):
    """Takes a number when it is asked to, and passes it on."""

    inp = InPort(TimedLong)
    ask = InPort(TimedLong, length=100)
    out = OutPort(TimedLong)

    async def on_execute(self) -> None:
        for _ in self.ask.drain():
            self.out.write_nowait(await self.inp.read())


class Camera(Component):
    """Writes 1 MiB in each cycle."""

    out = OutPort(TimedOctetSeq)
    waits: bool = Param(False)
    number = 0

    async def on_execute(self) -> None:
        self.number += 1
        sample = TimedOctetSeq(self.number, self.number.to_bytes(8, "little") * 131_072)
        if self.waits:
            await self.out.write(sample)
        else:
            self.out.write_nowait(sample)


class Detector(Component):
    """Takes 0.1 s for what has come, and its loop stands still meanwhile."""

    inp = InPort(TimedOctetSeq)
    level: int = Param(0)
    fails: bool = Param(False)

    def on_execute(self) -> None:
        time.sleep(0.1)
        if self.fails:
            raise RuntimeError("told to")
        for sample in self.inp.drain():
            if bytes(sample.data[:8]) != sample.tm.to_bytes(8, "little"):
                raise RuntimeError(f"sample {sample.tm} is another one")


class Door(StateMachineComponent):
    """A state machine."""

    chart = Chart(
        State("closed", On("button", to="open"), initial=True),
        State("open", On("button", to="closed", action="note")),
    )
    noted = OutPort(TimedLong)

    def note(self, data: Any) -> None:
        self.noted.write_nowait(TimedLong(0, data["by"]))


class Lamp(MultiModeComponent):
    """Modes."""

    modes = ("dark", "bright")


class Aged(Component):
    """Reads one sample in each cycle, which takes 50 ms, and says how old it is, in us."""

    inp = InPort(TimedLong)
    out = OutPort(TimedLong)
    blocks: bool = Param(False)

    async def on_execute(self) -> None:
        sample = self.inp.read_nowait()
        self.out.write_nowait(TimedLong(0, (time.time_ns() - sample.tm) // 1_000))
        if self.blocks:
            time.sleep(0.05)
        else:
            await self.sleep(0.05)


class Blocked(Component):
    """Holds its process for some seconds with each sample."""

    inp = InPort(TimedLong)
    seconds: float = Param(0.8)

    def on_execute(self) -> None:
        self.inp.read_nowait()
        time.sleep(self.seconds)
