"""Flexi components change while they run: map, inputs, constants; what stays loses no sample, what does not fit is
refused and everything goes on as before.

The paper's own components take their interface from the command line and keep it as long as they live (section III).
"""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from aiorts import Component, EventContext, ExternalContext, InPort, Kernel, OutPort, PeriodicContext
from aiorts.errors import ConfigurationError
from aiorts.events import PortAdded
from aiorts.testing import simulated
from aiorts.types import TimedDouble, TimedLong, TimedShort
from aiorts_flexi.add import FlexiAdd
from aiorts_flexi.const import FlexiConst
from aiorts_flexi.dump import FlexiDump
from aiorts_flexi.dupe import FlexiDupe
from aiorts_flexi.mapping.filter import FlexiFilter
from aiorts_flexi.select import FlexiSelect


async def ends(kernel: Kernel, component: Component) -> tuple[dict[str, OutPort[Any]], dict[str, InPort[Any]]]:
    """A port of our own on every port that has none yet: what feeds its in-ports, what takes from its out-ports."""
    user = kernel.components.get("user") or await kernel.create(Component, "user")
    for name, port in component.ports.items():
        if port.connectors:
            continue
        mine = f"of_{name}"
        if mine in user.ports:
            user.remove_port(mine)
        if isinstance(port, InPort):
            await kernel.connect(user.add_port(mine, OutPort(port.type)), port, length=1000)
        elif isinstance(port, OutPort):
            await kernel.connect(port, user.add_port(mine, InPort(port.type)), length=10_000)
    ports = {name.removeprefix("of_"): port for name, port in user.ports.items()}
    return (
        {name: port for name, port in ports.items() if isinstance(port, OutPort)},
        {name: port for name, port in ports.items() if isinstance(port, InPort)},
    )


def data(port: InPort[Any]) -> list[Any]:
    return [sample.data for sample in port.drain()]


@pytest.mark.row(124)
@simulated
async def test_a_filter_gets_another_map_and_other_ports_while_samples_stream() -> None:
    async with Kernel() as kernel:
        made = await kernel.create(FlexiFilter, "filter", inputs=["TimedLong"], outputs=["TimedLong"], map="0>0")
        await kernel.start(EventContext(), made, activate=True)
        feed, take = await ends(kernel, made)
        for number in range(10):
            await feed["input0"].write(TimedLong(0, number))
        await made.configure(map="0>10>0")
        for number in range(10):
            await feed["input0"].write(TimedLong(0, number))
        await asyncio.sleep(0.01)
        got = data(take["output0"])
        # Every sample came out, each by the map that was in force when it was processed.
        assert len(got) == 20
        assert all(value in (number % 10, number % 10 * 10) for number, value in enumerate(got))
        assert got[10:] == [number * 10 for number in range(10)]
        kept = take["output0"].connectors[0]
        await made.configure(inputs=["TimedLong", "TimedDouble"], outputs=["TimedLong", "TimedLong"], map="0>0,1>2>1")
        feed, take = await ends(kernel, made)
        assert take["output0"].connectors == (kept,)
        await feed["input0"].write(TimedLong(0, 7))
        await feed["input1"].write(TimedDouble(0, 4.0))
        await asyncio.sleep(0.01)
        assert (data(take["output0"]), data(take["output1"])) == ([7], [8])
        with pytest.raises(ConfigurationError, match="there is no in-port 2"):
            await made.configure(map="2>0")
        with pytest.raises(ConfigurationError):
            await made.configure(inputs=["TimedLong"])  # the map needs the second
        assert list(made.ports) == ["input0", "input1", "output0", "output1"]
        await feed["input1"].write(TimedDouble(0, 5.0))
        await asyncio.sleep(0.01)
        assert (data(take["output1"]), made.last_error) == ([10], None)


@simulated
async def test_what_is_no_matter_of_the_map_leaves_the_pins_their_last_values() -> None:
    async with Kernel() as kernel:
        made = await kernel.create(
            FlexiFilter, "filter", inputs=["TimedLong"] * 2, outputs=["TimedLongSeq:2"], map="0>0:0,1>0:1"
        )
        await kernel.start(EventContext(), made, activate=True)
        feed, take = await ends(kernel, made)
        await feed["input0"].write(TimedLong(0, 3))
        await asyncio.sleep(0.01)
        await made.configure(verbosity=1)
        await feed["input1"].write(TimedLong(0, 4))
        await asyncio.sleep(0.01)
        assert [list(value) for value in data(take["output0"])] == [[3, 0], [3, 4]]


@pytest.mark.row(124)
@simulated
async def test_a_selector_gets_more_inputs_and_keeps_its_selection() -> None:
    async with Kernel() as kernel:
        made = await kernel.create(FlexiSelect, "select", port="TimedLong:2")
        context = await kernel.start(ExternalContext(), made, activate=True)
        feed, take = await ends(kernel, made)
        await feed["selection"].write(TimedShort(0, 1))
        await feed["input1"].write(TimedLong(0, 10))
        await made.configure(port="TimedLong:4")
        await context.tick()
        assert data(take["output"]) == [10]
        feed, take = await ends(kernel, made)
        await feed["selection"].write(TimedShort(0, 3))
        await feed["input3"].write(TimedLong(0, 30))
        await context.tick()
        assert data(take["output"]) == [30]
        with pytest.raises(ConfigurationError, match=r"expected 0..1; there are 2 inputs"):
            await made.configure(port="TimedLong:2", initial=2)
        await made.configure(port="TimedLong:2", initial=1, feedback=True)  # the selected one goes
        feed, take = await ends(kernel, made)
        await feed["input1"].write(TimedLong(0, 11))
        await context.tick()
        assert (data(take["output"]), made.last_error) == ([11], None)
        await made.configure(initial=0)  # a selection that is in force stays
        await feed["input1"].write(TimedLong(0, 12))
        await context.tick()
        assert data(take["output"]) == [12]


@pytest.mark.row(124)
@simulated
async def test_a_constant_changes_its_value_its_rate_and_its_ports() -> None:
    async with Kernel() as kernel:
        made = await kernel.create(FlexiConst, "const", outputs=["TimedLong"], constants=["1"], rate=10.0)
        await kernel.start(PeriodicContext(1.0), made, activate=True)
        _, take = await ends(kernel, made)
        await asyncio.sleep(0.45)
        await made.configure(constants=["2"])
        await asyncio.sleep(1.0)
        got = data(take["output"])
        assert sorted(got) == got
        assert (got.count(1), got.count(2)) in ((4, 10), (4, 11), (5, 9), (5, 10), (5, 11))
        await made.configure(outputs=["TimedLong", "TimedDouble"], constants=["3", "0.5"], names=["output", "more"])
        _, take = await ends(kernel, made)
        await asyncio.sleep(1.0)
        assert set(data(take["output"])) <= {2, 3}
        assert set(data(take["more"])) == {0.5}
        with pytest.raises(ConfigurationError, match="2 constants for 3"):
            await made.configure(outputs=["TimedLong"] * 3, names=[])
        await made.configure(outputs=["TimedLong"], constants=["4"], names=["output"])
        await asyncio.sleep(1.0)
        assert data(take["output"])[-1] == 4
        assert (list(made.ports), made.last_error, made.state) == (["output"], None, "active")


@simulated
async def test_a_dupe_and_a_sum_get_other_ports_and_a_dump_shows_them(capsys: pytest.CaptureFixture[str]) -> None:
    async with Kernel() as kernel:
        dupe = await kernel.create(FlexiDupe, "dupe", inputs=["TimedLong:1"])
        total = await kernel.create(FlexiAdd, "add", port="TimedLong:2")
        await kernel.start(EventContext(), dupe, total, activate=True)
        await kernel.connect(dupe.ports["output0_0"], total.ports["input0"])
        user = await kernel.create(Component, "user")
        feed = user.add_port("feed", OutPort(TimedLong))
        taken = user.add_port("taken", InPort(TimedLong))
        await kernel.connect(feed, dupe.ports["input0"])
        await kernel.connect(total.ports["output"], taken, length=100)
        await feed.write(TimedLong(0, 1))
        heard: list[str] = []
        kernel.bus.subscribe(PortAdded, lambda event: heard.append(f"{event.component}.{event.port.name}"))
        await dupe.configure(inputs=["TimedLong:3"])
        await total.configure(port="TimedLong:3")
        assert heard == ["dupe.output0_1", "dupe.output0_2", "add.input2"]
        await kernel.connect(dupe.ports["output0_2"], total.ports["input2"])
        await feed.write(TimedLong(0, 5))
        await asyncio.sleep(0.01)
        assert data(taken)[-1] == 10
        await total.configure(port="TimedLong:1")
        await feed.write(TimedLong(0, 6))
        await asyncio.sleep(0.01)
        assert data(taken) == [6]
        with pytest.raises(ConfigurationError, match="did you mean TimedLong"):
            await total.configure(port="TimedLongg:1")
        dump = FlexiDump("dump")
        await dump.configure(inputs=["TimedLong"])
        dump.make_ports()
        assert list(dump.ports) == ["input0"]
        assert (dupe.last_error, total.last_error) == (None, None)
