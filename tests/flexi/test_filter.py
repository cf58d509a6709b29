"""FlexiFilter as a user meets it: samples in, samples out, and errors that name ports and pins."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import pytest

from aiorts import Component, EventContext, InPort, Kernel, LifecycleState, OutPort, PeriodicContext
from aiorts.errors import ConfigurationError, ConversionError
from aiorts.testing import simulated
from aiorts.types import (
    Point2D,
    Pose2D,
    RangeData,
    TimedBoolean,
    TimedDouble,
    TimedDoubleSeq,
    TimedFloat,
    TimedFloatSeq,
    TimedLong,
    TimedLongLong,
    TimedPose2D,
    TimedShort,
    TimedString,
    TimedStringSeq,
    TimedUShort,
)

if TYPE_CHECKING:
    from conftest import Harness

pytestmark = pytest.mark.anyio


async def test_every_sample_gives_one_sample_whatever_is_buffered(harness: Harness) -> None:
    await harness.build(["TimedLong"], ["TimedLong"], "0>2>0")
    await harness.feed(0, *(TimedLong(n, n) for n in range(1_000)))
    assert [s.data for s in await harness.take(0, 1_000)] == [2 * n for n in range(1_000)]
    assert harness.left(0) == []


async def test_it_loses_nothing_in_a_periodic_context_either(harness: Harness) -> None:
    await harness.build(["TimedLong"], ["TimedLong"], "0>0")
    await harness.context.remove(harness.filter)
    await harness.kernel.start(PeriodicContext(rate=500.0), harness.filter, activate=True)
    await harness.feed(0, *(TimedLong(n, n) for n in range(50)))
    assert [s.data for s in await harness.take(0, 50)] == list(range(50))


@pytest.mark.row(123)
async def test_the_map_of_the_paper_works(harness: Harness) -> None:
    await harness.build(
        ["TimedFloatSeq:2", "TimedString", "TimedLong"],
        ["TimedStringSeq:4", "TimedFloat"],
        "2>0:2,0:1>0.1>0:3,0:1>1",
    )
    await harness.feed(2, TimedLong(5, 7))
    assert await harness.take(0) == [TimedStringSeq(5, ("", "", "7", ""))]
    await harness.feed(0, TimedFloatSeq(6, [1.0, 20.0]))
    assert await harness.take(0) == [TimedStringSeq(5, ("", "", "7", "2.0"))]
    assert await harness.take(1) == [TimedFloat(6, 20.0)]


@pytest.mark.row(126)
@pytest.mark.row(127)
@pytest.mark.parametrize(
    ("rules", "value", "result"),
    [
        ({}, 1.001, 1001),
        ({"rounding": "truncate"}, 1.0019, 1001),
        ({"rounding": "floor"}, -0.0001, -1),
        ({"overflow": "saturate"}, 3e10, 2**31 - 1),
        ({"overflow": "wrap"}, 3e6, 3_000_000_000 - 2**32),
        ({"clamp": (-5.0, 5.0)}, 1.0, 5),
        ({"nan": "7"}, math.nan, 7000),
    ],
)
async def test_metres_to_millimetres_under_each_rule(
    harness: Harness, rules: dict[str, Any], value: float, result: int
) -> None:
    await harness.build(["TimedDouble"], ["TimedLong"], "0>1000>0", **rules)
    await harness.feed(0, TimedDouble(1, value))
    assert await harness.take(0) == [TimedLong(1, result)]


@pytest.mark.parametrize(
    ("ports", "map_", "sample", "said"),
    [
        (("TimedDouble", "TimedLong"), "0>0", TimedDouble(0, 3e10), "0:0>0:0: expected a value that i32 holds"),
        (("TimedDouble", "TimedLong"), "0>0", TimedDouble(0, math.nan), "NaN"),
        (("TimedDouble", "TimedDouble"), "0>1e300>0", TimedDouble(0, 1e300), "too large"),
        (("TimedLong", "TimedUShort"), "0>0", TimedLong(0, -1), "u16"),
        (("TimedString", "TimedLong"), "0>0", TimedString(0, "seven"), "seven"),
        (("TimedDoubleSeq:3", "TimedDouble"), "0:2>0", TimedDoubleSeq(0, [1.0]), "input0"),
        (("TimedDoubleSeq:3", "TimedDouble"), "0:1>0", TimedDoubleSeq(0, [1.0]), "input0"),
    ],
)
async def test_what_cannot_be_converted_is_an_error_that_names_the_entry(
    harness: Harness, ports: tuple[str, str], map_: str, sample: Any, said: str
) -> None:
    await harness.build([ports[0]], [ports[1]], map_)
    await harness.feed(0, sample)
    while harness.filter.state is not LifecycleState.ERROR:
        await harness.kernel.sleep(0.001)
    assert isinstance(harness.filter.last_error, ConversionError)
    assert said in str(harness.filter.last_error)
    assert harness.left(0) == []


async def test_text_is_converted_by_what_it_says(harness: Harness) -> None:
    await harness.build(["TimedString"], ["TimedBoolean", "TimedDouble"], "0>0", combine="")
    await harness.feed(0, TimedString(1, "False"))
    assert await harness.take(0) == [TimedBoolean(1, False)]


async def test_text_is_multiplied_by_what_it_says(harness: Harness) -> None:
    await harness.build(["TimedString"], ["TimedUShort"], "0>10>0")
    await harness.feed(0, TimedString(1, "3.7"))
    assert await harness.take(0) == [TimedUShort(1, 37)]


async def test_integers_of_64_bits_stay_exact(harness: Harness) -> None:
    await harness.build(["TimedLongLong"], ["TimedLongLong"], "0>3-1>0")
    await harness.feed(0, TimedLongLong(1, 2**61 + 1))
    assert await harness.take(0) == [TimedLongLong(1, 3 * (2**61 + 1) - 1)]


async def test_fields_of_records_are_pins(harness: Harness) -> None:
    await harness.build(
        ["TimedPose2D", "RangeData"],
        ["TimedPose2D", "TimedDouble"],
        "0:position.x>1000>0:position.y, 0:heading>0:heading, 1:ranges[1]>1",
    )
    await harness.feed(0, TimedPose2D(3, Pose2D(Point2D(1.5, 2.5), 0.25)))
    assert await harness.take(0) == [TimedPose2D(3, Pose2D(Point2D(0.0, 1500.0), 0.25))]
    await harness.feed(1, RangeData(4, ranges=[1.0, 2.0]))
    assert await harness.take(1) == [TimedDouble(4, 2.0)]


@pytest.mark.parametrize(("time", "tm"), [("oldest", 10), ("newest", 20)])
async def test_the_time_is_of_the_sources_that_have_sent(harness: Harness, time: str, tm: int) -> None:
    await harness.build(["TimedLong"] * 3, ["TimedLongSeq:3"], "0>0:0,1>0:1,2>0:2", time=time)
    await harness.feed(0, TimedLong(10, 1))
    assert (await harness.take(0))[0].tm == 10
    await harness.feed(1, TimedLong(20, 2))
    sample = (await harness.take(0))[0]
    assert sample.tm == tm
    assert list(sample.data) == [1, 2, 0]


@simulated
async def test_a_reader_that_blocks_does_not_keep_a_sample_from_the_other_outputs() -> None:
    async with Kernel() as kernel:
        component = await kernel.create("FlexiFilter", inputs=["TimedLong"], outputs=["TimedLong"] * 2, map="0>0,0>1")
        user = await kernel.create(Component)
        feed, full, free = (
            user.add_port("feed", OutPort(TimedLong)),
            *(user.add_port(name, InPort(TimedLong)) for name in ("full", "free")),
        )
        await kernel.connect(feed, component.ports["input0"])
        await kernel.connect(component.ports["output0"], full, length=1, full="block", timeout=None)
        await kernel.connect(component.ports["output1"], free)
        await kernel.start(EventContext(), component, activate=True)
        for number in range(3):
            feed.write_nowait(TimedLong(number, number))
        await kernel.sleep(0.05)
        assert [sample.data for sample in free.drain()] == [0, 1]
        assert [(await full.read()).data for _ in range(3)] == [0, 1, 2]


async def test_reset_sets_the_pins_that_got_nothing_new(harness: Harness) -> None:
    await harness.build(["TimedLong"] * 2, ["TimedLongSeq:3"], "0>0:0,1>0:1", reset="-1")
    await harness.feed(0, TimedLong(10, 1))
    assert list((await harness.take(0))[0].data) == [1, -1, -1]
    await harness.feed(1, TimedLong(20, 2))
    sample = (await harness.take(0))[0]
    assert list(sample.data) == [-1, 2, -1]
    assert sample.tm == 20


async def test_its_parameter_reset_and_the_reset_of_the_kernel_are_two_things(harness: Harness) -> None:
    await harness.build(["TimedLong"], ["TimedShort"], "0>0", reset="-1")
    kernel, name = harness.kernel, harness.filter.name
    await harness.feed(0, TimedLong(0, 70_000))
    for _ in range(100):
        if harness.filter.state is LifecycleState.ERROR:
            break
        await kernel.sleep(0.01)
    await kernel.reset(name)
    assert harness.filter.state is LifecycleState.INACTIVE
    await kernel.activate(name)
    await harness.feed(0, TimedLong(1, 7))
    assert (await harness.take(0))[0].data == 7
    assert harness.filter.params["reset"].value == "-1"


@pytest.mark.row(126)
@pytest.mark.parametrize(("combine", "result"), [("sum", 5), ("min", 2), ("max", 3), ("newest", 2)])
async def test_several_entries_to_one_pin_are_combined(harness: Harness, combine: str, result: int) -> None:
    await harness.build(["TimedShort"] * 2, ["TimedShort"], "0>0,1>0", combine=combine)
    await harness.feed(0, TimedShort(1, 3))
    assert (await harness.take(0))[0].data == 3
    await harness.feed(1, TimedShort(2, 2))
    assert (await harness.take(0))[0].data == result


@pytest.mark.fault("F07")
@pytest.mark.parametrize(
    ("inputs", "outputs", "map_", "said"),
    [
        (["TimedLong"] * 2, ["TimedLong"], "0>0,1>0", "0:0>0:0 and 1:0>0:0 feed one pin"),
        (["TimedLong"], ["TimedLong"], "1>0", "no in-port 1; there are input0"),
        (["TimedLong"], ["TimedLong"], "0>1", "no out-port 1; there are output0"),
        (["TimedLong"], ["TimedLong"], "0:1>0", "no such pin; the last one is 0"),
        (["TimedLong"], ["TimedLongSeq:2"], "0>0:2", "no such pin; the last one is 1"),
        (["TimedPose2D"], ["TimedLong"], "0>0", "named pins"),
        (["TimedPose2D"], ["TimedLong"], "0:position.z>0", "no field 'z'"),
        (["TimedChar"], ["TimedLong"], "0>2>0", "cannot be multiplied"),
        (["TimedLong"], ["RangeData"], "0>0:ranges[0]", "without index"),
        (["TimedLong"], ["TimedLong"], "0>>0", "character 3"),
    ],
)
async def test_a_map_that_does_not_fit_its_ports_is_refused_at_creation(
    inputs: list[str], outputs: list[str], map_: str, said: str
) -> None:
    async with Kernel() as kernel:
        with pytest.raises(ConfigurationError) as caught:
            await kernel.create("FlexiFilter", "f", inputs=inputs, outputs=outputs, map=map_)
        assert said in str(caught.value)
        assert not kernel.components


async def test_the_map_may_change_between_two_samples(harness: Harness) -> None:
    await harness.build(["TimedLong"], ["TimedLong"], "0>2>0")
    await harness.feed(0, TimedLong(1, 1))
    assert (await harness.take(0))[0].data == 2
    await harness.filter.configure(map="0>3>0")
    await harness.feed(0, TimedLong(2, 1))
    assert (await harness.take(0))[0].data == 3


@pytest.mark.fault("B05")
@pytest.mark.parametrize(
    ("source", "target", "value"),
    [
        ("TimedDouble", "TimedLong", 3e10),
        ("TimedDouble", "TimedLong", math.nan),
        ("TimedDouble", "TimedOctet", 300.7),
        ("TimedLong", "TimedUShort", -1),
        ("TimedULongLong", "TimedLongLong", 2**63),
        ("TimedDouble", "TimedFloat", 1e300),
        ("TimedWString", "TimedChar", "\u65e5"),
    ],
)
async def test_no_value_is_changed_in_silence(harness: Harness, source: str, target: str, value: Any) -> None:
    from aiorts.types import find_type

    await harness.build([source], [target], "0>0")
    await harness.feed(0, find_type(source)(0, value))
    while harness.filter.state is not LifecycleState.ERROR:
        await harness.kernel.sleep(0.001)
    assert isinstance(harness.filter.last_error, ConversionError)
