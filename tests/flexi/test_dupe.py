"""FlexiDupe: every sample to every copy, unchanged, and a reader that is slow holds up no other."""

from __future__ import annotations

import re
from typing import Any

import pytest

from aiorts import Component, EventContext, InPort, Kernel, LifecycleState, OutPort, Param, PeriodicContext
from aiorts.errors import WriteTimeout
from aiorts.testing import Rig, check_component, simulated
from aiorts.types import TimedDoubleSeq, TimedLong, TimedString
from aiorts_flexi.dupe import FlexiDupe


class Two(FlexiDupe):
    """Two inputs, of two and three copies."""

    inputs = Param(("TimedLong:2", "TimedDoubleSeq:3"), type=tuple[str, ...])


@pytest.mark.row(123)
@simulated
async def test_each_input_is_copied_to_its_own_outputs_unchanged() -> None:
    async with Rig(Two("dupe"), debug=False) as rig:
        numbers = [TimedLong(n, -n) for n in range(5)]
        lists = [TimedDoubleSeq(7, [1.0]), TimedDoubleSeq(8, [])]
        rig.feed("input0", *numbers)
        rig.feed("input1", *lists)
        await rig.tick()
        for name in ("output0_0", "output0_1"):
            assert rig.received(name) == numbers
        for name in ("output1_0", "output1_1", "output1_2"):
            assert rig.received(name) == lists
        assert rig.find_aliasing() == []
        assert list(rig.components[0].ports) == [
            *("input0", "output0_0", "output0_1"),
            *("input1", "output1_0", "output1_1", "output1_2"),
        ]


async def _system(kernel: Kernel, **slow: Any) -> tuple[OutPort[TimedLong], InPort[TimedLong], InPort[TimedLong]]:
    """What feeds a dupe, an in-port that is never full, and one with the options `slow`."""
    dupe = await kernel.create(FlexiDupe, "dupe", inputs=["TimedLong:2"])
    user = await kernel.create(Component)
    feed = user.add_port("feed", OutPort(TimedLong))
    free, full = (user.add_port(name, InPort(TimedLong)) for name in ("free", "full"))
    await kernel.connect(feed, dupe.ports["input0"], length=1_000)
    await kernel.connect(dupe.ports["output0_0"], full, full="block", **slow)  # the slow one is the first
    await kernel.connect(dupe.ports["output0_1"], free, length=1_000)
    await kernel.start(EventContext(), dupe, activate=True)
    return feed, free, full


@simulated
async def test_a_reader_that_blocks_does_not_keep_a_sample_from_the_others() -> None:
    async with Kernel() as kernel:
        feed, free, full = await _system(kernel, length=1, timeout=None)
        for number in range(3):
            feed.write_nowait(TimedLong(number, number))
        await kernel.sleep(0.01)
        assert [sample.data for sample in free.drain()] == [0, 1]  # 1 waits at the full one, the free one has it
        assert full.read_nowait().data == 0
        await kernel.sleep(0.01)
        assert [sample.data for sample in free.drain()] == [2]
        assert [(await full.read()).data, (await full.read()).data] == [1, 2]


@simulated
async def test_two_readers_that_block_are_waited_for_together() -> None:
    async with Kernel() as kernel:
        dupe = await kernel.create(FlexiDupe, "dupe", inputs=["TimedLong:3"])
        user = await kernel.create(Component)
        feed = user.add_port("feed", OutPort(TimedLong))
        await kernel.connect(feed, dupe.ports["input0"], length=1_000)
        for copy in range(3):
            port = user.add_port(f"p{copy}", InPort(TimedLong))
            await kernel.connect(dupe.ports[f"output0_{copy}"], port, length=1, full="block", timeout=2.0)
        await kernel.start(EventContext(), dupe, activate=True)
        feed.write_nowait(TimedLong(0, 0))
        feed.write_nowait(TimedLong(1, 1))
        await kernel.sleep(1.9)
        assert dupe.state is LifecycleState.ACTIVE
        await kernel.sleep(0.2)
        assert dupe.state is LifecycleState.ERROR
        assert isinstance(dupe.last_error, WriteTimeout)
        assert all(f"p{copy}" in str(dupe.last_error) for copy in range(3))


@simulated
async def test_it_loses_nothing_at_any_rate_of_its_context() -> None:
    async with Kernel() as kernel:
        dupe = await kernel.create(FlexiDupe, inputs=["TimedString:2"])
        user = await kernel.create(Component)
        feed = user.add_port("feed", OutPort(TimedString))
        taker = user.add_port("taker", InPort(TimedString))
        await kernel.connect(feed, dupe.ports["input0"], length=1_000)
        await kernel.connect(dupe.ports["output0_1"], taker, length=1_000)
        await kernel.start(PeriodicContext(rate=1.0), dupe, activate=True)
        for number in range(1_000):
            feed.write_nowait(TimedString(0, str(number)))
        await kernel.sleep(1.5)
        assert [sample.data for sample in taker.drain()] == [str(number) for number in range(1_000)]


@pytest.mark.anyio
@pytest.mark.fault("F06")
@pytest.mark.parametrize(
    ("specs", "said"),
    [
        ([], "at least one TYPE:N"),
        (["TimedFoo:2"], "input0 'TimedFoo:2', character 1: unknown type 'TimedFoo'"),
        (["TimedLong:2", "TimedLong"], "input1 'TimedLong', character 10: expected ':'"),
        (["TimedLong:0"], "input0 'TimedLong:0', character 11: expected how many ports, from 1 to 1000, found '0'"),
        (["TimedLong:-1"], "character 11"),
        (["TimedLong:1.5"], "character 11"),
        (["TimedLong:"], "character 11: expected how many ports, from 1 to 1000, found the end"),
        (["TimedLong:1000000000"], "character 11"),
        ([":2"], "character 1: unknown type ''"),
        ([":"], "character 1"),
        (["a:b:c"], "unknown type 'a'"),
        (["TimedLong:2:3"], "character 11"),
        (["GPSFixType:2"], "cannot be a port's type"),
    ],
)
async def test_a_bad_spec_is_refused_with_the_place(specs: list[str], said: str) -> None:
    async with Kernel() as kernel:
        with pytest.raises(ValueError, match=re.escape(said)):
            await kernel.create("FlexiDupe", inputs=specs)
        assert not kernel.components


@pytest.mark.slow
def test_it_keeps_what_components_promise() -> None:
    check_component(Two, deterministic=True)
