"""Systems that the studio is measured with. `python tests/studio_measured.py` is a kernel that tells how late it is."""

from __future__ import annotations

import asyncio
import os
import random
import sys
from pathlib import Path

from aiorts import Component, InPort, Kernel, OutPort, PeriodicContext
from aiorts.types import TimedDouble
from campaign import CAMPAIGN

COMPONENTS, CONTEXTS = 1_000, 40
NODE = '''
import time
from aiorts import Component, InPort, OutPort
from aiorts.types import TimedDouble

class Node(Component):
    in0, in1 = InPort(TimedDouble), InPort(TimedDouble)
    out0, out1 = OutPort(TimedDouble), OutPort(TimedDouble)

    async def on_execute(self):
        self.in0.drain()
        self.in1.drain()
        self.out0.write_nowait(TimedDouble(data=1.0))
        self.out1.write_nowait(TimedDouble(data=2.0))

class Growing(Component):
    """Gets a port each second whose name is the time."""

    cycles = 0

    async def on_execute(self):
        self.cycles += 1
        if self.cycles % 10 == 0:
            self.add_port(f"t{time.time_ns() // 1_000_000}", OutPort(TimedDouble))
'''
GROWING = """
[components.growing]
type = "node.py:Growing"
[contexts.growing]
kind = "periodic"
rate = 10.0
members = ["growing"]
"""


def load() -> float:
    """How many processes share a core."""
    return max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1))


def slower() -> float:
    """By how much a bound is wider: for each process that shares a core 1.5 times in a campaign, else four times.

    Machines differ, and what has become slow is found all the same.
    """
    return (1.5 if CAMPAIGN else 4.0) * load()


def large(folder: Path, *, components: int = COMPONENTS, rate: float = 10.0, grows: bool = False) -> Path:
    """A system file of so many components in 40 contexts, and twice as many connectors; perhaps one that gets ports."""
    chance = random.Random(1)
    names = [f"node{number}" for number in range(components)]
    text = "schema = 1\n" + "".join(f'[components.{name}]\ntype = "node.py:Node"\n' for name in names)
    ends = [(at, out) for at in range(components) for out in (0, 1)]
    for at, out in ends[: 2 * components]:
        reader = min(components - 1, at + 1 + chance.randrange(40)) if at + 1 < components else 0
        text += f'[[connections]]\nfrom = "node{at}.out{out}"\nto = "node{reader}.in{out}"\n'
    each = -(-components // CONTEXTS)
    for number, first in enumerate(range(0, components, each)):
        members = ", ".join(f'"{name}"' for name in names[first : first + each])
        text += f'[contexts.c{number}]\nkind = "periodic"\nrate = {rate}\nmembers = [{members}]\n'
    (folder / "node.py").write_text(NODE, encoding="utf-8")
    path = folder / "large.toml"
    path.write_text(text + GROWING * grows, encoding="utf-8")
    return path


class Punctual(Component):
    """Writes, reads, and notes how late each cycle is."""

    out, in_ = OutPort(TimedDouble), InPort(TimedDouble, name="in")

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        self.late: list[int] = []

    async def on_execute(self) -> None:
        context = self.context
        assert isinstance(context, PeriodicContext)
        assert context.due_ns is not None
        self.late.append(self.clock.monotonic_ns() - context.due_ns)
        self.in_.drain()
        self.out.write_nowait(TimedDouble(data=1.0))


async def punctual(count: int = 10) -> None:
    """A kernel "punctual" of contexts at 100 Hz; a line of input asks for the p99 since the last."""
    async with Kernel(services={"control": {"name": "punctual", "mode": "on"}}) as kernel:
        own = [await kernel.create(Punctual, f"punctual{number}") for number in range(count)]
        for number, one in enumerate(own):
            await kernel.connect(one.out, own[(number + 1) % count].in_)
            await kernel.start(PeriodicContext(100.0, name=f"at{number}"), one, activate=True)
        print("runs", flush=True)
        while await asyncio.to_thread(sys.stdin.readline):
            late = sorted(ns for one in own for ns in one.late)
            for one in own:
                one.late.clear()
            print(late[len(late) * 99 // 100], flush=True)


if __name__ == "__main__":
    asyncio.run(punctual())
