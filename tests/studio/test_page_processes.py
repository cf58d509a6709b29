"""The page's server beside real runs: links, isolated components, recordings, and `aiorts run --studio`."""

from __future__ import annotations

import asyncio
import os
import pty
import re
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from queue import Queue

import pytest

from aiorts.cli.app import run_command
from control_parts import WAIT, running, until
from studio_page import paging
from studio_parts import Site, serving

pytestmark = [pytest.mark.slow, pytest.mark.row(120)]
EXAMPLES = Path(__file__).parents[2] / "examples"
ROOMBA = str(EXAMPLES / "roomba/system.toml")
PARTS = """
from aiorts import Component, InPort, OutPort

class Source(Component):
    out = OutPort(int)
    count = 0

    def on_execute(self):
        self.count += 1
        self.out.write_nowait(self.count)

class Sink(Component):
    in_ = InPort(int, name="in")

    def on_execute(self):
        self.in_.drain()
"""
SOURCE = """
schema = 1
[links]
name = "alpha"
[components.source]
type = "parts.py:Source"
[[connections]]
from = "source.out"
to = "beta/sink.in"
[contexts.loop]
kind = "periodic"
rate = 50.0
members = ["source"]
"""
SINK = """
schema = 1
[links]
name = "beta"
[components.sink]
type = "parts.py:Sink"
[contexts.loop]
kind = "periodic"
rate = 50.0
members = ["sink"]
"""


@contextmanager
def linked(folder: Path, *watched: str) -> Iterator[Site]:
    """A server beside two kernels, of which `alpha` writes to `beta`."""
    (folder / "parts.py").write_text(PARTS)
    for name, system in (("beta", SINK), ("alpha", SOURCE)):
        (folder / f"{name}.toml").write_text(system)
    with (
        running("beta", str(folder / "beta.toml")),
        running("alpha", str(folder / "alpha.toml")),
        serving(*watched) as (_, client),
    ):
        yield client


def test_a_link_is_one_edge_of_two_kernels(tmp_path: Path) -> None:
    async def look() -> None:
        await client.enter()
        async with paging(client) as page:
            await page.until(lambda: page.box("source") and page.box("sink"))
            ends = [[page.box("source")["id"], "out"], [page.box("sink")["id"], "in"]]

            def joined() -> bool:
                found = list(page.edges.values())
                return len(found) == 1 and [found[0]["from"], found[0]["to"]] == ends and found[0]["state"] == "up"

            await page.until(joined)
            assert len(page.boxes) == 2
            (edge,) = page.edges.values()
            assert edge["link"]
            await page.until(lambda: (page.figures.get(edge["id"]) or [None])[0])

    with linked(tmp_path) as client:
        asyncio.run(look())


def test_the_far_end_of_a_link_to_a_kernel_that_is_not_watched_stands_apart(tmp_path: Path) -> None:
    async def look() -> None:
        await client.enter()
        async with paging(client) as page:
            far = await page.until(lambda: page.box("beta/sink"))
            source, frame = page.box("source"), page.frames[far["frame"]]
            assert (frame["name"], frame["said"]) == ("elsewhere", "other kernels")
            assert page.frames[source["frame"]]["name"] == "loop"

    with linked(tmp_path, "alpha") as client:
        asyncio.run(look())


def test_isolated_components_have_a_frame_of_their_process() -> None:
    async def look() -> None:
        await client.enter()
        async with paging(client) as page:
            frame = await page.until(
                lambda: next((one for one in page.frames.values() if one["kind"] == "process"), None)
            )
            assert re.search(r"process \d+", frame["said"])
            assert any(one["frame"] == frame["id"] for one in page.boxes.values())
            pid = int(frame["said"].rpartition(" ")[2])
            os.kill(pid, signal.SIGKILL)  # it is started anew
            await page.until(lambda: frame["id"] in page.frames and f"{pid}" not in page.frames[frame["id"]]["said"])
            assert re.search(r"process \d+", page.frames[frame["id"]]["said"])

    with running("robot", str(EXAMPLES / "roomba/isolated.toml")), serving() as (_, client):
        asyncio.run(look())


def test_events_say_that_a_kernel_has_not_answered(tmp_path: Path) -> None:
    (tmp_path / "parts.py").write_text(PARTS)
    (tmp_path / "beta.toml").write_text(SINK)

    async def look(pid: int) -> None:
        await client.enter()
        async with paging(client) as page:
            await page.until(lambda: page.is_live("beta"))
            os.kill(pid, signal.SIGSTOP)
            try:
                await page.until(lambda: page.kernel("beta")["state"] == "silent")
            finally:
                os.kill(pid, signal.SIGCONT)
            await page.until(lambda: page.is_live("beta"))
            await page.say("events", on=True)
            history = await page.heard("history")
            found = [(one["kind"], one["text"]) for one in history["items"] if one["kind"].startswith("Kernel")]
            assert found == [("KernelSilent", "does not answer"), ("KernelAnswers", "")]

    with running("beta", str(tmp_path / "beta.toml")) as process, serving("beta") as (_, client):
        asyncio.run(look(process.pid))


def test_ports_are_recorded_into_the_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    async def record() -> str:
        await client.enter()
        async with paging(client) as page:
            await page.until(lambda: page.is_live("robot") and page.boxes)
            address = page.kernel("robot")["address"]
            box = await page.until(lambda: next((one for one in page.boxes.values() if outs(one)), None))
            ports = [[address, f"{box['name']}.{outs(box)[0]}"]]
            await page.say("record", on=True, ports=ports)
            await page.say("record", on=True, ports=ports)
            assert "goes on" in str(await page.heard("recording", lambda one: one["why"]))
            await asyncio.sleep(4.0)  # samples come meanwhile
            await page.say("record", on=False)
            done = await page.heard("recording", lambda one: one["samples"])
            assert not done["on"]
            return str(done["file"])

    with running("robot", ROOMBA), serving("--files", str(tmp_path)) as (_, client):
        name = asyncio.run(record())
    assert [one.name for one in tmp_path.iterdir()] == [name]
    assert run_command(["log", "info", str(tmp_path / name)]) == 0
    assert "samples" in capsys.readouterr().out


def outs(box: dict[str, object]) -> list[str]:
    ports = box["ports"]
    assert isinstance(ports, list)
    return [one["name"] for one in ports if one["side"] == "out" and one["kind"] == "data"]


def test_without_a_folder_nothing_is_recorded() -> None:
    async def record() -> None:
        await client.enter()
        async with paging(client) as page:
            box = await page.until(lambda: next((one for one in page.boxes.values() if outs(one)), None))
            await page.say("record", on=True, ports=[[box["kernel"], f"{box['name']}.{outs(box)[0]}"]])
            assert "--files" in (await page.heard("recording", lambda one: one["why"]))["why"]

    with running("robot", ROOMBA), serving() as (_, client):
        asyncio.run(record())


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_the_page_of_a_run_ends_with_the_run(runtime: str, number: int) -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "aiorts", "run", "--name", "robot", "--studio", ROOMBA],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    lines: Queue[str] = Queue()
    assert process.stderr is not None
    reading = threading.Thread(target=lambda: [lines.put(one) for one in process.stderr or ()], daemon=True)
    reading.start()
    try:
        end = time.monotonic() + WAIT
        while "http://127.0.0.1:" not in lines.get(timeout=max(0.1, end - time.monotonic())):
            pass
        listed = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
        (server,) = [one for one in listed if b"--beside" in Path(f"/proc/{one}/cmdline").read_bytes()]
        given = Path(f"/proc/{server}/cmdline").read_bytes().split(b"\0")
        assert given[given.index(b"--layout") + 1].decode() == ROOMBA.replace(".toml", ".layout.json")
        os.kill(process.pid, number)
        process.wait(WAIT)
        until(lambda: not is_running(int(server)))
    finally:
        process.kill()
        process.wait(WAIT)
        reading.join(WAIT)
        process.stderr.close()


def test_at_a_terminal_the_page_of_a_run_outlasts_it_and_its_address_comes_first(runtime: str) -> None:
    """The page that is opened after the end shows what ran; Ctrl-C ends it, with the status of the run."""
    master, slave = pty.openpty()
    words = [sys.executable, "-m", "aiorts", "run", "--name", "robot", "--studio", "--no-status", "--for", "1", ROOMBA]
    process = subprocess.Popen(words, stdin=slave, stdout=slave, stderr=slave, start_new_session=True)
    os.close(slave)
    printed = b""
    try:
        end = time.monotonic() + 2 * WAIT
        while (found := re.search(rb"ended with status (\d+); its page stays at (\S+)/#(\S+);", printed)) is None:
            assert select.select([master], [], [], max(0.1, end - time.monotonic()))[0], printed
            printed += os.read(master, 65_536)
        status, origin, code = (one.decode() for one in found.groups())
        first = printed.decode().split("aiorts studio: ")
        assert first[0].strip() == ""
        assert first[1].startswith(f"{origin}/#")
        client = Site(int(origin.rpartition(":")[2]), code)

        async def look() -> None:
            await client.enter()
            async with paging(client) as page:
                await page.until(lambda: page.kernel("robot")["why"] == f"has ended with status {status}")
                await page.until(lambda: {one["state"] for one in page.boxes.values()} == {"ended"})
                assert any(one["kind"] == "context" for one in page.frames.values())
                await page.until(lambda: page.figures)

        asyncio.run(look())
        assert process.poll() is None
        os.killpg(process.pid, signal.SIGINT)
        assert process.wait(WAIT) == int(status)
    finally:
        process.kill()
        process.wait(WAIT)
        os.close(master)


def is_running(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
