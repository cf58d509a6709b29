"""What the paper built of these components, in virtual time: constants as controllers, and what arrives."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from aiorts import Component, EventContext, InPort, Kernel
from aiorts.testing import simulated
from aiorts.types import TimedFloatSeq, TimedLong, TimedVelocity2D, Velocity2D

if TYPE_CHECKING:
    from collections.abc import Sequence

S = 1_000_000_000


async def build(kernel: Kernel, parts: dict[str, tuple[str, dict[str, Any]]], wires: Sequence[tuple[str, str]]) -> None:
    """Components by name, connected without loss, the readers first, all active in one event context."""
    made = [await kernel.create(kind, name, **params) for name, (kind, params) in parts.items()]
    for one, other in wires:
        out, in_ = kernel.find(one), kernel.find(other)
        await kernel.connect(out, in_, length=1_000)  # type: ignore[arg-type]
    await kernel.start(EventContext(), *reversed(made), activate=True)


async def taker(kernel: Kernel, cls: type[Any]) -> InPort[Any]:
    """An in-port of a component of our own: "user.taker"."""
    return (await kernel.create(Component, "user")).add_port("taker", InPort(cls))


@simulated
async def test_three_controllers_become_one_vector() -> None:
    async with Kernel() as kernel:
        port = await taker(kernel, TimedFloatSeq)
        consts = {
            axis: ("FlexiConst", {"outputs": ["TimedFloat"], "constants": [value], "rate": 10.0})
            for axis, value in (("x", "1.5"), ("y", "-2"), ("z", "0"))
        }
        join = {"inputs": ["TimedFloat"] * 3, "outputs": ["TimedFloatSeq:3"], "map": "0>0:0,1>0:1,2>0:2"}
        wires = [(f"{axis}.output", f"join.input{number}") for number, axis in enumerate("xyz")]
        await build(kernel, {**consts, "join": ("FlexiFilter", join)}, [*wires, ("join.output0", "user.taker")])
        await kernel.sleep(0.95)
        last = port.drain()[-1]
    assert last == TimedFloatSeq(last.tm, [1.5, -2.0, 0.0])
    assert last.tm % (S // 10) == 0


@simulated
async def test_metres_become_millimetres() -> None:
    async with Kernel() as kernel:
        port = await taker(kernel, TimedLong)
        const = {"outputs": ["TimedFloat"], "constants": ["1.001"], "count": 3}
        scale = {"inputs": ["TimedFloat"], "outputs": ["TimedLong"], "map": "0>1000>0"}
        await build(
            kernel,
            {"metres": ("FlexiConst", const), "scale": ("FlexiFilter", scale)},
            [("metres.output", "scale.input0"), ("scale.output0", "user.taker")],
        )
        await kernel.sleep(5.0)
        samples = port.drain()
    assert [sample.data for sample in samples] == [1001] * 3
    assert [sample.tm - samples[0].tm for sample in samples] == [0, S, 2 * S]


@simulated
async def test_two_schemas_are_summed_and_one_may_be_selected() -> None:
    async with Kernel() as kernel:
        port = await taker(kernel, TimedVelocity2D)
        forward = {"outputs": ["TimedVelocity2D"], "constants": ['{"vx": 0.5}'], "rate": 10.0}
        avoid = {"outputs": ["TimedVelocity2D"], "constants": ['{"vx": -0.25, "va": 1}'], "rate": 10.0}
        parts = {
            "forward": ("FlexiConst", forward),
            "avoid": ("FlexiConst", avoid),
            "both": ("FlexiAdd", {"port": "TimedVelocity2D:2", "wait": "all"}),
            "twice": ("FlexiDupe", {"inputs": ["TimedVelocity2D:2"]}),
            "which": ("FlexiConst", {"outputs": ["TimedBoolean"], "constants": ["True"], "count": 1}),
            "select": ("FlexiSelect", {"port": "TimedVelocity2D:2", "selection_type": "TimedBoolean"}),
        }
        wires = [
            *(("forward.output", "twice.input0"), ("twice.output0_0", "both.input0"), ("avoid.output", "both.input1")),
            *(("twice.output0_1", "select.input0"), ("both.output", "select.input1")),
            *(("which.output", "select.selection"), ("select.output", "user.taker")),
        ]
        await build(kernel, parts, wires)
        await kernel.sleep(0.95)
        samples = port.drain()
    assert len(samples) >= 9
    assert {sample.data for sample in samples[1:]} == {Velocity2D(0.25, 0.0, 1.0)}


@simulated
async def test_the_pipe_of_three_prints_five_lines(capsys: pytest.CaptureFixture[str]) -> None:
    const = {"outputs": ["TimedDouble"], "constants": ["6.2"], "rate": 50.0, "count": 5}
    scale = {"inputs": ["TimedDouble"], "outputs": ["TimedLong"], "map": "0>1000>0"}
    for form in ("text", "values"):
        async with Kernel() as kernel:
            await build(
                kernel,
                {
                    "const": ("FlexiConst", const),
                    "scale": ("FlexiFilter", scale),
                    "dump": ("FlexiDump", {"inputs": ["TimedLong"], "format": form}),
                },
                [("const.output", "scale.input0"), ("scale.output0", "dump.input0")],
            )
            await kernel.sleep(1.0)
        lines = capsys.readouterr().out.splitlines()
        assert len(lines) == 5
        assert all(line.endswith(": 6200") if form == "text" else line == "6200" for line in lines)
