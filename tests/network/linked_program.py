"""A kernel in a process of its own. It does what lines of JSON on its standard input say, and answers each with one.

`python linked_program.py SETTINGS`, which say: `name`, `zenoh` (settings of the service), `sources` (names), `sinks`
(names and the file that each appends to what it reads, as two numbers of 8 bytes: who wrote it, and its number),
`watches` (seconds between two looks at the states of links).
"""

from __future__ import annotations

import asyncio
import json
import os
import struct
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Protocol

from aiorts import Component, InPort, Kernel, OutPort, Provided, Required
from aiorts.errors import AiortsError, ClosedError
from aiorts.links import Links
from aiorts.types import TimedOctetSeq

WRITER = time.time_ns()
"""Who writes: this process."""


class Echo(Protocol):
    async def echo(self, number: int) -> int: ...

    async def much(self, asked: bytes, answered: int, after: float) -> bytes: ...


class Source(Component):
    out = OutPort(TimedOctetSeq)


class Sink(Component):
    inp = InPort(TimedOctetSeq)


class Answers(Component):
    service = Provided[Echo]()

    async def echo(self, number: int) -> int:
        return number

    async def much(self, asked: bytes, answered: int, after: float) -> bytes:
        await asyncio.sleep(after)
        return bytes(answered)


class Asks(Component):
    service = Required[Echo](timeout=20.0)


def resident() -> int:
    """Bytes of this process that are in memory."""
    with open("/proc/self/statm", encoding="ascii") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")


COUNTED = ("written", "delivered", "buffered", "acknowledged", "in_flight")
JOINED = ("written", "delivered", "buffered", "in_flight", "acknowledged_before", "unexplained")


def table(counts: Any, names: tuple[str, ...]) -> dict[str, Any]:
    """Counts, and what was dropped."""
    return {**{name: getattr(counts, name) for name in names}, "dropped": dict(counts.dropped)}


class Program:
    """What the commands do, each by the name of its method."""

    def __init__(self, kernel: Kernel, settings: dict[str, Any]) -> None:
        self.kernel, self.settings, self.links = kernel, settings, kernel.service(Links)
        self.sources: dict[str, Any] = {}
        self.written: dict[str, int] = {}
        self.refused: dict[str, int] = {}
        self.read: dict[str, int] = {}
        self.ages: dict[str, list[float]] = {}
        self.changes: list[tuple[float, str, str]] = []
        self.calls: list[tuple[float, float, str]] = []
        self.writing: list[asyncio.Task[None]] = []
        self.others: list[asyncio.Task[None]] = []
        self.writes = self.asks = False

    async def begin(self) -> None:
        for name in ("answers", "gives"):
            await self.kernel.add(Answers(name))
        self.asking = {name: await self.kernel.add(Asks(name)) for name in ("asks", "more")}
        for name in self.settings.get("sources", ()):
            self.sources[name] = await self.kernel.add(Source(name))
        for name, file in self.settings.get("sinks", {}).items():
            await self.sink(name, file)
        self.others.append(asyncio.ensure_future(self.watch()))

    async def sink(self, name: str, file: str) -> None:
        """A component that reads."""
        self.others.append(asyncio.ensure_future(self.reading(await self.kernel.add(Sink(name)), file)))

    async def reading(self, sink: Any, file: str) -> None:
        self.read[sink.name], ages = 0, self.ages.setdefault(sink.name, [])
        with open(file, "ab", buffering=0) as output:
            while True:
                try:
                    came = [await sink.inp.read(), *sink.inp.drain()]
                except ClosedError:  # it was removed
                    return
                now = time.monotonic_ns()
                heads = [struct.unpack_from("<QQ", bytes(one.data[:16])) for one in came]
                both = zip(heads, came, strict=True)
                output.write(b"".join(struct.pack("<QQ", writer, one.tm) for (writer, _), one in both))
                self.read[sink.name] += len(came)
                ages += [(now - written) / 1e9 for _, written in heads]

    async def watch(self) -> None:
        """Note each change of the state of a link."""
        before: dict[str, str] = {}
        every = self.settings.get("watches", 0.005)
        while True:
            now = {name: text.partition(":")[0] for name, text in self.links.report().items()}
            for name in now.keys() | before.keys():
                if now.get(name) != before.get(name):
                    self.changes.append((time.monotonic(), name, now.get(name, "")))
            before = now
            await asyncio.sleep(every)

    async def connect(self, source: str, to: str, **options: Any) -> str:
        out = self.asking[source].service if source in self.asking else self.sources[source].out
        return str((await self.kernel.connect(out, to, **options)).name)

    async def disconnect(self, name: str) -> None:
        (connector,) = [one for one in self.kernel.connectors.values() if one.name == name]
        await self.kernel.disconnect(connector)

    async def remove(self, name: str) -> None:
        await self.kernel.remove(self.kernel.components[name])

    async def write(self, sources: list[str], every: float, size: int = 24, count: int = 0) -> None:
        """Write to each, until it is to halt or so often."""
        self.writes = True
        self.writing += [asyncio.ensure_future(self.one(name, every, bytes(size - 16), count)) for name in sources]

    async def one(self, name: str, every: float, rest: bytes, count: int) -> None:
        out = self.sources[name].out
        due = time.monotonic()
        while self.writes and not 0 < count <= self.written.get(name, 0):
            number = self.written.get(name, 0)
            self.written[name] = number + 1
            try:
                await out.write(TimedOctetSeq(number, struct.pack("<QQ", WRITER, time.monotonic_ns()) + rest))
            except AiortsError:
                self.refused[name] = self.refused.get(name, 0) + 1
            due = max(due + every, time.monotonic() - 0.1)
            await asyncio.sleep(max(0.0, due - time.monotonic()))

    async def halt(self, within: float = 30.0) -> dict[str, Any]:
        """Write no more; what was written, when the last write has returned."""
        self.writes = False
        done, left = await asyncio.wait(self.writing, timeout=within) if self.writing else ((), ())
        self.writing = list(left)
        for one in done:
            one.result()
        return {"written": self.written, "refused": self.refused, "unfinished": len(left), "writer": WRITER}

    async def ask(self, every: float) -> None:
        """Call the service that `asks` is connected with, again and again."""
        self.asks = True

        async def asking() -> None:
            number = 0
            while self.asks:
                number, began, fault = number + 1, time.monotonic(), ""
                try:
                    assert await self.asking["asks"].service.proxy.echo(number) == number
                except AiortsError as error:
                    fault = f"{type(error).__name__}: {error}"
                self.calls.append((began, time.monotonic() - began, fault))
                await asyncio.sleep(every)

        self.others.append(asyncio.ensure_future(asking()))

    async def ask_much(self, count: int, asked: int, answered: int, after: float) -> None:
        """Call the service that `more` is connected with so often at once, with so many bytes there and back; the first
        call takes so long, and the others wait for it."""

        async def asking(after: float) -> None:
            with suppress(AiortsError):
                await self.asking["more"].service.proxy.much(bytes(asked), answered, after)

        self.others += [asyncio.ensure_future(asking(0.0 if number else after)) for number in range(count)]

    async def asked(self) -> list[tuple[float, float, str]]:
        """The calls since the last look: when, how long each took, what went wrong."""
        calls, self.calls = self.calls, []
        return calls

    async def block(self, seconds: float) -> None:
        """Hold up the loop."""
        time.sleep(seconds)

    async def look(self) -> dict[str, Any]:
        """How everything stands."""
        for one in (*self.others, *self.writing):
            if one.done():
                one.result()
        counts = {one.name: table(one.statistics, COUNTED) for one in self.kernel.connectors.values()}
        peers = sorted(f"{peer.host}/{peer.kernel}" for peer in self.links.peers)
        ages = {name: found[-2_000:] for name, found in self.ages.items()}
        report = {"states": dict(self.links.report()), "peers": peers, "changes": self.changes, "ages": ages}
        report["ids"] = [f"{name} {id(one):x}" for name, one in self.kernel.connectors.items()]
        return {**report, "counts": counts, "read": self.read, "memory": resident(), "written": self.written}

    async def ledger(self) -> dict[str, Any]:
        """The ledger of each link whose writer is here, of both ends together."""
        found: dict[str, Any] = {}
        for connector in self.kernel.connectors.values():
            if connector.name in self.links.report() and connector.profile.far_end == "reader":
                try:
                    one = await self.links.ledger(connector)
                    found[connector.name] = table(one, JOINED)
                except AiortsError as error:
                    found[connector.name] = {"error": str(error)}
        return found


async def lines(take: Callable[[bytes], Any]) -> None:
    """Call `take` with each line of standard input, one after the other."""
    reader = asyncio.StreamReader()
    await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
    while line := await reader.readline():
        await take(line)


async def main(settings: dict[str, Any]) -> None:
    async with Kernel(settings["name"], services={"zenoh": settings["zenoh"]}) as kernel:
        program = Program(kernel, settings)
        await program.begin()

        async def take(line: bytes) -> None:
            words = json.loads(line)
            try:
                answer = {"answer": await getattr(program, words.pop("do"))(**words)}
            except AiortsError as error:
                answer = {"error": f"{type(error).__name__}: {error}"}
            print(json.dumps(answer), flush=True)

        await lines(take)


if __name__ == "__main__":
    asyncio.run(main(json.loads(sys.argv[1])))
