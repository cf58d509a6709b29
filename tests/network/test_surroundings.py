"""The network is not as it should be: what runs on this host goes on, and what is wrong is said."""

from __future__ import annotations

import os
import resource
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

pytest.importorskip("zenoh")

from network.network_parts import free_port

pytestmark = pytest.mark.slow(
    kept_by="network/test_network.py::test_an_address_that_is_not_of_this_machine_is_said_before_anything_runs"
)

WAIT = 30.0
SYSTEM = """
schema = 1
[components.counter]
type = "parts.py:Counter"
[contexts.fast]
members = ["counter"]
kind = "periodic"
rate = 20.0
"""
PARTS = """
from aiorts import Component

class Counter(Component):
    def on_execute(self):
        print("sample", flush=True)
"""


class Run:
    """A system that runs on this host, whatever the network is like."""

    def __init__(self, folder: Path, *options: str, inside: list[str] | None = None, descriptors: int = 0) -> None:
        (folder / "system.toml").write_text(SYSTEM)
        (folder / "parts.py").write_text(PARTS)
        self.said, self._sockets = folder / "said.txt", tempfile.mkdtemp(prefix="ai")
        command = [*(inside or ()), sys.executable, "-m", "aiorts", "run", str(folder / "system.toml"), *options]
        with self.said.open("w") as output:
            self.process = subprocess.Popen(
                [*command, "--insecure-network", "--name", "robot"],
                env=os.environ | {"XDG_RUNTIME_DIR": self._sockets},
                stdout=output,
                stderr=output,
                preexec_fn=(lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (descriptors,) * 2))
                if descriptors
                else None,
            )

    @property
    def text(self) -> str:
        return self.said.read_text()

    @property
    def samples(self) -> int:
        return self.text.count("sample")

    def until(self, good: Callable[[], bool]) -> None:
        limit = time.monotonic() + WAIT
        while not good():
            assert self.process.poll() is None, self.text[-3000:]
            assert time.monotonic() < limit, self.text[-3000:]
            time.sleep(0.05)

    def goes_on(self) -> None:
        before = self.samples
        self.until(lambda: self.samples > before + 10)
        assert self.process.poll() is None

    def close(self) -> None:
        self.process.terminate()
        try:
            self.process.wait(WAIT)
        finally:
            self.process.kill()
            self.process.wait(WAIT)
            shutil.rmtree(self._sockets)
        assert "Traceback" not in self.text, self.text[-3000:]
        assert self.process.returncode in (0, 143, -15), self.text[-3000:]


@contextmanager
def running(folder: Path, *options: str, inside: list[str] | None = None, descriptors: int = 0) -> Iterator[Run]:
    run = Run(folder, *options, inside=inside, descriptors=descriptors)
    try:
        run.goes_on()
        yield run
    finally:
        run.close()


@contextmanager
def namespace() -> Iterator[list[str]]:
    """What runs a command on a host without any network."""
    if shutil.which("ip") is None or os.geteuid() != 0:
        pytest.skip("not run: network namespaces need `ip` and root")
    name = f"aiorts-{os.getpid()}-n"
    made = subprocess.run(["ip", "netns", "add", name], capture_output=True, text=True, check=False, timeout=10)
    if made.returncode:
        pytest.skip(f"not run: no network namespaces here: {made.stderr.strip()[:200]}")
    try:
        yield ["ip", "netns", "exec", name]
    finally:
        subprocess.run(["ip", "netns", "del", name], check=False, timeout=10)


@pytest.mark.fault("E26")
def test_a_host_name_that_nobody_knows_is_said_and_all_here_runs(tmp_path: Path) -> None:
    with running(tmp_path, "--connect", "nobody.invalid:7447") as run:
        run.until(lambda: "nobody.invalid:7447 is not reached: " in run.text)
        run.goes_on()


@pytest.mark.fault("E26")
def test_without_any_network_all_here_runs_and_it_is_said(tmp_path: Path) -> None:
    with namespace() as inside, running(tmp_path, "--connect", "10.77.0.2:7447", inside=inside) as run:
        run.until(lambda: "10.77.0.2:7447 is not reached: Network is unreachable" in run.text)
        run.goes_on()


@pytest.mark.fault("E26")
def test_over_ipv6_alone_two_kernels_meet(tmp_path: Path) -> None:
    if not socket.has_ipv6:
        pytest.skip("not run: no IPv6 here")
    with namespace() as inside:
        name = inside[-1]
        for words in ("link set lo up", "addr del 127.0.0.1/8 dev lo", "addr add fd77::1/64 dev lo nodad"):
            done = subprocess.run(["ip", "-n", name, *words.split()], capture_output=True, check=False, timeout=10)
            if done.returncode and "fd77" in words:
                pytest.skip("not run: no IPv6 here")
        other = tmp_path / "other"
        other.mkdir()
        with (
            running(tmp_path, "--listen", "[fd77::1]:7447", "--host", "one", inside=inside),
            running(other, "--connect", "[fd77::1]:7447", "--host", "two", inside=inside) as run,
        ):
            at = [*inside, sys.executable, "-m", "aiorts", "at", "--insecure-network", "[fd77::1]:7447", "ls"]
            seen = subprocess.run(at, capture_output=True, text=True, check=False, timeout=WAIT)
            assert "counter" in seen.stdout, seen
            assert "is not reached" not in run.text


@pytest.mark.fault("E26")
def test_an_interface_that_comes_later_is_used_then(hosts: tuple[list[str], list[str]], tmp_path: Path) -> None:
    here, there = hosts
    name = here[3]
    (wire,) = [
        line.split(":")[1].strip().partition("@")[0]
        for line in subprocess.check_output(["ip", "-n", name, "-o", "link"], text=True, timeout=10).splitlines()
        if "ai" in line.split(":")[1]
    ]
    subprocess.run(["ip", "-n", name, "link", "set", wire, "down"], check=True, timeout=10)
    other = tmp_path / "other"
    other.mkdir()
    with (
        running(tmp_path, "--listen", "10.77.0.2:7447", "--host", "two", inside=there),
        running(other, "--connect", "10.77.0.2:7447", "--host", "one", inside=here) as run,
    ):
        run.until(lambda: "10.77.0.2:7447 is not reached: Network is unreachable" in run.text)
        subprocess.run(["ip", "-n", name, "link", "set", wire, "up"], check=True, timeout=10)
        at_port = f":{7447:04X} 01"  # established
        table = [*here, "cat", "/proc/net/tcp"]
        run.until(lambda: at_port in subprocess.check_output(table, text=True, timeout=10))
        run.goes_on()


@pytest.mark.fault("G01")
@pytest.mark.parametrize("end", ["listen", "connect"])
def test_with_64_descriptors_it_works_or_says_what_is_missing(tmp_path: Path, end: str) -> None:
    address = f"127.0.0.1:{free_port()}"
    with running(tmp_path, f"--{end}", address, descriptors=64) as run:
        run.goes_on()


@pytest.mark.fault("G01")
def test_connections_that_take_all_descriptors_end_nothing_that_runs(tmp_path: Path) -> None:
    port = free_port()
    with running(tmp_path, "--listen", f"127.0.0.1:{port}", descriptors=64) as run:
        taken: list[socket.socket] = []
        try:
            taken += [socket.create_connection(("127.0.0.1", port), 5.0) for _ in range(100)]
            run.goes_on()
        finally:
            for one in taken:
                one.close()
        run.goes_on()
