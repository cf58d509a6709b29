"""Samples that are too large, types that differ, and messages that nobody knows: what is beside them goes on."""

from __future__ import annotations

import asyncio
import json

import numpy as np
import pytest

from aiorts import Component, InPort, Kernel, OutPort
from aiorts.errors import WiringError
from aiorts.links import Links
from aiorts.types import TimedDouble, TimedLong, TimedOctetSeq

pytest.importorskip("zenoh")

import zenoh

from aiorts_zenoh import Network
from network.network_parts import free_port

LARGEST = 64 << 20


class Source(Component):
    large = OutPort(TimedOctetSeq)
    other = OutPort(TimedDouble)


class Sink(Component):
    large = InPort(TimedOctetSeq, length=1_000)
    number = InPort(TimedLong)


def session(address: str) -> zenoh.Session:
    config = zenoh.Config()
    config.insert_json5("connect/endpoints", json.dumps([f"tcp/{address}"]))
    config.insert_json5("scouting/multicast/enabled", "false")
    return zenoh.open(config)


@pytest.mark.slow(kept_by="first")
@pytest.mark.fault("E10", "E15")
def test_what_is_too_large_or_of_another_kind_harms_nothing_beside_it() -> None:
    async def main() -> None:
        address = f"127.0.0.1:{free_port()}"
        far = {"zenoh": {"listen": address, "host": "far", "insecure": True}}
        near = {"zenoh": {"connect": address, "host": "near", "insecure": True}}
        async with Kernel("reader", services=far) as reader, Kernel("writer", services=near) as writer:
            await asyncio.gather(reader.service(Network).opened(), writer.service(Network).opened())
            sink, source = await reader.add(Sink("sink")), await writer.add(Source("source"))
            connector = await writer.connect(source.large, "far/reader/sink.large")
            async with asyncio.timeout(20.0):
                while writer.service(Links).report()[connector.name] != "up":
                    await asyncio.sleep(0.01)
            with pytest.raises(WiringError, match="types differ"):
                await writer.connect(source.other, "far/reader/sink.number")
            source.large.write_nowait(TimedOctetSeq(0, np.zeros(LARGEST + 1, "u1")))
            with await asyncio.to_thread(session, address) as strange:
                seen: list[str] = []
                watching = strange.declare_subscriber("aiorts/1/*/link/**", lambda one: seen.append(str(one.key_expr)))
                until = asyncio.get_running_loop().time() + 20.0
                written = 0
                while not any(key.endswith("/w") for key in seen):  # the key of a message that is under way
                    assert asyncio.get_running_loop().time() < until
                    source.large.write_nowait(TimedOctetSeq(written := written + 1, b"x"))
                    await asyncio.sleep(0.01)
                watching.undeclare()
                key = next(key for key in seen if key.endswith("/w"))
                for kind in (0, 7, 200):
                    for version in (1, 9):
                        strange.put(key, bytes((version, kind)) + bytes(22))
                strange.put(key, b"")
                strange.put(key, b"\x01\x00\xff\xff" + bytes(20))
                for _ in range(100):
                    source.large.write_nowait(TimedOctetSeq(written := written + 1, b"x"))
                came = []
                while len(came) < written:
                    came.append((await sink.large.read(timeout=20.0)).tm)
            assert came == list(range(1, written + 1))
            ledger = await writer.service(Links).ledger(connector)
            assert (connector.statistics.dropped["unsendable"], ledger.unexplained) == (1, 0)
            assert len(writer.connectors) == 1

    asyncio.run(main())
