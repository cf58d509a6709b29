"""FlexiSelect: what is selected goes through unchanged, nothing else does, and no selection is out of range."""

from __future__ import annotations

import re
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts import Kernel, LifecycleState
from aiorts.kernel.configuring import put_parameters
from aiorts.testing import Rig, check_component, simulate, simulated
from aiorts.types import Point2D, Pose2D, TimedLong, TimedPose2D, TimedShort, find_type
from aiorts_flexi.select import FlexiSelect, SelectionError
from campaign import cases


def select(**params: Any) -> FlexiSelect:
    """One with these parameters, ready for a rig."""

    made = FlexiSelect("select")
    put_parameters(made, {"port": "TimedLong:3", **params})
    return made


@pytest.mark.row(123)
@simulated
async def test_the_selected_input_goes_on_unchanged() -> None:
    async with Rig(select(port="TimedPose2D:2")) as rig:
        poses = [TimedPose2D(5, Pose2D(Point2D(1.0, 2.0), 3.0)), TimedPose2D(6, Pose2D(Point2D(4.0, 5.0), 6.0))]
        for number in (0, 1):
            rig.feed("input0", poses[0])
            rig.feed("input1", poses[1])
            rig.feed("selection", TimedShort(9, number))
            await rig.tick()
        assert rig.received("output") == poses


@simulated
async def test_no_old_sample_comes_out_on_switching() -> None:
    async with Rig(select()) as rig:
        for number in range(5):
            rig.feed("input1", TimedLong(number, 100 + number))
            await rig.tick()
        rig.feed("selection", TimedShort(9, 1))
        await rig.tick()
        assert rig.received("output") == []
        rig.feed("input1", TimedLong(10, 200))
        await rig.tick()
        assert rig.values("output") == [200]


@pytest.mark.parametrize("value", [3, 32767, -1, -3, -32768])
@simulated
async def test_a_selection_out_of_range_is_an_error_and_the_last_valid_one_stays(value: int) -> None:
    component = select()
    async with Rig(component) as rig:
        rig.feed("selection", TimedShort(1, 2))
        await rig.tick()
        with rig.expect_error(SelectionError) as caught:
            rig.feed("selection", TimedShort(2, value))
            await rig.tick()
        assert str(caught.error).startswith(f"select.selection: expected a selection 0..2, got {value}; ")
        assert "input2 stays selected" in str(caught.error)
        assert component.state is LifecycleState.ERROR
        await rig.reset()
        await rig.activate()
        for number in range(3):
            rig.feed(f"input{number}", TimedLong(number, number))
        await rig.tick()
        assert rig.values("output") == [2]


@pytest.mark.parametrize(("out_of_range", "got"), [("hold", [1]), ("none", [])])
@simulated
async def test_out_of_range_may_hold_the_last_or_select_nothing(out_of_range: str, got: list[int]) -> None:
    async with Rig(select(out_of_range=out_of_range, initial=1)) as rig:
        for bad in (7, -1):
            rig.clear()
            rig.feed("selection", TimedShort(1, bad))
            for number in range(3):
                rig.feed(f"input{number}", TimedLong(number, number))
            await rig.tick()
            assert rig.values("output") == got
        rig.feed("selection", TimedShort(1, 0))
        rig.feed("input0", TimedLong(0, 5))
        await rig.tick()
        assert rig.values("output") == [*got, 5]


@pytest.mark.parametrize(
    "selection_type",
    [
        "TimedBoolean",
        "bool",
        "int",
        "TimedOctet",
        *(f"Timed{u}{n}" for u in ("", "U") for n in ("Short", "Long", "LongLong")),
    ],
)
@simulated
async def test_any_integer_or_truth_value_selects(selection_type: str) -> None:
    cls = find_type(selection_type)
    one: Any = cls(1) if selection_type in ("bool", "int") else cls(3, selection_type == "TimedBoolean" or 1)
    async with Rig(select(selection_type=selection_type, port="TimedLong:2", feedback=True)) as rig:
        rig.feed("selection", one)
        rig.feed("input0", TimedLong(1, 10))
        rig.feed("input1", TimedLong(1, 11))
        await rig.tick()
        assert rig.values("output") == [11]
        assert rig.values("selected") == [0, 1]
        assert all(type(sample) is cls for sample in rig.received("selected"))


@simulated
async def test_in_a_cycle_selections_come_first_and_the_last_one_counts() -> None:
    async with Rig(select()) as rig:
        rig.feed("input0", TimedLong(1, 0))
        rig.feed("input2", TimedLong(9, 2))
        rig.feed("selection", TimedShort(5, 1), TimedShort(6, 2))
        await rig.tick()
        assert rig.values("output") == [2]


@simulated
async def test_by_time_stamp_each_sample_goes_by_the_selection_of_its_moment() -> None:
    async with Rig(select(order="tm")) as rig:
        for tm in range(10):
            for number in range(3):
                rig.feed(f"input{number}", TimedLong(tm, 10 * tm + number))
        rig.feed("selection", TimedShort(3, 1), TimedShort(7, 2))
        # Eight are what a connector of the rig's own holds.
        await rig.tick()
        expected = [10 * tm + (0 if tm < 3 else 1 if tm < 7 else 2) for tm in range(10)]
        assert rig.values("output") == expected[-len(rig.values("output")) :]
        assert len(rig.values("output")) >= 8


@pytest.mark.slow(kept_by="first")
@given(
    st.lists(
        st.tuples(st.sampled_from(["selection", "input0", "input1", "input2", "tick"]), st.integers(-1, 3)), max_size=40
    )
)
@settings(max_examples=cases(2_000), deadline=None)
def test_against_a_model_nothing_but_the_selected_ever_comes_out(steps: list[tuple[str, int]]) -> None:
    async def main() -> None:
        async with Rig(select(out_of_range="hold"), debug=False) as rig:
            chosen, expected = 0, []
            fed: dict[str, list[int]] = {}
            serial = 0
            for port, value in [*steps, ("tick", 0)]:
                if port == "tick":
                    for selection in fed.pop("selection", []):
                        chosen = selection if 0 <= selection < 3 else chosen
                    expected += fed.get(f"input{chosen}", [])
                    fed = {}
                    await rig.tick()
                    assert rig.values("output") == expected
                elif len(fed.setdefault(port, [])) < 8:
                    serial += 1
                    number = value if port == "selection" else serial
                    fed[port].append(number)
                    rig.feed(port, TimedShort(0, number) if port == "selection" else TimedLong(0, number))

    simulate(main())


@pytest.mark.anyio
@pytest.mark.fault("F06")
@pytest.mark.parametrize(
    ("params", "said"),
    [
        ({}, "port '', character 1: unknown type"),
        ({"port": "TimedLong"}, "character 10: expected ':'"),
        ({"port": "TimedLong:0"}, "character 11"),
        ({"port": "TimedLong:2", "initial": 2}, "initial = 2: expected 0..1"),
        ({"port": "TimedLong:2", "initial": -1}, "initial"),
        ({"port": "TimedLong:2", "selection_type": "TimedDouble"}, "expected an integer or a truth value"),
        ({"port": "TimedLong:2", "selection_type": "TimedString"}, "expected an integer or a truth value"),
        ({"port": "TimedLong:2", "selection_type": "TimedShortt"}, "did you mean TimedShort"),
        ({"port": "TimedLong:2", "selection_type": "TimedShortSeq:2"}, "expected an integer or a truth value"),
        ({"port": "float:2", "order": "tm"}, "which have no time"),
        ({"port": "TimedLong:2", "selection_type": "int", "order": "tm"}, "which have no time"),
        ({"port": "TimedLong:5", "selection_type": "TimedBoolean", "initial": 3, "feedback": True}, "initial"),
    ],
)
async def test_bad_parameters_are_refused_at_creation(params: dict[str, Any], said: str) -> None:
    async with Kernel() as kernel:
        with pytest.raises(ValueError, match=re.escape(said)):
            await kernel.create("FlexiSelect", **params)
        assert not kernel.components


@simulated
async def test_nothing_is_printed_and_verbosity_logs_selections(
    caplog: pytest.LogCaptureFixture, capsys: pytest.CaptureFixture[str]
) -> None:
    caplog.set_level("INFO")
    for verbosity in (0, 1):
        async with Rig(select(verbosity=verbosity)) as rig:
            rig.feed("selection", TimedShort(1, 1))
            await rig.tick()
        assert ("selected input1" in caplog.text) is bool(verbosity)
    assert capsys.readouterr().out == ""


@pytest.mark.slow
def test_it_keeps_what_components_promise() -> None:
    check_component(select, {"selection": [TimedShort(0, 0)], "input0": [TimedLong(0, 1)]}, deterministic=True)


@pytest.mark.parametrize("order", ["cycle", "tm"])
@simulated
async def test_a_bad_selection_loses_no_good_sample_of_its_cycle(order: str) -> None:
    async with Rig(select(order=order)) as rig:
        rig.feed("input1", TimedLong(1, 5))
        rig.feed("selection", TimedShort(0, 1))
        rig.feed("input1", TimedLong(2, 6))
        rig.feed("selection", TimedShort(3, 7))
        with rig.expect_error(SelectionError):
            await rig.tick()
        assert rig.values("output") == [5, 6]
