"""A program that knows `zenoh`, `msgpack` and SPEC.md alone: kernels list, link and operate it, and it them."""

from __future__ import annotations

import ast
import asyncio
import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from queue import Empty, Queue
from typing import Any, Protocol

import pytest

from aiorts import Component, InPort, Kernel, OutPort, Param, Provided
from aiorts.errors import WiringError
from aiorts.links import Links
from aiorts.types import TimedDouble, TimedLong

pytest.importorskip("zenoh")

from network import vector_parts
from network.network_parts import free_port
from network.test_router import start as start_router

WAIT = 20.0
NAME = f"robot-{os.getpid()}"
"""By which other kernels reach the kernel of a test: of this machine no other has it."""
PROGRAM = Path(__file__).with_name("foreign_program.py")
ALLOWED = {"__future__", "msgpack", "zenoh"} | sys.stdlib_module_names


class Foreign:
    """A program in a process of its own, which listens, or connects to what listens at an address."""

    def __init__(self, *words: str) -> None:
        self.address = f"127.0.0.1:{free_port()}"
        command = words or (sys.executable, str(PROGRAM), "listen", self.address, "abroad", "stranger")
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self._lines: Queue[str] = Queue()
        self._reading = threading.Thread(target=self._read, daemon=True)
        self._reading.start()
        assert self.answer() == "ready"

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self._lines.put(line)

    def answer(self) -> Any:
        """What it says next."""
        try:
            return json.loads(self._lines.get(timeout=WAIT))
        except Empty:
            raise AssertionError(f"no answer; its status is {self.process.poll()}") from None

    async def do(self, what: str, **given: object) -> Any:
        """What it answers when it is to do something; the loop goes on meanwhile, which may have to answer it."""
        return await self.say(json.dumps({"do": what, **given}))

    async def say(self, line: str) -> Any:
        """What it answers to a line."""
        assert self.process.stdin is not None
        self.process.stdin.write(f"{line}\n")
        self.process.stdin.flush()
        return await asyncio.to_thread(self.answer)

    def close(self) -> None:
        with self.process as process:
            process.kill()
            process.wait(WAIT)
            self._reading.join(WAIT)


@pytest.fixture
def foreign() -> Iterator[Foreign]:
    program = Foreign()
    try:
        yield program
    finally:
        program.close()


class Sum(Protocol):
    async def add(self, a: int, b: int) -> int: ...


class Adder(Component):
    sums = Provided[Sum](concurrent=True)

    async def add(self, a: int, b: int) -> int:
        return a + b


class Number(Component):
    out = OutPort(TimedLong)
    other = OutPort(TimedDouble)
    gain = Param(1)


class Sink(Component):
    inp = InPort(TimedLong, length=1_000)
    other = InPort(TimedDouble)


def kernel_at(address: str, way: str = "connect") -> Kernel:
    """A kernel that reaches that program, and lets it operate."""
    network = {way: address, "host": "here", "insecure": True, "allow_control": True}
    return Kernel(NAME, services={"control": {"name": NAME}, "zenoh": network})


async def until(what: Callable[[], Any], meant: Callable[[Any], bool]) -> Any:
    """What is found when it is what is meant."""
    end = time.monotonic() + WAIT
    while not meant(found := what()):
        assert time.monotonic() < end, found
        await asyncio.sleep(0.05)
    return found


async def received(foreign: Foreign, count: int) -> list[int]:
    """What has come to its in-port, when it is so many."""
    found: list[int] = []
    end = time.monotonic() + WAIT
    while len(found) < count:
        assert time.monotonic() < end, found
        found += await foreign.do("received")
    return found


def test_it_imports_nothing_of_aiorts() -> None:
    tree = ast.parse(PROGRAM.read_text(encoding="utf-8"))
    names = [alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names]
    names += [node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    assert {name.partition(".")[0] for name in names} <= ALLOWED


def at(foreign: Foreign, *words: str) -> tuple[int, str]:
    """Status and output of a command that has the kernels that are reached there, and no others."""
    command = [sys.executable, "-m", "aiorts", "at", "--as", "tester", "--insecure-network", foreign.address, *words]
    with tempfile.TemporaryDirectory(prefix="ai") as folder:
        environment = os.environ | {"XDG_RUNTIME_DIR": folder}
        done = subprocess.run(command, capture_output=True, text=True, timeout=WAIT, env=environment, check=False)
    return done.returncode, done.stdout + done.stderr


def operate(foreign: Foreign) -> None:
    """List it, run it and set its parameter with commands."""
    end = time.monotonic() + WAIT
    while (said := at(foreign, "ls", "-l", "stranger")) != (0, "") and "twin" not in said[1]:
        assert time.monotonic() < end, said
    assert "inactive" in said[1]
    assert at(foreign, "activate", "twin") == (0, "")
    assert "inactive" not in at(foreign, "ls", "-l", "stranger")[1]
    assert at(foreign, "conf", "twin", "step=7") == (0, "")
    assert at(foreign, "conf", "abroad/stranger/twin")[1].split()[-2:] == ["step", "7"]
    assert "E-ABSENT" in at(foreign, "conf", "stranger/twon", "step=7")[1]


@pytest.mark.slow(kept_by="test_it_lists_reads_writes_and_calls_a_kernel")
@pytest.mark.row(91)
def test_commands_list_and_operate_it(foreign: Foreign) -> None:
    operate(foreign)
    assert at(foreign, "deactivate", "twin") == (0, "")
    assert "inactive" in at(foreign, "ls", "-l", "stranger")[1]


@pytest.mark.slow(kept_by="test_it_lists_reads_writes_and_calls_a_kernel")
def test_a_kernel_reads_of_it_and_writes_to_it(foreign: Foreign) -> None:
    async def run() -> None:
        async with kernel_at(foreign.address) as kernel:
            number, sink = await kernel.add(Number("number")), await kernel.add(Sink("sink"))
            links = kernel.service(Links)
            await until(lambda: links.peers, bool)
            with pytest.raises(WiringError, match="types differ"):
                await kernel.connect(number.other, "stranger/twin.inp")
            with pytest.raises(WiringError, match="is no out-port"):
                await kernel.connect("stranger/twin.none", sink.inp)

            written = await kernel.connect(number.out, "stranger/twin.inp", full="block", timeout=WAIT)
            for value in range(2_000):  # several times the window, and what its credits let through
                await number.out.write(TimedLong(value, value))
            assert await received(foreign, 2_000) == list(range(2_000))
            ledger = await links.ledger(written)
            assert (ledger.written, ledger.delivered, ledger.unexplained) == (2_000, 2_000, 0)

            await kernel.connect("abroad/stranger/twin.out", sink.inp, full="block")
            await asyncio.to_thread(operate, foreign)
            values = [(await sink.inp.read(timeout=WAIT)).data for _ in range(200)]
            while values[-1] - values[-2] != 7:  # until its parameter is in force
                values.append((await sink.inp.read(timeout=WAIT)).data)
            assert values[0] == 1
            assert {later - early for early, later in pairwise(values)} == {1, 7}  # none is lost

    asyncio.run(run())


@pytest.mark.slow(kept_by="first")
@pytest.mark.row(91)
def test_it_lists_reads_writes_and_calls_a_kernel(foreign: Foreign) -> None:
    async def run() -> None:
        async with kernel_at(foreign.address) as kernel:
            number, sink = await kernel.add(Number("number")), await kernel.add(Sink("sink"))
            await kernel.add(Adder("adder"))
            here, end = f"here/{NAME}", time.monotonic() + WAIT
            while here not in (found := await foreign.do("list")):
                assert time.monotonic() < end, found
            assert list(found[here]["ok"]["components"]) == ["number", "sink", "adder"]

            robot = {"kernel": here}
            change = {"component": "number", "values": {"": {"gain": 3}}}
            assert await foreign.do("call", **robot, operation="configure", args=change) == {"ok": {"text": ""}}
            assert number.gain == 3
            denied = await foreign.do("call", **robot, branch="info", operation="configure", args=change)
            assert denied["error"]["code"] == "E-DENIED"
            (said,) = await foreign.do("session", **robot, operation="configuration", args={"component": "number"})
            assert said["ok"]["sets"]["default"] == {"gain": 3}

            call = {"port": f"{NAME}/adder.sums", "interface": "Sum", "method": "add"}
            assert await foreign.do("service", **robot, **call, args=[20, 22]) == [True, ["done", [42]]]

            await foreign.do("write", **robot, port=f"{NAME}/sink.inp", values=list(range(100)), **{"as": "more"})
            assert [(await sink.inp.read(timeout=WAIT)).data for _ in range(100)] == list(range(100))

            assert await foreign.do("read", **robot, port=f"{NAME}/number.out") == [True, [0, 0, "", "", [1, 1]]]
            links = kernel.service(Links)
            await until(lambda: list(links.report().values()), lambda found: found == ["up", "up"])
            for value in range(5):
                await number.out.write(TimedLong(value, value))
            assert await received(foreign, 5) == [0, 1, 2, 3, 4]

    asyncio.run(run())


@pytest.mark.slow(kept_by="test_it_lists_reads_writes_and_calls_a_kernel")
def test_the_same_in_c(tmp_path: Path) -> None:
    """A program in C that knows zenoh-pico and SPEC.md alone is linked, listed and operated, and does the same."""
    found = shutil.which("pkg-config") and shutil.which("cc")
    if not found or subprocess.run(["pkg-config", "--exists", "zenohpico"], check=False, timeout=10).returncode:
        pytest.skip("not run: zenoh-pico is not installed (pkg-config zenohpico), or there is no C compiler")
    flags = subprocess.run(
        ["pkg-config", "--cflags", "--libs", "zenohpico"], capture_output=True, text=True, check=True, timeout=10
    ).stdout.split()
    program = tmp_path / "client"
    source = ["-std=gnu11", "-O1", "-DZENOH_LINUX", "-o", str(program), str(PROGRAM.with_name("foreign_client.c"))]
    subprocess.run(["cc", *source, *flags, "-lpthread"], check=True, timeout=60)
    address = f"127.0.0.1:{free_port()}"
    (kind,) = (one for one in vector_parts.types()["types"] if one["name"] == "TimedLong")
    with start_router(address) as router:
        try:
            foreign = Foreign(str(program), address, "abroad", "stranger", kind["hash"], kind["layout"])
            foreign.address = address
            try:
                asyncio.run(all_with(foreign))
            finally:
                foreign.close()
        finally:
            router.kill()


async def all_with(foreign: Foreign) -> None:
    """All that a program can do, with one that takes lines of words."""
    here = f"here/{NAME}"
    async with kernel_at(foreign.address) as kernel:
        number, sink = await kernel.add(Number("number")), await kernel.add(Sink("sink"))
        links = kernel.service(Links)
        await until(lambda: links.peers, bool)
        end = time.monotonic() + WAIT
        while here not in (found := await foreign.say("list")):
            assert time.monotonic() < end, found
        assert await foreign.say(f"names {here}") == ["number", "sink"]
        assert await foreign.say(f"set {here} number gain 3") == []
        assert number.gain == 3
        with pytest.raises(WiringError, match="types differ"):
            await kernel.connect(number.other, "stranger/twin.inp")

        written = await kernel.connect(number.out, "stranger/twin.inp", full="block", timeout=WAIT)
        for value in range(2_000):
            await number.out.write(TimedLong(value, value))
        came: list[int] = []
        end = time.monotonic() + WAIT
        while len(came) < 2_000:
            assert time.monotonic() < end, len(came)
            came += await foreign.say("received")
        assert came == list(range(2_000))
        await kernel.disconnect(written)

        assert await foreign.say(" ".join(["write", here, f"{NAME}/sink.inp", *map(str, range(100))])) is None
        assert [(await sink.inp.read(timeout=WAIT)).data for _ in range(100)] == list(range(100))
        assert await foreign.say(f"read {here} {NAME}/number.out") == ""
        await until(lambda: list(links.report().values()), lambda found: found == ["up", "up"])
        for value in range(5):
            await number.out.write(TimedLong(value, value))
        came, end = [], time.monotonic() + WAIT
        while len(came) < 5:
            assert time.monotonic() < end, came
            came += await foreign.say("received")
        assert came == [0, 1, 2, 3, 4]

        await kernel.connect("abroad/stranger/twin.out", sink.inp, full="block")
        await asyncio.to_thread(operate, foreign)
        values = [(await sink.inp.read(timeout=WAIT)).data for _ in range(200)]
        while values[-1] - values[-2] != 7:
            values.append((await sink.inp.read(timeout=WAIT)).data)
        assert {later - early for early, later in pairwise(values)} == {1, 7}
