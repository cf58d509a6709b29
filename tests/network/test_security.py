"""Beyond the host there is nothing without certificates, and a name does what its role may alone."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest

from aiorts import Component, InPort, Kernel, OutPort
from aiorts.links import Links
from aiorts.types import TimedOctetSeq

pytest.importorskip("zenoh")
pytest.importorskip("cryptography")

from aiorts_zenoh import Network
from network.certificate_parts import folder
from network.network_parts import free_port


class Source(Component):
    out = OutPort(TimedOctetSeq)


class Sink(Component):
    inp = InPort(TimedOctetSeq, length=10)


def _services(address: str, certificates: Path, *, listens: bool) -> dict[str, Any]:
    host = "far" if listens else "near"
    return {"zenoh": {"listen" if listens else "connect": address, "host": host, "certificates": certificates}}


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


def test_a_kernel_of_another_authority_sees_nobody(tmp_path: Path) -> None:
    folder(tmp_path / "ours", reader="component", writer="component")
    folder(tmp_path / "theirs", reader="component", writer="component")

    async def main() -> None:
        address = f"127.0.0.1:{free_port()}"
        far = _services(address, tmp_path / "ours", listens=True)
        near = _services(address, tmp_path / "theirs", listens=False)
        async with Kernel("reader", services=far) as reader, Kernel("writer", services=near) as writer:
            await asyncio.gather(reader.service(Network).opened(), writer.service(Network).opened())
            await asyncio.sleep(1.0)
            assert (reader.service(Links).peers, writer.service(Links).peers) == ((), ())

    asyncio.run(main())
