"""Whoever is killed at whatever moment: no process, socket, shared memory or temporary file is left."""

from __future__ import annotations

import asyncio
import contextlib
import os
import random
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from aiorts.processes import Launcher
from campaign import cases, time_limit
from process_parts import DAEMON, GONE, WAIT, all_gone, marked, program, started, there

PARENT = """
import asyncio, os, socket, sys
from aiorts.processes import Launcher

async def main():
    launcher = Launcher()
    ours, its = socket.socketpair()
    def on_line(stream, line):
        print(line, flush=True)
    for code in sys.argv[1:]:
        child = await launcher.start(["-c", code], descriptor=its.fileno(), name="child", on_line=on_line)
    print(launcher._helper.pid, child.pid, flush=True)
    await asyncio.sleep(100)

asyncio.run(main())
"""
IDLE = "print('idle', flush=True)\nimport time; time.sleep(100)"
STOPPED = "print('stopped', flush=True)\nimport os, signal\nos.kill(os.getpid(), signal.SIGSTOP)"
LOCKED = "print('locked', flush=True)\nimport ctypes\nctypes.PyDLL(None).sleep(100)"  # holds the interpreter's lock
DAEMONS = DAEMON + "print('daemons', flush=True)\nimport time; time.sleep(100)"


class Parent:
    """A process with a launcher and children, which has said that they run."""

    def __init__(self, *bodies: str, before: str = "") -> None:
        codes = [program(body)[1] for body in bodies]
        self.process = subprocess.Popen([sys.executable, "-c", before + PARENT, *codes], stdout=subprocess.PIPE)
        self.expected = len(bodies) + 1

    def ready(self) -> tuple[int, int]:
        """The helper and the last child; each child has written its line."""
        assert self.process.stdout is not None
        lines = [self.process.stdout.readline() for _ in range(self.expected)]
        found = next(line for line in lines if line[:1].isdigit())
        helper, child = map(int, found.split())
        return helper, child

    def kill(self) -> None:
        self.process.kill()
        self.process.wait(WAIT)
        assert self.process.stdout is not None
        self.process.stdout.close()


def wait_until_stopped(pid: int) -> None:
    """It has written its line just before: killed in between, its thread may not have its turn before the stop."""
    until = time.monotonic() + WAIT
    while Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "T":
        assert time.monotonic() < until
        time.sleep(0.001)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where the processes of a test put temporary files and sockets."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return tmp_path


def names(folder: Path) -> list[str]:
    """What is left there, and the shared memory of ours."""
    return [path.name for path in folder.iterdir()] + [name for name in os.listdir("/dev/shm") if "aiorts" in name]


@pytest.mark.slow(kept_by="first")
@pytest.mark.parametrize("body", [IDLE, STOPPED, LOCKED, DAEMONS], ids=["idle", "stopped", "locked", "daemons"])
def test_nothing_is_left_of_a_parent_that_is_killed(body: str, folder: Path) -> None:
    with marked() as mark:
        parent = Parent(IDLE, body)
        parent.ready()
        assert len(there(mark)) == 4 + (body is DAEMONS)
        parent.kill()
        assert all_gone(mark) == {}
    assert names(folder) == []


@pytest.mark.slow(kept_by="test_nothing_is_left_of_a_parent_that_is_killed")
@pytest.mark.timeout(time_limit(600))
def test_nothing_is_left_of_a_parent_that_is_killed_at_any_moment(folder: Path) -> None:
    chosen, longest = random.Random(19), 0.0
    for _ in range(cases(100)):
        with marked() as mark:
            parent = Parent(IDLE, DAEMONS)
            time.sleep(chosen.random() * 0.4)
            parent.kill()
            began = time.monotonic()
            assert all_gone(mark) == {}
            longest = max(longest, time.monotonic() - began)
    print(f"longest: {longest:.3f} s")
    assert names(folder) == []


@pytest.mark.slow(kept_by="test_nothing_is_left_of_a_parent_that_is_killed")
def test_a_parent_that_has_forked_is_noticed_though_its_sockets_are_still_held() -> None:
    """multiprocessing forks, too: the copies of the socket stay open in processes that live on."""
    body = PARENT.replace("await asyncio.sleep(100)", "os.fork()\n    __import__('time').sleep(100)")
    with marked() as mark:
        process = subprocess.Popen([sys.executable, "-c", body, program(IDLE)[1]], stdout=subprocess.PIPE)
        assert process.stdout is not None
        helper = next(int(line.split()[0]) for line in process.stdout if line[:1].isdigit())
        until = time.monotonic() + WAIT
        while len(there(mark)) < 4 and time.monotonic() < until:
            time.sleep(0.01)
        process.kill()
        process.wait(WAIT)
        process.stdout.close()
        copies = set()
        until = time.monotonic() + GONE
        while len(copies := set(there(mark))) > 1 and time.monotonic() < until:
            time.sleep(0.01)
        assert len(copies) == 1
        assert helper not in copies
        os.kill(copies.pop(), signal.SIGKILL)
        assert all_gone(mark) == {}


@pytest.mark.slow(kept_by="first")
@pytest.mark.parametrize("body", [IDLE, STOPPED, DAEMONS], ids=["idle", "stopped", "daemons"])
def test_nothing_is_left_when_parent_and_helper_are_killed_together(body: str) -> None:
    with marked() as mark:
        parent = Parent(IDLE, body)
        helper, child = parent.ready()
        if body is STOPPED:
            wait_until_stopped(child)
        os.kill(helper, signal.SIGKILL)
        parent.kill()
        assert all_gone(mark) == {}


@pytest.mark.slow(kept_by="first")
@pytest.mark.anyio
@pytest.mark.parametrize("body", [IDLE, STOPPED, LOCKED, DAEMONS], ids=["idle", "stopped", "locked", "daemons"])
async def test_a_helper_that_is_killed_takes_its_children_along_and_the_next_start_has_another(body: str) -> None:
    async with started() as its, asyncio.timeout(WAIT):
        child = await its.start(body)
        await its.line(body.partition("'")[2].partition("'")[0] if body is not DAEMONS else "daemons")
        if body is STOPPED:
            wait_until_stopped(child.pid)
        helper = its.helper
        os.kill(helper, signal.SIGKILL)
        ending = await child.ended
        assert ending.text == "end not seen: the helper process was killed"
        again = await its.start("raise SystemExit(4)")
        assert (await again.ended).status == 4
        until = time.monotonic() + GONE
        while (left := set(there(its.mark))) != {its.helper} and time.monotonic() < until:
            await asyncio.sleep(0.01)
        assert left == {its.helper} != {helper}


def kill_marked(mark: str) -> None:
    """The net below a test: whatever of its processes is there, for some seconds."""
    until = time.monotonic() + WAIT
    while (left := there(mark)) and time.monotonic() < until:
        for pid in left:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)


BOMB = Path(__file__).with_name("bomb.py")


@pytest.mark.slow
@pytest.mark.anyio
@pytest.mark.parametrize("ends", ["closed", "killed"])
async def test_nothing_is_left_of_processes_that_start_one_another_anew(ends: str, tmp_path: Path) -> None:
    with marked() as mark:
        try:
            launcher, (ours, its) = Launcher(), socket.socketpair()
            said: list[str] = []
            child = await launcher.start(
                program(
                    "import subprocess, sys, time\n"
                    f"command = [sys.executable, '-S', {str(BOMB)!r}, {str(tmp_path / 'seen')!r}]\n"
                    "subprocess.Popen([*command, str(time.monotonic() + 6)], start_new_session=True)\n"
                    "import os; os.read(3, 1)"
                ),
                descriptor=its.fileno(),
                name="bomber",
                on_line=lambda _stream, line: said.append(line),
            )
            async with asyncio.timeout(WAIT):
                while len(there(mark)) < 30:
                    await asyncio.sleep(0.05)
            if ends == "killed":
                child.kill()
                async with asyncio.timeout(WAIT):
                    await child.ended
                assert set(all_gone(mark)) == {launcher._helper.pid if launcher._helper else 0}
            await launcher.close(WAIT)
            assert (all_gone(mark), said) == ({}, [])
            for end in (ours, its):
                end.close()
        finally:
            kill_marked(mark)


@pytest.mark.slow
@pytest.mark.anyio
async def test_a_helper_that_is_stopped_while_it_is_closed_goes_on_and_kills_what_is_left() -> None:
    """Killed in the place of it, it left what it had adopted of children that have ended."""
    with marked() as mark:
        try:
            launcher, (ours, its) = Launcher(), socket.socketpair()
            lines: list[str] = []
            child = await launcher.start(
                program(DAEMON + "print('daemons', flush=True)\nimport os; os.read(3, 1)"),
                descriptor=its.fileno(),
                name="child",
                on_line=lambda _stream, line: lines.append(line),
            )
            async with asyncio.timeout(WAIT):
                while "daemons" not in lines:
                    await asyncio.sleep(0.01)
            assert launcher._helper is not None
            os.kill(launcher._helper.pid, signal.SIGSTOP)
            ours.send(b"x")
            async with asyncio.timeout(WAIT):
                while Path(f"/proc/{child.pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z":
                    await asyncio.sleep(0.01)
            await launcher.close(0.2)
            assert all_gone(mark, WAIT) == {}
            for thread in threading.enumerate():
                if thread.name == "aiorts-helper":
                    thread.join(WAIT)
            for end in (ours, its):
                end.close()
        finally:
            kill_marked(mark)


@pytest.mark.slow
@pytest.mark.anyio
async def test_a_group_of_the_terminal_that_is_interrupted_leaves_helper_and_children_alone() -> None:
    async with started() as its, asyncio.timeout(WAIT):
        child = await its.start("import os; os.read(3, 1)")
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            os.kill(its.helper, number)
        assert os.getsid(its.helper) == its.helper
        its.ours.send(b"x")
        assert (await child.ended).text == "exit status 0"
