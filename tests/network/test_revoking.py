"""A name that is revoked while kernels run is cut off within seconds, by kernels and by routers."""

from __future__ import annotations

import asyncio
import logging
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from aiorts import Component, InPort, Kernel, exits
from aiorts.links import Links
from aiorts.types import TimedLong

pytest.importorskip("zenoh")
pytest.importorskip("cryptography")

from aiorts_zenoh.neighbours import Neighbours
from aiorts_zenoh.security.access import KERNELS, Access
from aiorts_zenoh.security.revoking import Revoking
from aiorts_zenoh.security.tls import secured_by
from network.certificate_parts import folder
from network.network_parts import free_port
from network.test_router import start
from network.test_security import SecuredFar

WAIT = 20.0
CUT = 5.0
"""Seconds within which what is revoked is cut off; the list is looked at every second."""


class Sink(Component):
    inp = InPort(TimedLong, length=10_000)


@contextmanager
def writer(address: str, certificates: Path, log: Path, name: str = "writer") -> Iterator[None]:
    program = Path(__file__).with_name("writing_program.py")
    with log.open("w") as output:
        process = subprocess.Popen(
            [sys.executable, str(program), address, str(certificates), name], stdout=output, stderr=output
        )
    try:
        yield
    finally:
        process.kill()
        process.wait(WAIT)


def revoke(certificates: Path, name: str) -> None:
    command = [sys.executable, "-m", "aiorts", "certs", "revoke", name, "--folder", str(certificates)]
    subprocess.run(command, check=True, timeout=WAIT, stdout=subprocess.DEVNULL)


async def comes(sink: Sink, count: int = 100) -> None:
    """Wait until so many samples have come from now on."""
    sink.inp.drain()
    async with asyncio.timeout(WAIT):
        for _ in range(count):
            await sink.inp.read(timeout=WAIT)


@pytest.mark.slow(kept_by="test_a_list_that_cannot_be_read_changes_nothing_and_is_said")
@pytest.mark.fault("E18")
def test_a_kernel_that_is_revoked_is_cut_off_while_both_run(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    ours = folder(tmp_path / "ours", reader="component", writer="component", other="component").path
    theirs = shutil.copytree(ours, tmp_path / "theirs")
    address = f"127.0.0.1:{free_port()}"

    async def main() -> None:
        far = {"zenoh": {"listen": address, "host": "far", "certificates": ours}}
        async with Kernel("reader", services=far) as reader:
            sink, links = await reader.add(Sink("sink")), reader.service(Links)
            with (
                writer(address, theirs, tmp_path / "log.txt"),
                writer(address, theirs, tmp_path / "other.txt", "other"),
            ):
                async with asyncio.timeout(WAIT):
                    while len(links.peers) < 2:
                        await asyncio.sleep(0.01)
                await comes(sink)
                await asyncio.to_thread(revoke, ours, "writer")
                revoked = time.monotonic()
                while len(links.peers) == 2:
                    assert time.monotonic() - revoked < CUT
                    await asyncio.sleep(0.01)
                assert [peer.kernel for peer in links.peers] == ["other"]
                await comes(sink)  # of the other one
                await asyncio.to_thread(revoke, ours, "other")
                async with asyncio.timeout(CUT):
                    while links.peers:
                        await asyncio.sleep(0.01)
                sink.inp.drain()
                await asyncio.sleep(1.0)
                assert sink.inp.drain() == []
                async with asyncio.timeout(WAIT):
                    while "the name 'writer' was revoked" not in (tmp_path / "log.txt").read_text():
                        await asyncio.sleep(0.05)

    with caplog.at_level(logging.WARNING):
        asyncio.run(main())
    said = [one.getMessage() for one in caplog.records if "'writer' was revoked: its links are cut" in one.getMessage()]
    assert len(said) == 1


@pytest.mark.slow(kept_by="test_a_list_that_cannot_be_read_changes_nothing_and_is_said")
@pytest.mark.fault("E18")
def test_an_operator_who_is_revoked_is_refused_and_what_runs_is_ended(tmp_path: Path) -> None:
    ours = folder(tmp_path / "ours", robot="component", otto="operator", anna="operator").path
    theirs = shutil.copytree(ours, tmp_path / "theirs")
    far = SecuredFar(tmp_path, ours, "--allow-control", "-v")
    try:
        far.certificates = theirs
        until = time.monotonic() + WAIT
        while far.do_as("otto", "conf", "counter", "step=5")[0] != exits.DONE:
            assert time.monotonic() < until, far.log.read_text()
        with far.start("print", "counter.out") as printing:
            assert printing.stdout is not None
            assert printing.stdout.readline()
            revoke(ours, "otto")
            revoked = time.monotonic()
            printing.stdout.read()
            assert time.monotonic() - revoked < CUT + 2.0
        assert far.do_as("otto", "conf", "counter", "step=7")[0] != exits.DONE
        assert "'otto' was revoked, or has no role in this kernel" in far.do_as("otto", "ls")[1]
        assert far.do_as("anna", "ls")[0] == exits.DONE
        assert far.step() == 5
        assert far.log.read_text().count("'otto' was revoked: its links are cut") == 1
    finally:
        far.close()


@pytest.mark.slow(kept_by="test_a_list_that_cannot_be_read_changes_nothing_and_is_said")
@pytest.mark.fault("E18")
def test_a_router_lets_through_nothing_of_a_name_that_is_revoked_and_all_of_others(tmp_path: Path) -> None:
    roles = {"hub": "router", "reader": "component", "writer": "component", "other": "component"}
    ours = folder(tmp_path / "ours", **roles).path
    theirs = shutil.copytree(ours, tmp_path / "theirs")
    address = f"127.0.0.1:{free_port()}"
    router = start(address, "--certs", str(ours), "--name", "hub")

    async def main() -> None:
        far = {"zenoh": {"connect": address, "host": "far", "certificates": theirs}}
        async with Kernel("reader", services=far) as reader:
            sink, links = await reader.add(Sink("sink")), reader.service(Links)
            with (
                writer(address, theirs, tmp_path / "log.txt"),
                writer(address, theirs, tmp_path / "other.txt", "other"),
            ):
                async with asyncio.timeout(WAIT):
                    while len(links.peers) < 2:
                        await asyncio.sleep(0.01)
                await comes(sink)
                await asyncio.to_thread(revoke, ours, "writer")
                async with asyncio.timeout(CUT):
                    while "writer" in [peer.kernel for peer in links.peers]:
                        await asyncio.sleep(0.01)
                async with asyncio.timeout(WAIT):
                    while [peer.kernel for peer in links.peers] != ["other"]:
                        await asyncio.sleep(0.01)
                await comes(sink)
                await asyncio.sleep(1.0)
                assert [peer.kernel for peer in links.peers] == ["other"]

    try:
        asyncio.run(main())
        router.terminate()
        _, said = router.communicate(timeout=WAIT)
        assert router.returncode == 0, said
    finally:
        router.kill()
        router.communicate(timeout=WAIT)


@pytest.mark.slow(kept_by="test_a_list_that_cannot_be_read_changes_nothing_and_is_said")
def test_a_router_that_is_revoked_itself_ends_and_says_so(tmp_path: Path) -> None:
    ours = folder(tmp_path, hub="router").path
    router = start(f"127.0.0.1:{free_port()}", "--certs", str(ours), "--name", "hub")
    try:
        revoke(ours, "hub")
        _, said = router.communicate(timeout=WAIT)
        assert (router.returncode, "'hub' was revoked" in said) == (exits.REFUSED, True), said
    finally:
        router.kill()
        router.communicate(timeout=WAIT)


def test_a_list_that_cannot_be_read_changes_nothing_and_is_said(tmp_path: Path) -> None:
    made = folder(tmp_path, arm="component", base="component")
    said: list[str] = []
    made.revoke("arm")
    looks = Revoking(made, Access.of_names({}, ["arm"]).denied, said.append)
    assert looks.look() == frozenset()
    good = made.index.read_bytes()
    made.index.write_text("{")
    assert looks.look() == frozenset()
    made.index.unlink()
    assert looks.look() == frozenset()
    assert ["is no index" in said[0], "No such file" in said[1]] == [True, True]
    made.index.write_bytes(good)
    made.revoke("base")
    assert (looks.look(), looks.look()) == ({"base"}, frozenset())
    assert looks.denied == {"arm", "base"}


@pytest.mark.slow
@pytest.mark.fault("E18")
def test_a_name_that_cannot_be_cut_off_somewhere_keeps_none_from_being_cut_off(tmp_path: Path) -> None:
    made, said, denied = (
        folder(tmp_path, robot="component", arm="component", base="component"),
        list[str](),
        list[str](),
    )

    def fails(name: str) -> None:
        raise OSError(f"no way to {name}")

    async def main() -> None:
        neighbours = Neighbours((), secured_by(tmp_path, "robot", KERNELS), said.append)
        neighbours.denies += [fails, denied.append]
        neighbours.start()
        try:
            for names in (["arm"], ["arm", "base"]):
                made.revoke(names[-1])
                async with asyncio.timeout(WAIT):
                    while denied != names:
                        await asyncio.sleep(0.01)
                assert not any(neighbours.admits(name) for name in names)
        finally:
            neighbours.close()

    asyncio.run(main())
    assert [name for name in ("arm", "base") if any(f"no way to {name}" in one for one in said)] == ["arm", "base"]
