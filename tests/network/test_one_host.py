"""Two runs of one host that find each other by its sockets and by the network, under names of their own machines."""

from __future__ import annotations

import asyncio
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

pytest.importorskip("zenoh")

from aiorts import Component, InPort, Kernel, OutPort
from aiorts.links import Links
from aiorts.types import TimedLong
from network.network_parts import free_port

pytestmark = pytest.mark.slow(kept_by="links/test_reaching.py::test_a_kernel_that_two_transports_find_is_one")

WAIT = 30.0
PARTS = """
from aiorts import Component, InPort, OutPort
from aiorts.types import TimedLong

class Source(Component):
    out = OutPort(TimedLong)
    n = 0
    def on_execute(self):
        self.n += 1
        self.out.write_nowait(TimedLong(0, self.n))

class Sink(Component):
    inp = InPort(TimedLong)
    def on_execute(self):
        self.inp.drain()
"""
SYSTEM = """
schema = 1
[links]
[components.part]
type = "parts.py:{kind}"
[contexts.fast]
members = ["part"]
kind = "periodic"
rate = 50.0
"""
CONNECTION = """
[[connections]]
from = "part.out"
to = "rd/part.inp"
"""


@contextmanager
def run_of(folder: Path, name: str, *options: str) -> Iterator[None]:
    """`aiorts run` of the file of that name."""
    command = [sys.executable, "-m", "aiorts", "run", f"{name}.toml", "--name", name, "--insecure-network", *options]
    with (folder / f"{name}.log").open("w") as log, subprocess.Popen(command, cwd=folder, stderr=log) as process:
        try:
            yield
        finally:
            process.terminate()


def both_ends(folder: Path, component: str) -> str:
    """What `aiorts con --both-ends` says at an end, as soon as it counts samples."""
    command = [sys.executable, "-m", "aiorts", "con", component, "--both-ends"]
    until, said = time.monotonic() + WAIT, ""
    while time.monotonic() < until:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=WAIT, check=False)
        said = done.stdout + done.stderr
        line = next((line for line in said.splitlines() if "both ends: " in line), "")
        if "not known" in line or (" = " in line and " 0 delivered" not in line):
            return line.partition("both ends: ")[2]
        time.sleep(0.2)
    return said


@pytest.mark.parametrize("first", ["rd", "wr"])
def test_both_ends_are_known_at_either_end_whatever_the_machine_is_called(
    first: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A kernel that two transports had found was two: at the reader's end a link was not known to the other kernel."""
    (tmp_path / "parts.py").write_text(PARTS)
    (tmp_path / "rd.toml").write_text(SYSTEM.format(kind="Sink"))
    (tmp_path / "wr.toml").write_text(SYSTEM.format(kind="Source") + CONNECTION)
    address, second = f"127.0.0.1:{free_port()}", "wr" if first == "rd" else "rd"
    with tempfile.TemporaryDirectory(prefix="al") as folder:
        monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
        with run_of(tmp_path, first, "--host", f"h{first}", "--listen", address):
            time.sleep(1.0)  # the one is known by the sockets before the other is by the network, or later
            with run_of(tmp_path, second, "--host", f"h{second}", "--connect", address):
                time.sleep(3.0)
                for name in ("rd", "wr"):
                    said = both_ends(tmp_path, f"{name}/part")
                    logs = [(tmp_path / f"{one}.log").read_text() for one in ("rd", "wr")]
                    assert "written = " in said, (name, said, logs)


class _Source(Component):
    out = OutPort(TimedLong)


class _Sink(Component):
    inp = InPort(TimedLong)


@pytest.mark.anyio
async def test_a_kernel_that_sockets_and_the_network_find_is_one_peer() -> None:
    address = f"127.0.0.1:{free_port()}"
    with tempfile.TemporaryDirectory(prefix="al") as folder, pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", folder)
        listens = {"host": "ha", "insecure": True, "listen": address}
        connects = {"host": "hb", "insecure": True, "connect": address}
        async with (
            Kernel("rd", services={"links": {}, "zenoh": listens}) as reader,
            Kernel("wr", services={"links": {}, "zenoh": connects}) as writer,
        ):
            ends = [kernel.service(Links) for kernel in (reader, writer)]
            async with asyncio.timeout(WAIT):
                while not all(len(ways) == 2 for links in ends for ways in links.reach._ways.values() or [[]]):
                    await asyncio.sleep(0.02)
            assert [[(peer.host, peer.kernel) for peer in links.peers] for links in ends] == [
                [("hb", "wr")],
                [("ha", "rd")],
            ]
            sink, source = await reader.add(_Sink("sink")), await writer.add(_Source("source"))
            connector = await writer.connect(source.out, "rd/sink.inp")
            source.out.write_nowait(TimedLong(0, 7))
            assert (await sink.inp.read(timeout=WAIT)).data == 7
            (back,) = reader.connectors.values()
            for links, one in zip(ends, (back, connector), strict=True):
                ledger = await links.ledger(one)
                assert (ledger.written, ledger.delivered, ledger.unexplained) == (1, 1, 0)
