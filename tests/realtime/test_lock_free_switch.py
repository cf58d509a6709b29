"""A port that no real-time thread is at any more is an ordinary one again, with its short way."""

from __future__ import annotations

import asyncio

import pytest

from aiorts import Component, InPort, Kernel, OutPort, RealtimeContext
from aiorts.kernel.ports.in_port import receiver_of
from aiorts.kernel.ports.receiver import Receiver
from aiorts.realtime.lock_free import LockFreeReceiver
from aiorts.types import TimedLong


class Writer(Component):
    out = OutPort(TimedLong)


class Reader(Component):
    inp = InPort(TimedLong)


@pytest.mark.slow(
    kept_by="realtime/test_lock_free_connector.py::test_a_sample_that_comes_in_while_its_connector_ends_is_dropped_as_disconnected"
)
def test_a_port_is_ordinary_again_when_its_real_time_connector_has_ended() -> None:
    async def main() -> tuple[type, int]:
        async with Kernel() as kernel:
            there, here, reader = await kernel.create(Writer), await kernel.create(Writer), await kernel.create(Reader)
            await kernel.connect(here.out, reader.inp)
            context = RealtimeContext(rate=100.0, priority=None, lock_memory=False)
            await kernel.start(context, there, activate=True)
            crossing = await kernel.connect(there.out, reader.inp)
            assert type(receiver_of(reader.inp)) is LockFreeReceiver
            await kernel.disconnect(crossing)
            here.out.write_nowait(TimedLong(0, 5))
            return type(receiver_of(reader.inp)), reader.inp.read_nowait().data

    assert asyncio.run(main()) == (Receiver, 5)
