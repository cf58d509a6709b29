"""An in-port that wants every sample says how many a connector to it holds, unless its connection does."""

from __future__ import annotations

from typing import Any

import pytest

from aiorts import Component, InPort, Kernel, OutPort
from aiorts.testing import simulated
from aiorts.types import TimedLong


class Ends(Component):
    """Ports of each kind."""

    out = OutPort(TimedLong)
    plain = InPort(TimedLong)
    deep = InPort(TimedLong, length=500)


@pytest.mark.parametrize(
    ("options", "length"),
    [
        ({}, 500),
        ({"subscription": "new", "push": "all"}, 500),
        ({"full": "block"}, 500),
        ({"subscription": "new"}, 1),
        ({"length": 3}, 3),
        ({"buffer.length": "4"}, 4),
        ({"dataport.inport.buffer.length": "5"}, 5),
    ],
)
@simulated
async def test_a_port_says_how_deep_its_connectors_are_unless_they_do(options: dict[str, Any], length: int) -> None:
    async with Kernel() as kernel:
        ends = await kernel.create(Ends)
        connector: Any = await kernel.connect(ends.out, ends.deep, **options)
        assert connector.profile.length == length


@simulated
async def test_of_several_ports_each_has_its_own() -> None:
    async with Kernel() as kernel:
        ends = await kernel.create(Ends)
        connectors: Any = await kernel.connect(ends.out, ends.plain, ends.deep)
        assert [one.profile.length for one in connectors] == [8, 500]
