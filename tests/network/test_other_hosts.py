"""`aiorts at`: commands look into, and operate, what runs on another host. Each host has a folder of sockets here."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from aiorts import exits

pytest.importorskip("zenoh")

import msgpack
import zenoh

from network.network_parts import free_port

WAIT = 20.0
SYSTEM = """
schema = 1
[components.counter]
type = "parts.py:Counter"
[contexts.fast]
members = ["counter"]
kind = "periodic"
rate = 50.0
"""
PARTS = '''
import time
from aiorts import Component, OutPort, Param
from aiorts.types import TimedLong

class Counter(Component):
    """Counts."""
    out = OutPort(TimedLong)
    step = Param(1)
    hold = Param(0.0)
    n = 0
    def on_execute(self):
        self.n += self.step
        self.out.write_nowait(TimedLong(self.n, self.n))
        if self.hold:
            time.sleep(self.hold)
'''


class Far:
    """A run on another host, and what commands of this one do with it."""

    security: tuple[str, ...] = ("--insecure-network",)
    system = SYSTEM
    parts = PARTS
    client: tuple[str, ...] = ("--as", "tester", "--insecure-network")

    def __init__(self, folder: Path, *options: str) -> None:
        self.address = f"127.0.0.1:{free_port()}"
        (folder / "system.toml").write_text(self.system)
        (folder / "parts.py").write_text(self.parts)
        self.log = folder / "log.txt"
        self.folders = [tempfile.mkdtemp(prefix="ai") for _ in range(2)]
        run = [sys.executable, "-m", "aiorts", "run", str(folder / "system.toml"), "--name", "robot", *options]
        self._run = [*run, "--host", "far", "--listen", self.address, *self.security]
        self.begin()

    def begin(self) -> None:
        """Run it, anew where it runs."""
        with self.log.open("a") as output:
            self.process = subprocess.Popen(self._run, env=self._on(1), stdout=output, stderr=output)

    def _on(self, host: int) -> dict[str, str]:
        return os.environ | dict.fromkeys(("XDG_RUNTIME_DIR", "TMPDIR"), self.folders[host])

    def start(self, *words: str, **options: Any) -> subprocess.Popen[str]:
        at = [sys.executable, "-m", "aiorts", "at", *self.client, self.address]
        return subprocess.Popen(
            [*at, *words],
            env=self._on(0) | {"SHELL": "/bin/sh"},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            **options,
        )

    def do(self, *words: str) -> tuple[int, str, str]:
        """Status, output and errors of a command of this host."""
        with self.start(*words) as process:
            try:
                output, errors = process.communicate(timeout=WAIT)
            except BaseException:
                process.kill()
                raise
        return process.returncode, output, errors

    def step(self, name: str = "counter") -> int:
        """The value of that parameter."""
        words = self.do("conf", name)[1].split()
        return int(words[words.index("step") + 1])

    def descriptors(self) -> int:
        """That are open in the run."""
        return len(os.listdir(f"/proc/{self.process.pid}/fd"))

    def close(self) -> None:
        self.process.kill()
        self.process.wait(WAIT)
        for folder in self.folders:
            subprocess.run(["rm", "-r", folder], check=False, timeout=WAIT)


@pytest.fixture
def far(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Far]:
    run = Far(tmp_path, *getattr(request, "param", ("--allow-control", "-v")))
    until = time.monotonic() + WAIT
    try:
        while run.do("ls")[1].split() != ["robot/", "insecure:", "plain", "TCP", "counter"]:
            assert time.monotonic() < until, run.log.read_text()
        yield run
    finally:
        run.close()


@pytest.mark.slow(kept_by="test_a_program_without_aiorts_calls_by_one_question")
@pytest.mark.row(91)
def test_all_is_seen_and_operated_as_on_this_host(far: Far) -> None:
    status, said, _ = far.do("ls", "--json")
    (kernel,) = json.loads(said)["kernels"]
    assert (status, kernel["name"], kernel["pid"]) == (exits.DONE, "robot", far.process.pid)
    assert far.step() == 1
    assert far.do("conf", "counter", "step=5")[0] == exits.DONE
    assert far.step("far/robot/counter") == 5
    status, said, errors = far.do("print", "counter.out", "--count", "3", "--json")
    values = [json.loads(line)["data"] for line in said.splitlines()]
    assert (status, [late - early for early, late in pairwise(values)]) == (0, [5, 5]), errors
    assert far.do("deactivate", "counter")[0] == exits.DONE
    assert "inactive" in far.do("ls", "-l")[1]
    assert far.do("stop", "robot")[0] == exits.DONE
    assert far.process.wait(WAIT) == 0
    assert re.search(r'\[tester, another host\]" kernel="\S+/robot" what="configure\(', far.log.read_text())


PROGRAM = """
import asyncio
from aiorts.errors import DeniedError
from aiorts.sessions import AsyncClient

async def main():
    for right in ("view", "operate", "code"):
        async with AsyncClient.connect("far/robot", right=right) as client:
            try:
                await client.call("configure", component="counter", values={"": {"step": 5}})
            except DeniedError as error:
                print(error)
            async with client.stream("tap", port="counter.out") as samples:
                print(client.right, (await samples.next())["data"] > 0)

asyncio.run(main())
"""


@pytest.mark.slow(kept_by="test_a_program_without_aiorts_calls_by_one_question")
def test_a_program_asks_kernels_of_other_hosts_for_what_it_needs(far: Far, tmp_path: Path) -> None:
    (tmp_path / "program.py").write_text(PROGRAM)
    with far.start(stdin=subprocess.PIPE) as shell:
        said, errors = shell.communicate(f"{sys.executable} {tmp_path}/program.py\n", timeout=WAIT)
    refused = (
        "configure: needs the right 'operate', and this client asked for 'view'; begin the session with right='operate'"
    )
    assert said.splitlines() == [refused, "view True", "operate True", "operate True"], errors


@pytest.mark.slow(kept_by="test_a_program_without_aiorts_calls_by_one_question")
def test_who_may_operate_creates_what_is_offered_there_and_brings_no_code(far: Far, tmp_path: Path) -> None:
    (tmp_path / "brought.py").write_text(f"{PARTS}\nopen({str(tmp_path / 'ran')!r}, 'w').close()\n")
    for words in (["comp", "create", f"{tmp_path}/brought.py:Counter", "robot/x"], ["reload", "robot/counter"]):
        status, _, errors = far.do(*words)
        assert (status, "code is never taken over a network" in errors) == (exits.DENIED, True), (words, errors)
    assert not (tmp_path / "ran").exists()
    assert far.do("comp", "create", "FlexiDump", "robot/dump", "inputs=TimedLong")[0] == exits.DONE
    assert far.do("ls")[1].split()[-2:] == ["counter", "dump"]


@pytest.mark.slow(kept_by="test_a_program_without_aiorts_calls_by_one_question")
@pytest.mark.parametrize("far", [("-v",)], indirect=True)
def test_who_may_only_look_changes_nothing(far: Far) -> None:
    assert far.step() == 1
    status, _, errors = far.do("conf", "counter", "step=5")
    assert (status, "E-DENIED" in errors) == (exits.DENIED, True), (status, errors)
    assert far.step() == 1
    refused = r'\[tester, another host\]" kernel="\S+/robot" what="configure" outcome="refused E-DENIED: '
    assert re.search(refused, far.log.read_text())


@pytest.mark.slow(kept_by="test_a_program_without_aiorts_calls_by_one_question")
def test_a_kernel_that_is_killed_ends_the_command(far: Far) -> None:
    with far.start("print", "counter.out") as printing:
        assert printing.stdout is not None
        assert printing.stdout.readline()
        far.process.kill()
        killed = time.monotonic()
        _, errors = printing.communicate(timeout=WAIT)
        assert time.monotonic() - killed < 5.0
        assert "robot: has ended" in errors


@pytest.mark.slow(kept_by="test_a_program_without_aiorts_calls_by_one_question")
def test_what_a_command_began_ends_with_it_also_where_it_is_killed(far: Far) -> None:
    before = far.descriptors()
    with far.start("print", "counter.out", start_new_session=True) as printing:
        assert printing.stdout is not None
        assert printing.stdout.readline()
        assert far.descriptors() > before
        os.killpg(printing.pid, signal.SIGKILL)
    until = time.monotonic() + WAIT
    while far.descriptors() > before:
        assert time.monotonic() < until
        time.sleep(0.05)
    place = Path(far.folders[0])
    assert len(list(place.glob("aiorts-at-*"))) == 1
    (place / "aiorts-at-another").mkdir(mode=0o700)  # of one that begins
    assert far.step() == 1
    assert [left.name for left in place.glob("aiorts-at-*")] == ["aiorts-at-another"]


@pytest.mark.slow(kept_by="test_a_program_without_aiorts_calls_by_one_question")
def test_in_a_shell_a_kernel_that_is_started_anew_is_operated(far: Far) -> None:
    with far.start(stdin=subprocess.PIPE) as shell:
        assert shell.stdin is not None
        assert shell.stdout is not None
        aiorts = f"{sys.executable} -m aiorts"
        try:
            shell.stdin.write(f"{aiorts} conf counter step=2; echo first $?\n")
            shell.stdin.flush()
            assert "first 0" in _until(shell, "first")
            far.process.kill()
            far.process.wait(WAIT)
            far.begin()
            again = f"until {aiorts} conf counter step=5 2>&1; do sleep 0.2; done; echo second $?"
            shell.stdin.write(f"{again}\n{aiorts} conf counter; exit\n")
            shell.stdin.flush()
            assert "second 0" in _until(shell, "second")
            words = shell.communicate(timeout=WAIT)[0].split()
            assert words[words.index("step") + 1] == "5"
        finally:
            shell.kill()


def _until(shell: subprocess.Popen[str], word: str) -> str:
    """The line of a shell's output that begins with a word; of one that never writes it the shell is ended."""
    assert shell.stdout is not None
    ending = threading.Timer(WAIT, shell.kill)
    ending.start()
    try:
        return next((line for line in shell.stdout if line.startswith(word)), "")
    finally:
        ending.cancel()


@pytest.mark.slow(kept_by="test_a_program_without_aiorts_calls_by_one_question")
def test_a_loop_that_is_held_up_says_so(far: Far) -> None:
    far.do("conf", "counter", "hold=60.0")  # its answer may be held up already
    assert "no answer: its event loop has been busy" in far.do("ls")[1]


@pytest.mark.slow(kept_by="first")
def test_a_program_without_aiorts_calls_by_one_question(far: Far) -> None:
    config = zenoh.Config()
    config.insert_json5("connect/endpoints", json.dumps([f"tcp/{far.address}"]))
    config.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(config) as session:

        def call(branch: str, operation: str, **arguments: object) -> Any:
            key = f"aiorts/1/default/{branch}/far/robot/*/stranger/{operation}"
            replies = session.get(key, payload=msgpack.packb(arguments), timeout=WAIT)
            (answer,) = [msgpack.unpackb(one.ok.payload.to_bytes()) for one in replies]
            return answer

        assert call("info", "hello")["ok"]["address"].endswith("/robot")
        assert list(call("info", "names")["ok"]["components"]) == ["counter"]
        assert call("info", "deactivate", component="counter")["error"]["code"] == "E-DENIED"
        assert "ok" in call("ctl", "deactivate", component="counter")
        assert call("info", "names")["ok"]["components"]["counter"] == {"fast": "inactive"}
        assert call("info", "nothing")["error"]["code"] == "E-CONTROL"


@pytest.mark.slow(kept_by="test_a_program_without_aiorts_calls_by_one_question")
@pytest.mark.parametrize("far", [("-v",)], indirect=True)
def test_without_allow_control_there_is_nothing_below_ctl(far: Far) -> None:
    config = zenoh.Config()
    config.insert_json5("connect/endpoints", json.dumps([f"tcp/{far.address}"]))
    config.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(config) as session:
        key = "aiorts/1/default/{}/far/robot/*/stranger/hello"
        assert len([one for one in session.get(key.format("info"), timeout=WAIT) if one.ok]) == 1
        assert list(session.get(key.format("ctl"), timeout=WAIT)) == []


@pytest.mark.slow(kept_by="test_a_program_without_aiorts_calls_by_one_question")
def test_a_place_where_nothing_listens_is_said() -> None:
    at = [sys.executable, "-m", "aiorts", "at", "--insecure-network", f"127.0.0.1:{(port := free_port())}", "ls"]
    done = subprocess.run(at, capture_output=True, text=True, check=False, timeout=WAIT)
    assert (done.returncode, done.stdout) == (exits.FAILED, "")
    assert f"E-LINK: 127.0.0.1:{port} is not reached: Connection refused" in done.stderr
