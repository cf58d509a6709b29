"""Two kernels, one link: what is written in one is read in the other."""

from __future__ import annotations

import pytest
from anyio import sleep
from links.wires import Net

from aiorts import Component, InPort, Kernel, OutPort
from aiorts.links.connecting import Links
from aiorts.types import TimedLong


class Source(Component):
    out = OutPort(TimedLong)


class Sink(Component):
    inp = InPort(TimedLong)


def long(value: int) -> TimedLong:
    return TimedLong(tm=0, data=value)


@pytest.mark.anyio
async def test_first() -> None:
    net = Net()
    async with Kernel("one") as one, Kernel("two") as two:
        one.service(Links).use(net.wire())
        two.service(Links).use(net.wire())
        await two.service(Links).opened()
        source, sink = (
            await one.add(
                Source(),
            ),
            await two.add(Sink()),
        )
        connector = await one.connect(source.out, "two/sink0.inp", length=100)
        print(connector)
        for number in range(50):
            source.out.write_nowait(long(number))
        await sleep(0.05)
        print(connector.statistics, two.connectors)
        assert [sample.data for sample in sink.inp.drain()] == list(range(50))
        flush = await one.connect(source.out, "two/sink0.inp", subscription="flush", allow_duplicate=True, name="f")
        print(flush.profile, two.connectors)
        assert await source.out.write(long(7))
        print(flush.statistics)
        assert flush.statistics.acknowledged == 1
