"""Beyond the host there is nothing without certificates, and a name does what its role may alone."""

from __future__ import annotations

import asyncio
import re
import signal
import time
from pathlib import Path
from typing import Any

import pytest

from aiorts import Component, InPort, Kernel, OutPort
from aiorts.links import Links
from aiorts.types import TimedOctetSeq

pytest.importorskip("zenoh")
pytest.importorskip("cryptography")

from aiorts import exits
from aiorts_zenoh import Network
from network.certificate_parts import folder
from network.network_parts import free_port
from network.test_other_hosts import WAIT, Far


class Source(Component):
    out = OutPort(TimedOctetSeq)


class Sink(Component):
    inp = InPort(TimedOctetSeq, length=10)


def _services(address: str, certificates: Path, *, listens: bool) -> dict[str, Any]:
    host = "far" if listens else "near"
    return {"zenoh": {"listen" if listens else "connect": address, "host": host, "certificates": certificates}}


@pytest.mark.slow(kept_by="first")
def test_two_kernels_with_certificates_lose_nothing(tmp_path: Path) -> None:
    folder(tmp_path, reader="component", writer="component")

    async def main() -> None:
        address = f"127.0.0.1:{free_port()}"
        far, near = _services(address, tmp_path, listens=True), _services(address, tmp_path, listens=False)
        async with Kernel("reader", services=far) as reader, Kernel("writer", services=near) as writer:
            await asyncio.gather(reader.service(Network).opened(), writer.service(Network).opened())
            sink, source = await reader.add(Sink("sink")), await writer.add(Source("source"))
            connector = await writer.connect(source.out, "far/reader/sink.inp", full="block", timeout=None)
            for number in range(50):
                await source.out.write(TimedOctetSeq(number, bytes(300_000 if number % 25 == 0 else 10)))
                assert (await sink.inp.read(timeout=20.0)).tm == number
            ledger = await writer.service(Links).ledger(connector)
            assert (ledger.written, ledger.delivered, ledger.unexplained) == (50, 50, 0)
            assert reader.service(Network).report()["security"] == "certificates"

    asyncio.run(main())


def test_a_name_that_the_table_of_links_gives_picks_the_certificate(tmp_path: Path) -> None:
    folder(tmp_path, robot="component")

    async def main() -> None:
        services = _services(f"127.0.0.1:{free_port()}", tmp_path, listens=True) | {"links": {"name": "robot"}}
        async with Kernel("reader", services=services) as kernel:
            await kernel.service(Network).opened()
            assert kernel.service(Network).report()["security"] == "certificates"

    asyncio.run(main())


@pytest.mark.slow
def test_a_kernel_of_another_authority_sees_nobody(tmp_path: Path) -> None:
    folder(tmp_path / "ours", reader="component", writer="component")
    folder(tmp_path / "theirs", reader="component", writer="component")

    async def main() -> None:
        address = f"127.0.0.1:{free_port()}"
        far = _services(address, tmp_path / "ours", listens=True)
        near = _services(address, tmp_path / "theirs", listens=False)
        async with Kernel("reader", services=far) as reader, Kernel("writer", services=near) as writer:
            await reader.service(Network).opened()
            await asyncio.sleep(2.0)
            assert (reader.service(Links).peers, writer.service(Links).peers) == ((), ())

    asyncio.run(main())


class SecuredFar(Far):
    """A run on another host with certificates."""

    def __init__(self, folder: Path, certificates: Path, *options: str) -> None:
        self.certificates = certificates
        self.security = ("--certs", str(certificates))
        super().__init__(folder, *options)

    def do_as(self, name: str, *words: str) -> tuple[int, str, str]:
        """Status, output and errors of a command of this name."""
        self.client = ("--as", name, "--certs", str(self.certificates))
        return self.do(*words)


@pytest.mark.slow(kept_by="network/test_access.py::test_what_a_name_may_send_is_its_own_and_forged_names_are_not")
@pytest.mark.row(97)
def test_a_viewer_looks_and_an_operator_controls(tmp_path: Path) -> None:
    roles = {"robot": "component", "arm": "component", "anna": "viewer", "otto": "operator", "lead": "coordinator"}
    folder(tmp_path / "certs", **roles)
    far = SecuredFar(tmp_path, tmp_path / "certs", "--allow-control", "-v")
    try:
        until = time.monotonic() + WAIT
        while far.do_as("anna", "ls")[1].split() != ["robot/", "counter"]:
            assert time.monotonic() < until, far.log.read_text()
        status, _, errors = far.do_as("anna", "conf", "counter", "step=5")
        assert (status, "E-DENIED" in errors) == (exits.DENIED, True), (status, errors)
        assert far.step() == 1
        assert far.do_as("otto", "conf", "counter", "step=5")[0] == exits.DONE
        assert far.step() == 5
        assert far.do_as("lead", "conf", "counter", "step=7")[0] == exits.DONE
        status, _, errors = far.do_as("arm", "ls")
        assert (status, "'arm' has the role 'component'" in errors) == (exits.REFUSED, True)
        assert re.search(r"\[otto, another host\]\" kernel=\"[^\"]+/robot\" what=\"configure\(", far.log.read_text())
    finally:
        far.close()


@pytest.mark.slow(kept_by="network/test_certs_command.py::test_what_is_wrong_with_each_is_said_and_no_key_shown")
def test_no_key_is_in_what_a_kernel_says_of_itself(tmp_path: Path) -> None:
    certs = folder(tmp_path / "certs", robot="component", otto="operator").path
    secrets = [line for file in certs.glob("*.key") for line in file.read_text().splitlines() if "-----" not in line]
    assert len(secrets) >= 6
    far = SecuredFar(tmp_path, certs, "--allow-control", "-v")
    try:
        until = time.monotonic() + WAIT
        while far.do_as("otto", "ls")[1].split() != ["robot/", "counter"]:
            assert time.monotonic() < until, far.log.read_text()
        said = [*far.do_as("otto", "cat", "robot", "--json"), *far.do_as("otto", "save", "robot")]
        assert "certificates" in said[1], "it is the profile"
        far.process.send_signal(signal.SIGUSR1)
        while "security" not in far.log.read_text():  # of the report of the service
            assert time.monotonic() < until, far.log.read_text()
            time.sleep(0.05)
        said += [far.log.read_text(), Path(f"/proc/{far.process.pid}/cmdline").read_text()]
        assert [line for line in secrets if any(line in str(text) for text in said)] == []
    finally:
        far.close()
