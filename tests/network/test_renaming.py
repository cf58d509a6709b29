"""A kernel whose name is taken in the network runs on under another one, where it may: real processes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from aiorts.errors import ConfigurationError

pytest.importorskip("zenoh")

import zenoh

from aiorts_zenoh import NetworkSettings
from aiorts_zenoh.keys import HELLO, INFO, ClientKeys
from aiorts_zenoh.names import free_name
from network.network_parts import free_port

WAIT = 30.0
PARTS = """
from aiorts import Component, InPort, OutPort
from aiorts.types import TimedLong

class Source(Component):
    out = OutPort(TimedLong)
    n = 0
    def on_execute(self):
        self.n += 1
        self.out.write_nowait(TimedLong(self.n, self.n))

class Sink(Component):
    inp = InPort(TimedLong)
    told = False
    def on_execute(self):
        if self.inp.drain() and not self.told:
            self.told = True
            print(f"{self.name} reads", flush=True)
"""
PLAIN = """
schema = 1
[components.src]
type = "parts.py:Source"
[components.sink]
type = "parts.py:Sink"
[components.sink2]
type = "parts.py:Sink"
[contexts.loop]
members = ["src", "sink", "sink2"]
kind = "periodic"
rate = 50.0
"""


def _link(writer: str, reader: str) -> str:
    return f'\n[[connections]]\nfrom = "{writer}"\nto = "{reader}"\n'


@contextmanager
def run(folder: Path, log: Path, links: str, *options: str) -> Iterator[str]:
    """A run with a folder of sockets of its own, as another user or container of this machine has: that folder."""
    system = log.with_suffix(".toml")
    system.write_text(PLAIN + links)
    (folder / "parts.py").write_text(PARTS)
    command = [sys.executable, "-u", "-m", "aiorts", "run", str(system), "--insecure-network", *options]
    with tempfile.TemporaryDirectory(prefix="ai") as own, log.open("wb") as output:
        environment = os.environ | {"XDG_RUNTIME_DIR": own}
        with subprocess.Popen(command, stdout=output, stderr=output, env=environment) as process:
            try:
                yield own
            finally:
                process.kill()


def _wait(met: Callable[[], bool], *logs: Path) -> None:
    until = time.monotonic() + WAIT
    while not met():
        assert time.monotonic() < until, [log.read_text()[-2000:] for log in logs]
        time.sleep(0.05)


@pytest.mark.slow(kept_by="test_the_next_that_is_free_is_taken")
def test_it_is_another_kernel_for_all_others_and_links_to_it_and_from_it_work(tmp_path: Path) -> None:
    address = f"127.0.0.1:{free_port()}"
    first, second, other = (tmp_path / name for name in ("first.log", "second.log", "other.log"))
    of_other = _link("robot-2/src.out", "sink.inp") + _link("src.out", "robot-2/sink.inp")
    of_second = _link("src.out", "watch/sink2.inp") + _link("watch/src.out", "sink2.inp")
    same = ("--name", "robot", "--host", "same")
    with ExitStack() as stack:
        stack.enter_context(run(tmp_path, first, "", *same, "--listen", address))
        _wait(lambda: "robot/" in _ls(address), first)
        own = stack.enter_context(run(tmp_path, second, of_second, *same, "--connect", address, "--rename"))
        watch = ("--name", "watch", "--host", "other", "--connect", address)
        stack.enter_context(run(tmp_path, other, of_other, *watch))
        _wait(lambda: "this one is 'robot-2' for other hosts" in second.read_text(), second)
        _wait(lambda: "another kernel named 'robot' was started on same" in first.read_text(), first)
        for log in (second, other):
            _wait(lambda log=log: all(f"{one} reads" in log.read_text() for one in ("sink", "sink2")), second, other)  # type: ignore[misc]
        _wait(lambda: _ls(address).count("/") == 3, first, second, other)  # who has a name is shown a second later
        shown = _ls(address).split()
        assert [word for word in shown if word.endswith("/")] == ["watch/", "robot/", "robot-2/"]
        assert "links:" not in shown
        near = _aiorts(own, "ls")
        assert ("robot/" in near.split(), "links:" in near) == (True, False), near  # nor where it has its own name
        assert "reads" not in first.read_text()
        # Once each: nothing is asked there under the name that is another's.
        assert sorted(_asked(address)) == ["robot", "robot-2", "watch"]


def _asked(address: str) -> list[str]:
    """Which kernels answer a question to all, each as often as it does."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([f"tcp/{address}"]))
    key = ClientKeys("default", "tester").every(INFO, HELLO)
    with zenoh.open(config) as session:
        time.sleep(1.0)  # it hears who is asked by this
        how = {"target": zenoh.QueryTarget.ALL, "consolidation": zenoh.ConsolidationMode.NONE, "timeout": 5.0}
        return [str(one.ok.key_expr).split("/")[5] for one in session.get(key, **how)]


def _ls(address: str) -> str:
    with tempfile.TemporaryDirectory(prefix="ai") as own:
        return _aiorts(own, "at", "--insecure-network", address, "ls")


def _aiorts(own: str, *words: str) -> str:
    command, environment = [sys.executable, "-m", "aiorts", *words], os.environ | {"XDG_RUNTIME_DIR": own}
    done = subprocess.run(command, capture_output=True, text=True, timeout=WAIT, env=environment, check=False)
    return done.stdout


def test_the_next_that_is_free_is_taken() -> None:
    assert free_name("robot", ["robot", "arm-2"]) == "robot-2"
    assert free_name("robot", ["robot", "robot-2", "robot-4"]) == "robot-3"


def test_with_certificates_a_name_is_that_of_the_certificate() -> None:
    with pytest.raises(ConfigurationError, match="rename: with certificates a kernel has the name in its certificate"):
        NetworkSettings(connect="127.0.0.1:1", certificates=Path("certs"), rename=True)
