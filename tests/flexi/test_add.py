"""FlexiAdd: sums of every type that has one, by the rules that were asked for, and reasons for what has none."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts import Component, EventContext, InPort, Kernel, LifecycleState, OutPort
from aiorts.errors import ConfigurationError, ConversionError
from aiorts.kernel.configuring import put_parameters
from aiorts.testing import Rig, check_component, simulated
from aiorts.types import (
    Point2D,
    Point3D,
    PointCloud,
    PointCloudPoint,
    Pose2D,
    RangeData,
    TimedDouble,
    TimedDoubleSeq,
    TimedFloat,
    TimedLong,
    TimedOctet,
    TimedOctetSeq,
    TimedPoint3D,
    TimedPose2D,
    TimedShort,
    TimedULongLongSeq,
    TimedVelocity2D,
    Velocity2D,
    all_types,
    find_type,
)
from aiorts_flexi.add import FlexiAdd
from aiorts_flexi.summing import Summation
from campaign import cases

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence


def added(samples: Sequence[Any], overflow: str = "error", tm: int = 0) -> Any:
    """The sum of samples of input0, input1, ..."""
    return Summation(type(samples[0]), overflow)(samples, [f"input{n}" for n in range(len(samples))], tm)


def add(**params: Any) -> FlexiAdd:
    """One with these parameters, ready for a rig."""

    made = FlexiAdd("add")
    put_parameters(made, {"port": "TimedLong:2", **params})
    return made


@dataclass(frozen=True)
class Wheels:
    """A user's own dataclass."""

    left: float = 0.0
    right: int = 0


@pytest.mark.parametrize(
    ("samples", "total"),
    [
        ([TimedLong(1, 2), TimedLong(9, 3), TimedLong(4, -6)], TimedLong(9, -1)),
        ([TimedDouble(1, 0.5), TimedDouble(2, 0.25)], TimedDouble(9, 0.75)),
        ([TimedDoubleSeq(1, [1, 2]), TimedDoubleSeq(2, [3, -5])], TimedDoubleSeq(9, [4.0, -3.0])),
        ([TimedDoubleSeq(1, []), TimedDoubleSeq(2, [])], TimedDoubleSeq(9, [])),
        ([TimedOctetSeq(1, b"\1\2"), TimedOctetSeq(2, b"\3\4")], TimedOctetSeq(9, b"\4\6")),
        ([TimedULongLongSeq(1, [2**63]), TimedULongLongSeq(2, [2**63 - 1])], TimedULongLongSeq(9, [2**64 - 1])),
        ([TimedPoint3D(1, Point3D(1, 2, 3)), TimedPoint3D(2, Point3D(4, 5, 6))], TimedPoint3D(9, Point3D(5, 7, 9))),
        ([Point3D(1, 2, 3), Point3D(4, 5, 6)], Point3D(5.0, 7.0, 9.0)),
        (
            [TimedPose2D(1, Pose2D(Point2D(1, 2), 3)), TimedPose2D(2, Pose2D(Point2D(1, 1), 1))],
            TimedPose2D(9, Pose2D(Point2D(2, 3), 4)),
        ),
        ([TimedVelocity2D(1, Velocity2D(1, 0, 2))] * 3, TimedVelocity2D(9, Velocity2D(3, 0, 6))),
        ([RangeData(1, ranges=[1, 2]), RangeData(2, ranges=[3, 4])], RangeData(9, ranges=[4, 6])),
        ([1, 2], 3),
        ([0.5, 1.0], 1.5),
        ([Wheels(1.0, 2), Wheels(3.0, 4)], Wheels(4.0, 6)),
    ],
)
def test_scalars_vectors_and_records_are_added_member_by_member(samples: list[Any], total: Any) -> None:
    made = added(samples, tm=9)
    assert type(made) is type(total)
    assert made == total


def test_sequences_of_records_are_added_item_by_item() -> None:
    def cloud(*points: float) -> PointCloud:
        return PointCloud(1, points=[PointCloudPoint(Point3D(p, 0, 0)) for p in points])

    total = added([cloud(1, 2), cloud(10, 20)])
    assert [point.point.x for point in total.points] == [11.0, 22.0]
    with pytest.raises(ConversionError, match="input0 has 2 items and input1 has 1"):
        added([cloud(1, 2), cloud(10)])


@pytest.mark.parametrize("wait", ["last", "all"])
@simulated
async def test_lengths_that_differ_are_an_error_that_names_both(wait: str) -> None:
    component = add(port="TimedDoubleSeq:3", wait=wait)
    async with Rig(component) as rig:
        with rig.expect_error(ConversionError) as caught:
            for number, data in enumerate(([1.0], [1.0], [1.0, 2.0])):
                rig.feed(f"input{number}", TimedDoubleSeq(0, data))
            await rig.tick()
        said = str(caught.error)
        assert "data: input0 has 1 items and input2 has 2" in said
        assert component.state is LifecycleState.ERROR


@pytest.mark.row(123)
@simulated
async def test_last_adds_the_last_known_of_each_input_that_has_sent() -> None:
    async with Rig(add(port="TimedDoubleSeq:2")) as rig:
        rig.feed("input1", TimedDoubleSeq(5, [1.0]))  # input0 has not sent yet
        await rig.tick()
        rig.feed("input0", TimedDoubleSeq(4, [10.0]), TimedDoubleSeq(6, [20.0]))
        await rig.tick()
        await rig.tick()
        assert rig.received("output") == [
            TimedDoubleSeq(5, [1.0]),
            TimedDoubleSeq(5, [11.0]),
            TimedDoubleSeq(6, [21.0]),
        ]
        await rig.deactivate()
        await rig.activate()
        rig.clear()
        rig.feed("input0", TimedDoubleSeq(7, [3.0]))
        await rig.tick()
        assert rig.received("output") == [TimedDoubleSeq(7, [3.0])]


@simulated
async def test_all_waits_for_one_sample_of_each() -> None:
    async with Rig(add(wait="all", time="oldest")) as rig:
        rig.feed("input0", TimedLong(1, 1), TimedLong(2, 2))
        await rig.tick()
        assert rig.received("output") == []
        rig.feed("input1", TimedLong(9, 10))
        await rig.tick()
        assert rig.received("output") == [TimedLong(1, 11)]
        rig.feed("input1", TimedLong(9, 20), TimedLong(9, 30))
        await rig.tick()
        assert rig.received("output") == [TimedLong(1, 11), TimedLong(2, 22)]
        rig.feed("input0", TimedLong(3, 3))
        await rig.tick()
        assert rig.values("output") == [11, 22, 33]


@simulated
async def test_waiting_for_all_keeps_no_more_than_the_connectors_hold() -> None:
    async with Kernel() as kernel:
        adder = await kernel.create(FlexiAdd, port="TimedLong:2", wait="all")
        user = await kernel.create(Component)
        feeds = [user.add_port(f"feed{n}", OutPort(TimedLong)) for n in range(2)]
        taker = user.add_port("taker", InPort(TimedLong))
        for feed, port in zip(feeds, ("input0", "input1"), strict=True):
            await kernel.connect(feed, adder.ports[port], length=4)
        await kernel.connect(adder.ports["output"], taker, length=100)
        await kernel.start(EventContext(), adder, activate=True)
        for number in range(1_000):
            await feeds[0].write(TimedLong(0, number))
        await kernel.sleep(1.0)
        for _ in range(20):
            await feeds[1].write(TimedLong(0, 0))
            await kernel.sleep(0.01)
        # What the full policy of the connector kept: the newest ones of its buffer.
        assert [sample.data for sample in taker.drain()] == [996, 997, 998, 999]


@pytest.mark.parametrize(("time", "tm"), [("newest", 30), ("oldest", 10)])
@simulated
async def test_the_time_is_of_the_samples_that_were_added(time: str, tm: int) -> None:
    async with Rig(add(port="TimedLong:3", time=time)) as rig:
        rig.feed("input2", TimedLong(10, 1))
        rig.feed("input0", TimedLong(30, 1))
        rig.feed("input1", TimedLong(20, 1))
        await rig.tick()
        assert rig.received("output")[-1] == TimedLong(tm, 3)


@pytest.mark.row(127)
@pytest.mark.parametrize(
    ("sample", "overflow", "result"),
    [
        (TimedShort(0, 30_000), "saturate", 32_767),
        (TimedShort(0, 30_000), "wrap", 60_000 - 65_536),
        (TimedOctet(0, 200), "saturate", 255),
        (TimedOctet(0, 200), "wrap", 144),
        (TimedDouble(0, 1.7e308), "saturate", 1.7976931348623157e308),
        (TimedDouble(0, -1.7e308), "wrap", -math.inf),
        (TimedFloat(0, 3e38), "saturate", 3.4028234663852886e38),
        (TimedDoubleSeq(0, [-1.7e308]), "saturate", [-1.7976931348623157e308]),
        (TimedDoubleSeq(0, [1.7e308]), "wrap", [math.inf]),
        (TimedOctetSeq(0, b"\xff"), "wrap", [254]),
        (TimedULongLongSeq(0, [2**64 - 1]), "saturate", [2**64 - 1]),
    ],
)
def test_a_sum_out_of_range_is_what_was_asked_for(sample: Any, overflow: str, result: Any) -> None:
    made = added([sample, sample], overflow).data
    assert (list(made) if isinstance(result, list) else made) == result
    with pytest.raises(ConversionError, match=f"sum of .*{'data'}"):
        added([sample, sample])


def test_what_is_not_finite_goes_through_as_it_is() -> None:
    for first, second, total in ((math.inf, 1.0, math.inf), (math.nan, 1.0, math.nan), (math.inf, -math.inf, math.nan)):
        for cls, wrap in ((TimedDouble, lambda x: x), (TimedDoubleSeq, lambda x: [x])):
            made = added([cls(0, wrap(first)), cls(0, wrap(second))])
            assert made == cls(0, wrap(total))


@pytest.mark.anyio
@pytest.mark.fault("F06")
@pytest.mark.parametrize(
    ("port", "said"),
    [
        ("", "unknown type ''"),
        ("TimedLong", "port 'TimedLong', character 10: expected ':'"),
        ("TimedLong:x", "character 11: expected how many ports"),
        ("TimedLong:0", "character 11"),
        ("TimedFoo:2", "did you mean"),
        ("TimedString:2", "TimedString.data: texts have no sum"),
        ("TimedStringSeq:2", "TimedStringSeq.data: texts have no sum"),
        ("TimedBoolean:2", "TimedBoolean.data: truth values have no sum"),
        ("TimedChar:2", "TimedChar.data: characters have no sum"),
        ("TimedMap:2", "TimedMap.data: the entries of a map"),
        ("TimedNDArray:2", "TimedNDArray.data: an array of any shape"),
        ("CameraImage:2", "CameraImage.format: texts have no sum"),
        ("GPSData:2", "GPSData.fixType"),
        ("str:2", "str: texts have no sum"),
        ("bool:2", "bool: truth values have no sum"),
    ],
)
async def test_what_has_no_sum_is_refused_at_creation_with_the_reason(port: str, said: str) -> None:
    async with Kernel() as kernel:
        with pytest.raises(ConfigurationError, match=re.escape(said)):
            await kernel.create("FlexiAdd", port=port)
        assert not kernel.components


def test_every_type_is_added_or_refused_when_it_becomes_known() -> None:
    sums, refused = 0, {}
    for cls in list(all_types().values()):
        if cls.__module__.rpartition(".")[0] != "aiorts.types" or not hasattr(cls, "__dataclass_fields__"):
            continue
        try:
            Summation(cls, "error")
        except ConfigurationError as error:
            refused[cls.__name__] = str(error)
            continue
        assert added([cls(), cls()]) == cls(), cls
        sums += 1
    assert sums > 70
    assert all(reason.startswith(f"{name}.") for name, reason in refused.items())


@simulated
async def test_the_policy_may_change_while_it_runs() -> None:
    component = add(port="TimedShort:2")
    async with Rig(component) as rig:
        rig.feed("input0", TimedShort(0, 30_000))
        await rig.tick()
        await component.configure(overflow="saturate")
        rig.feed("input1", TimedShort(0, 30_000))
        await rig.tick()
        assert rig.values("output") == [30_000, 32_767]


INTEGERS = {
    f"Timed{u}{n}": (0 if u else -(2 ** (b - 1)), 2**b - 1 if u else 2 ** (b - 1) - 1)
    for n, b in (("Short", 16), ("Long", 32), ("LongLong", 64))
    for u in ("", "U")
}


@pytest.mark.slow(kept_by="test_a_sum_out_of_range_is_what_was_asked_for")
@given(st.data(), st.sampled_from(sorted(INTEGERS)), st.sampled_from(["error", "saturate", "wrap"]), st.booleans())
@settings(max_examples=cases(10_000))
def test_integer_sums_are_exact_or_what_the_policy_says(data: Any, name: str, overflow: str, sequence: bool) -> None:
    low, high = INTEGERS[name]
    cls = find_type(f"{name}Seq" if sequence else name)
    values = data.draw(st.lists(st.integers(low, high), min_size=1, max_size=5))
    total = sum(values)
    expected = {"saturate": min(max(total, low), high), "wrap": (total - low) % (high - low + 1) + low}.get(overflow)
    samples = [cls(0, [value] if sequence else value) for value in values]
    if overflow == "error" and not low <= total <= high:
        with pytest.raises(ConversionError):
            added(samples, overflow)
        return
    made = added(samples, overflow).data
    assert (made.tolist()[0] if sequence else made) == (total if overflow == "error" else expected)


@pytest.mark.slow(kept_by="test_scalars_vectors_and_records_are_added_member_by_member")
@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1, max_size=6))
@settings(max_examples=cases(5_000))
def test_float_sums_are_those_of_the_machine_for_scalars_and_sequences_alike(values: list[float]) -> None:
    def made(cls: Any, wrap: Callable[[float], Any]) -> Any:
        return added([cls(0, wrap(value)) for value in values], "wrap").data

    scalar, (item,) = made(TimedDouble, lambda x: x), made(TimedDoubleSeq, lambda x: [x]).tolist()
    assert scalar == item or (math.isnan(scalar) and math.isnan(item))
    if math.isfinite(scalar):
        exact = sum(map(Fraction, values))
        assert abs(Fraction(scalar) - exact) <= len(values) * Fraction(2) ** -52 * sum(abs(Fraction(v)) for v in values)


@pytest.mark.slow(kept_by="flexi/test_const.py::test_it_keeps_what_components_promise")
def test_it_keeps_what_components_promise() -> None:
    check_component(add, deterministic=True)
    check_component(lambda: add(wait="all"), deterministic=True)
