"""A connection of three ports or more is one handle: a tuple of its connectors that ends whole."""

from __future__ import annotations

import threading
from typing import Protocol

import pytest

from aiorts import Component, Connection, Kernel, Provided, Required, SimulatedClock
from aiorts.errors import ThreadError, WiringError
from aiorts.events import Disconnected
from aiorts.kernel.ports.connector import Connector
from aiorts.testing import simulated
from ports.parts import Sink, Source, data, long


async def connected(kernel: Kernel, sinks: int = 3) -> tuple[Source, list[Sink], Connection[Connector]]:
    source = await kernel.add(Source("source"))
    made = [await kernel.add(Sink(f"sink{number}")) for number in range(sinks)]
    first, second, *more = (sink.inp for sink in made)
    return source, made, await kernel.connect(source.out, first, second, *more)


@simulated
async def test_it_is_the_tuple_of_its_connectors() -> None:
    async with Kernel() as kernel:
        _, sinks, connection = await connected(kernel)
        one, two, three = connection
        assert (one, two, three) == connection == connection.connectors == tuple(kernel.connectors.values())
        assert isinstance(connection, tuple)
        assert len(connection) == 3
        assert connection[0].in_ is sinks[0].inp
        assert repr(connection) == "<Connection source.out-sink0.inp, source.out-sink1.inp, source.out-sink2.inp>"
        assert not connection.closed


@pytest.mark.parametrize("how", ["close", "disconnect"])
@simulated
async def test_it_ends_whole(simulated_clock: SimulatedClock, how: str) -> None:
    async with Kernel() as kernel:
        source, sinks, connection = await connected(kernel)
        ended: list[str] = []
        kernel.bus.subscribe(Disconnected, lambda event: ended.append(event.connector.name))
        source.out.write_nowait(long(1))
        for _ in range(2):  # idempotent
            if how == "close":
                connection.close()
            else:
                await kernel.disconnect(connection)
            assert connection.closed
            assert not kernel.connectors
            assert ended == [f"source.out-sink{number}.inp" for number in (2, 1, 0)]
        assert [dict(one.statistics.dropped) for one in connection] == [{"disconnected": 1}] * 3
        assert source.out.connectors == sinks[0].inp.connectors == ()
        assert repr(connection).endswith(" closed>")
    connection.close()


@simulated
async def test_one_that_ends_alone_leaves_the_others_in_force() -> None:
    async with Kernel() as kernel:
        source, sinks, connection = await connected(kernel)
        await kernel.remove(sinks[1])
        await kernel.disconnect(connection[2])
        assert [one.closed for one in connection] == [False, True, True]
        assert not connection.closed
        assert "2 closed" in repr(connection)
        source.out.write_nowait(long(1))
        assert data(sinks[0].inp.drain()) == [1]
        connection.close()
        assert connection.closed


@simulated
async def test_a_removed_writer_ends_all_of_it() -> None:
    async with Kernel() as kernel:
        source, _, connection = await connected(kernel)
        await kernel.remove(source)
        assert connection.closed


@simulated
async def test_another_kernel_ends_none_of_it() -> None:
    async with Kernel() as kernel, Kernel("other") as other:
        _, _, connection = await connected(kernel)
        connection[0].close()
        with pytest.raises(WiringError, match=r"source\.out-sink1\.inp: is not a connector of other"):
            await other.disconnect(connection)
        assert [one.closed for one in connection] == [True, False, False]


@simulated
async def test_another_thread_ends_none_of_it() -> None:
    async with Kernel() as kernel:
        _, _, connection = await connected(kernel)
        caught: list[ThreadError] = []

        def close() -> None:
            try:
                connection.close()
            except ThreadError as error:
                caught.append(error)

        thread = threading.Thread(target=close)
        thread.start()
        thread.join(10)
        assert caught
        assert not any(one.closed for one in connection)


class Brake(Protocol):
    async def stop(self) -> str: ...


class Arm(Component):
    left = Required[Brake]()
    right = Required[Brake]()


class BrakeRtc(Component):
    service = Provided[Brake](concurrent=True)

    def stop(self) -> str:
        return "stopped"


@simulated
async def test_of_service_ports_it_is_the_same() -> None:
    async with Kernel() as kernel:
        arm, brake = await kernel.create(Arm), await kernel.create(BrakeRtc)
        connection = await kernel.connect(arm.left, arm.right, brake.service)
        assert await arm.right.proxy.stop() == "stopped"
        assert len(connection) == len(kernel.service_connectors) == 2
        connection.close()
        assert connection.closed
        assert not kernel.service_connectors


@simulated
async def test_what_two_ports_make_is_a_connector() -> None:
    async with Kernel() as kernel:
        source, sink = await kernel.create(Source), await kernel.create(Sink)
        assert isinstance(await kernel.connect(source.out, sink.inp), Connector)
