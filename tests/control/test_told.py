"""What commands say to who looks at what runs for the first time: names of another kind, patterns, events."""

from __future__ import annotations

import asyncio
import json

import pytest

from aiorts import EventContext
from control_parts import Counter, commanded, controlled

pytestmark = pytest.mark.anyio


@pytest.fixture
def anyio_backend() -> str:
    """One loop is enough: what a command does passes through the socket."""
    return "asyncio"


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["stop", "counter0"], "counter0: no kernel that runs has this name; it is a component of unit"),
        (["watch", "counter0"], "counter0: no kernel that runs has this name; it is a component of unit"),
        (["activate", "unit"], "unit: no component that runs has this name; it is a kernel: unit/"),
        (["conf", "unit"], "unit: no component that runs has this name; it is a kernel: unit/"),
        (["activate", "loop"], "loop: no component that runs has this name; it is a context of unit"),
        (["activate", "unit/loop"], "unit/loop: no component that runs has this name; it is a context of unit"),
    ],
)
async def test_a_name_of_another_kind_is_said_to_be_one(
    capsys: pytest.CaptureFixture[str], words: list[str], text: str
) -> None:
    async with controlled():
        assert await commanded(capsys, *words) == (6, f"aiorts: E-ABSENT: {text}\n")


async def test_where_nothing_runs_no_name_is_made_up(capsys: pytest.CaptureFixture[str]) -> None:
    status, text = await commanded(capsys, "stop")
    assert (status, text.startswith("aiorts: E-ABSENT: nothing runs that can be reached;")) == (6, True)


async def test_a_name_that_several_kernels_have_is_offered_once(capsys: pytest.CaptureFixture[str]) -> None:
    async with controlled("one"), controlled("two"):
        status, text = await commanded(capsys, "cat", "zzzzzz")
        assert (status, text.count("counter0")) == (6, 1)


async def test_a_pattern_means_those_to_which_the_command_applies(capsys: pytest.CaptureFixture[str]) -> None:
    async with controlled() as kernel:
        late = await kernel.create(Counter, "zlate0")
        await kernel.start(EventContext(name="events"), late)
        await kernel.create(Counter, "idle0")  # in no context
        assert await commanded(capsys, "activate", "unit/*") == (0, "")
        states = {name: {one.value for one in part.states.values()} for name, part in kernel.components.items()}
        assert states == {"counter0": {"active"}, "reader0": {"active"}, "zlate0": {"active"}, "idle0": set()}
        assert await commanded(capsys, "reset", "unit/*") == (0, "")
        assert await commanded(capsys, "deactivate", "unit/*") == (0, "")
        assert await commanded(capsys, "deactivate", "*") == (0, "")
        status, text = await commanded(capsys, "deactivate", "counter0")
        assert (status, "E-STATE" in text) == (2, True)


async def test_rates_of_a_port_of_two_kernels_are_told_with_the_candidates(capsys: pytest.CaptureFixture[str]) -> None:
    async with controlled("one"), controlled("two"):
        assert await commanded(capsys, "hz", "counter0.out") == (
            6,
            "aiorts: E-AMBIGUOUS: counter0.out: 2 have this name: one/counter0.out, two/counter0.out; "
            "write one of these\n",
        )


async def test_a_field_that_is_not_there_is_told_with_those_that_are(capsys: pytest.CaptureFixture[str]) -> None:
    async with controlled():
        status, text = await commanded(capsys, "print", "counter0.out.dat", "--count", "1")
        assert (status, text) == (2, "aiorts: E-RECORD: the samples have no 'dat'; there are tm, data\n")


async def test_an_event_has_its_own_fields_only(capsys: pytest.CaptureFixture[str]) -> None:
    async with controlled() as kernel:
        watching = asyncio.ensure_future(commanded(capsys, "watch", "--kind", "StateChanged", "--count", "1", "--json"))
        while not watching.done():
            await kernel.deactivate(kernel.components["counter0"])
            await asyncio.sleep(0.02)
            await kernel.activate(kernel.components["counter0"])
            await asyncio.sleep(0.02)
        status, text = await watching
        assert (status, sorted(json.loads(text)["event"])) == (0, ["component", "context", "new", "old"])


async def test_a_kind_of_event_that_is_none_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    async with controlled():
        status, text = await commanded(capsys, "watch", "--kind", "StateChange", "--for", "1")
        assert (status, "did you mean StateChanged?" in text) == (6, True)
        status, text = await commanded(capsys, "watch", "--kind", "HookBefore", "--for", "1")
        assert (status, text.startswith("aiorts: E-CONTROL: HookBefore: is sent only to")) == (2, True)
