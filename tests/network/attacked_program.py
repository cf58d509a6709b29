"""One process of a system that is attacked (see `attack_parts.py`). It takes commands as `linked_program.py` does.

`python attacked_program.py SETTINGS`, which say: `name`, `role`, `address`, `certificates`, and of who is at work
`every`, seconds between two commands. The roles:

- `victim`: a kernel that listens, with a component that runs and writes at 100 Hz.
- `reads`: a kernel that connects to it and reads what is written.
- `operates`: an operator whose session with the victim is open.
"""

from __future__ import annotations

import asyncio
import json
import sys
import time
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

from linked_program import lines, resident  # its folder is the first where this program looks

from aiorts import Component, InPort, Kernel, OutPort, Param, PeriodicContext
from aiorts.errors import AiortsError
from aiorts.links import Links
from aiorts.sessions import Client, Entry
from aiorts.types import TimedLong
from aiorts_zenoh import Network, NetworkSettings
from aiorts_zenoh.gateway import Gateway
from aiorts_zenoh.keys import ClientKeys
from aiorts_zenoh.network import engine_settings
from aiorts_zenoh.security.access import OPERATORS
from aiorts_zenoh.security.tls import secured_by

RATE = 100.0
"""Cycles of the system a second."""
PATIENCE = 60.0
"""Seconds that the operator waits for an answer, so that one that comes late is measured."""


class Drive(Component):
    """Writes its number in each cycle."""

    out = OutPort(TimedLong)
    step = Param(1)
    number = 0
    last = 0.0
    gap = 0.0
    """Seconds between two cycles, the longest since it was asked last."""

    def on_execute(self) -> None:
        now = time.monotonic()
        self.gap, self.last = max(self.gap, now - (self.last or now)), now
        self.number += 1
        self.out.write_nowait(TimedLong(self.number, self.number))


class Sink(Component):
    inp = InPort(TimedLong, length=1_000)


class Victim:
    def __init__(self, kernel: Kernel) -> None:
        self.kernel, self.drive = kernel, Drive("drive")

    async def begin(self) -> None:
        await self.kernel.add(self.drive)
        await self.kernel.start(PeriodicContext(RATE, name="fast"), self.drive, activate=True)

    async def connect(self, to: str) -> None:
        """Link the component with a reader."""
        await self.kernel.connect(self.drive.out, to, length=64)

    async def look(self) -> dict[str, Any]:
        """Cycles since the start, the longest gap between two since the last look, memory, states of the link."""
        gap, self.drive.gap = self.drive.gap, 0.0
        links = self.kernel.service(Links)
        states = [text.partition(":")[0] for text in links.report().values()]
        peers = sorted(f"{peer.host}/{peer.kernel}" for peer in links.peers)
        standing = self.kernel.service(Network).report()["name"]
        return {
            "at": time.monotonic(),
            "cycles": self.drive.number,
            "gap": gap,
            "memory": resident(),
            "blocks": sys.getallocatedblocks(),
            "states": states,
            "peers": peers,
            "standing": standing,
        }

    async def ledger(self) -> dict[str, Any]:
        """What the link has written and lost, and what is under way."""
        (connector,) = self.kernel.connectors.values()
        try:
            one = await self.kernel.service(Links).ledger(connector)
        except AiortsError as error:
            return {"fault": str(error)}
        return {
            "written": one.written,
            "lost": sum(one.dropped.values()) + one.unexplained,
            "under way": one.buffered + one.in_flight,
        }


class Reads:
    def __init__(self, kernel: Kernel) -> None:
        self.kernel, self.read = kernel, 0
        self.reading: asyncio.Task[None]

    async def begin(self) -> None:
        sink = await self.kernel.add(Sink("sink"))

        async def reading() -> None:
            while True:
                await sink.inp.read()
                self.read += 1 + len(sink.inp.drain())

        self.reading = asyncio.ensure_future(reading())

    async def look(self) -> dict[str, Any]:
        """How much was read."""
        return {"read": self.read}


class Operates:
    """Changes a parameter of the victim again and again, in one session."""

    def __init__(self, entry: Entry, every: float) -> None:
        self.entry, self.every = entry, every
        self.done: list[tuple[float, float, str]] = []
        self.begun = 0.0
        self.working: asyncio.Task[None]

    async def begin(self) -> None:
        client = await asyncio.to_thread(Client.open, self.entry)

        async def working() -> None:
            number = 0
            while True:
                number, self.begun, fault = number + 1, time.monotonic(), ""
                values = {"": {"step": number}}
                try:
                    await asyncio.to_thread(client.call, "configure", PATIENCE, component="drive", values=values)
                except AiortsError as error:
                    fault = f"{type(error).__name__}: {error}"
                took = time.monotonic() - self.begun
                self.done.append((self.begun, took, fault))
                self.begun = 0.0
                await asyncio.sleep(max(0.0, self.every - took))

        self.working = asyncio.ensure_future(working())

    async def answers(self) -> list[tuple[float, float, str]]:
        """The commands since the last look, one that waits included: when, seconds until the answer, what was wrong."""
        done, self.done = self.done, []
        return [*done, (self.begun, time.monotonic() - self.begun, "")] if self.begun else done


@asynccontextmanager
async def of_kernel(kind: type[Victim | Reads], settings: dict[str, Any]) -> Any:
    listens = kind is Victim
    zenoh = {"listen" if listens else "connect": settings["address"], "allow_control": listens}
    zenoh |= {"host": f"h{settings['name']}", "certificates": Path(settings["certificates"])}
    async with Kernel(settings["name"], services={"zenoh": zenoh, "control": {"name": settings["name"]}}) as kernel:
        await kernel.service(Network).opened()
        yield kind(kernel)


@asynccontextmanager
async def of_operator(settings: dict[str, Any]) -> Any:
    certificates = Path(settings["certificates"])
    secured = secured_by(certificates, settings["name"], OPERATORS)
    network = engine_settings(NetworkSettings(connect=settings["address"], certificates=certificates), secured)
    folder = Path(settings["folder"])
    gateway = Gateway(folder, ClientKeys("default", settings["name"]), network)
    await gateway.open()
    try:
        (peer,) = [peer for peer in gateway.peers if peer.kernel == "victim"]
        path = str(next(folder.glob("*.sock")))
        entry = Entry(f"{peer.host}/{peer.kernel}", 1, f"{peer.epoch:016x}", path, carried=True)
        yield Operates(entry, settings["every"])
    finally:
        await gateway.close()


async def main(settings: dict[str, Any]) -> None:
    roles: dict[str, Any] = {"victim": Victim, "reads": Reads}
    role = settings["role"]
    async with of_operator(settings) if role == "operates" else of_kernel(roles[role], settings) as program:
        await program.begin()

        async def take(line: bytes) -> None:
            words = json.loads(line)
            print(json.dumps({"answer": await getattr(program, words.pop("do"))(**words)}), flush=True)

        await lines(take)


if __name__ == "__main__":
    asyncio.run(main(json.loads(sys.argv[1])))
