"""Contexts, state machines, modes and code are changed from another terminal."""

from __future__ import annotations

import asyncio
import json
import os
import time
from pathlib import Path

import pytest

from aiorts import Kernel, PeriodicContext
from aiorts.statechart import Chart, On, State
from aiorts.statemachines import MultiModeComponent, StateMachineComponent
from control_parts import Reader, commanded, controlled, with_client

pytestmark = pytest.mark.anyio


@pytest.fixture
def anyio_backend() -> str:
    """One loop is enough: what a command does passes through the socket."""
    return "asyncio"


async def test_contexts_start_change_and_stop(capsys: pytest.CaptureFixture[str]) -> None:
    async with controlled() as kernel:
        assert await commanded(capsys, "ctx", "rate", "loop", "250") == (0, "")
        assert kernel.contexts["loop"].rate == 250.0
        assert await commanded(capsys, "ctx", "drop", "loop", "reader0") == (0, "")
        assert kernel.components["reader0"].contexts == ()
        words = ("ctx", "start", "slow", "reader0", "rate=16", "deadline=0.5", "--activate")
        assert await commanded(capsys, *words) == (0, "")
        assert (kernel.contexts["slow"].rate, kernel.contexts["slow"].deadline) == (16.0, 0.5)
        assert [state.value for state in kernel.components["reader0"].states.values()] == ["active"]
        status, text = await commanded(capsys, "ctx", "--json")
        assert (status, [one["members"] for one in json.loads(text)["kernels"][0]["contexts"]]) == (
            0,
            [["counter0"], ["reader0"]],
        )
        assert await commanded(capsys, "ctx", "stop", "slow") == (0, "")
        assert await commanded(capsys, "ctx", "add", "unit/loop", "reader0", "--activate") == (0, "")
        assert list(kernel.contexts) == ["loop"]
        assert kernel.contexts["loop"].profile.members == ("counter0", "reader0")


@pytest.mark.slow(kept_by="first")
@pytest.mark.parametrize(
    ("words", "status", "text"),
    [
        (["stop", "lop"], 6, "no context that runs has this name; there are unit/loop"),
        (["rate", "loop", "-1"], 2, "No such option"),
        (["rate", "loop", "0"], 2, "rate"),
        (["rate", "loop", "1e99"], 2, "rate"),
        (["add", "loop", "reader0"], 2, "is in loop already"),
        (["add", "loop", "reader9"], 6, "did you mean reader0?"),
        (["start", "other", "--kind", "perodic"], 6, "did you mean periodic?"),
        (["start", "other", "rat=1"], 2, "did you mean 'rate'?"),
        (["start", "other", "rate=fast"], 2, "rate: expected a number, got 'fast'"),
        (["start", "other", "counter0", "--kind", "thread"], 2, "a member of a thread context is in no other"),
    ],
)
async def test_wrong_contexts_are_refused(
    capsys: pytest.CaptureFixture[str], words: list[str], status: int, text: str
) -> None:
    async with controlled() as kernel:
        found, said = await commanded(capsys, "ctx", *words)
        assert (found, text in said) == (status, True), said
        assert list(kernel.contexts) == ["loop"]


class Door(StateMachineComponent):
    chart = Chart(
        State("closed", On("button", to="open"), initial=True),
        State("open", On("button", to="closed", action="note")),
    )
    noted: object = ""

    def note(self, data: object) -> None:
        self.noted = data


class Lamp(MultiModeComponent):
    modes = ("dark", "bright")


async def test_a_state_machine_is_shown_and_sent_events(capsys: pytest.CaptureFixture[str]) -> None:
    async with Kernel(services={"control": {"name": "house"}}) as kernel:
        door = await kernel.create(Door, "door0")
        status, text = await commanded(capsys, "fsm", "door0", "button")
        assert (status, "activate the component" in text) == (2, True)
        loop = await kernel.start(PeriodicContext(rate=200.0), door, activate=True)
        assert await commanded(capsys, "fsm", "door0", "button") == (0, "")
        assert await commanded(capsys, "fsm", "door0", "button", '{"by": 1}') == (0, "")
        ticks = loop.ticks
        while loop.ticks < ticks + 2:
            await kernel.sleep(0.005)
        assert (door.machine.configuration, dict(door.noted)) == (("closed",), {"by": 1})  # type: ignore[call-overload]
        status, text = await commanded(capsys, "fsm", "door0")
        assert (status, text.split()[:5]) == (0, ["house/door0", "states", "closed", "events", "button"])
        status, text = await commanded(capsys, "fsm", "door0", "buton")
        assert (status, "did you mean button?" in text) == (6, True)


async def test_the_chart_of_a_state_machine_can_be_drawn() -> None:
    async with Kernel(services={"control": {"name": "house"}}) as kernel:
        await kernel.create(Door, "door0")
        shown = await with_client("house", lambda client: client.call("machine", component="door0"))
        assert [(one["name"], one["inside"], one["initial"], one["ways"]) for one in shown["chart"]] == [
            ("closed", "", True, [["button", "open"]]),
            ("open", "", False, [["button / note", "closed"]]),
        ]


async def test_a_mode_is_changed(capsys: pytest.CaptureFixture[str]) -> None:
    async with Kernel(services={"control": {"name": "house"}}) as kernel:
        lamp = await kernel.create(Lamp, "lamp0")
        await kernel.create(Reader, "reader0")
        assert await commanded(capsys, "fsm", "lamp0", "--mode", "bright") == (0, "")
        assert lamp.mode == "bright"
        status, text = await commanded(capsys, "fsm", "lamp0")
        assert (status, "bright of dark, bright" in text) == (0, True)
        assert (await commanded(capsys, "fsm", "lamp0", "--mode", "off"))[0] == 6
        assert (await commanded(capsys, "fsm", "reader0"))[0] == 2


_CODE = """
from aiorts import Component, Param


class Source(Component):
    top: int = Param({top})
    text = {text!r}
"""


async def test_code_is_replaced_by_the_name_of_a_component_or_by_its_file(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    file = tmp_path / "source_of_control.py"
    file.write_text(_CODE.format(top=1, text="one"))
    async with Kernel(services={"control": {"name": "codes"}}) as kernel:
        await kernel.create(f"{file}:Source", "src", top=7)
        file.write_text(_CODE.format(top=2, text="two"))
        assert (await commanded(capsys, "reload", "src", "--cycles", "0"))[0] == 0
        assert getattr(kernel.components["src"], "text") == "two"  # noqa: B009 - of a class that mypy cannot know
        file.write_text(_CODE.format(top=2, text="three"))
        status, text = await commanded(capsys, "reload", f"{file}:Source", "--cycles", "0", "--json")
        assert (status, json.loads(text)["components"][0]["component"]) == (0, "src")
        source = kernel.components["src"]
        assert (getattr(source, "text"), source.configuration.values["top"]) == ("three", 7)  # noqa: B009
        status, text = await commanded(capsys, "reload", "nobody")
        assert (status, "E-ABSENT" in text) == (6, True)
        file.write_text("this is no Python")
        status, text = await commanded(capsys, "reload", "src")
        assert (status, "source_of_control.py" in text, "E-PLUGIN" in text) == (2, True, True)
        assert getattr(kernel.components["src"], "text") == "three"  # noqa: B009


async def test_a_component_whose_on_initialize_raises_is_not_created_and_the_command_has_failed(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    file = tmp_path / "raising_of_control.py"
    file.write_text(
        "from aiorts import Component\n\n\nclass Raising(Component):\n"
        "    def on_initialize(self):\n        raise ValueError('no arm is there')\n"
    )
    async with Kernel(services={"control": {"name": "raises"}}) as kernel:
        status, text = await commanded(capsys, "comp", "create", f"{file}:Raising", "arm")
        assert (status, "arm: on_initialize raised ValueError: no arm is there" in text) == (1, True), text
        assert "arm" not in kernel.components


_WRITING = """
from aiorts import Component, InPort, OutPort


class Source(Component):
    out = OutPort(float)

    def on_execute(self):
        for _ in range({count}):
            self.out.write_nowait(1.0)


class Sink(Component):
    into = InPort(float)

    def on_execute(self):
        self.into.drain()
"""


@pytest.mark.slow(kept_by="reload/test_health.py::test_new_code_that_does_worse_is_taken_back_with_the_figure")
async def test_code_that_does_worse_in_its_window_is_taken_back(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    file = tmp_path / "writing_source.py"
    file.write_text(_WRITING.format(count=1))
    async with Kernel(services={"control": {"name": "codes"}}) as kernel:
        source, sink = await kernel.create(f"{file}:Source", "src"), await kernel.create(f"{file}:Sink", "sink")
        await kernel.connect("src.out", "sink.into", length=1)
        await kernel.start(PeriodicContext(rate=500.0, name="loop"), source, sink, activate=True)
        file.write_text(_WRITING.format(count=4))
        status, text = await commanded(capsys, "reload", "src", "--window", "0.25")
        assert (status, "does worse: src.out-sink.into: " in text, "were dropped" in text) == (1, True, True)
        assert kernel.components["src"] is source


async def test_no_code_is_read_where_others_may_only_look(capsys: pytest.CaptureFixture[str]) -> None:
    async with controlled("looks", mode="view"):
        status, text = await commanded(capsys, "reload", "counter0")
        assert (status, "needs the right 'code'" in text) == (4, True)


async def test_a_kernel_within_another_program_says_at_once_whose_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    async with controlled() as kernel:
        began = time.monotonic()
        status, text = await commanded(capsys, "stop", "unit")
        assert (status, time.monotonic() - began < 5.0) == (2, True), text
        assert "E-STATE" in text
        assert f"process {os.getpid()} (" in text
        awaited = asyncio.ensure_future(kernel.wait_stop_requested())
        assert await awaited == 0  # the request of before is kept for a program that waits later
        assert kernel.request_stop()
