"""What commands say to who looks at what runs for the first time: names of another kind, patterns, events."""

from __future__ import annotations

import ast
import asyncio
import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from aiorts import EventContext, Kernel
from aiorts.cli.commands import live
from aiorts.control.operation import Right
from aiorts.control.operations import OPERATIONS
from aiorts.errors import NoAnswerError
from aiorts.sessions import Client, Entry, Kernels, Running, Silent
from aiorts.sessions.folder import Claim
from control_parts import WAIT, Counter, commanded, controlled

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


async def test_where_nothing_runs_it_is_said_how_a_program_is_found(capsys: pytest.CaptureFixture[str]) -> None:
    status, text = await commanded(capsys, "ls")
    way = "Kernel(services={'control': {}})"
    assert (status, text) == (0, f"nothing runs that can be reached; aiorts run can, and a program with {way}\n")
    async with Kernel("mine", services={"control": {}}):
        assert (await commanded(capsys, "ls"))[1].startswith("mine-")


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


@pytest.mark.slow
async def test_a_field_that_is_not_there_is_told_with_those_that_are(capsys: pytest.CaptureFixture[str]) -> None:
    async with controlled():
        status, text = await commanded(capsys, "print", "counter0.out.dat", "--count", "1")
        assert (status, text) == (2, "aiorts: E-RECORD: the samples have no 'dat'; there are tm, data\n")


@pytest.mark.slow
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


# -- kernels that do not answer ----------------------------------------------------------------------------------------


def some(*, changing: bool, silent: tuple[str, ...] = ("mute",)) -> Kernels:
    """The kernel "unit" with pid0 and loop, and others that do not answer."""

    def entry(name: str) -> Entry:
        return Entry(f"host/{name}", 1, "0" * 16, "")

    names = {"components": {"pid0": {}}, "contexts": {"loop": ["pid0"]}, "connectors": {"wire": ["a.x", "b.y"]}}
    client: Any = SimpleNamespace(entry=entry("unit"))
    return Kernels([Running(client, names)], [Silent(entry(one), "no answer") for one in silent], changing=changing)


@pytest.mark.parametrize("word", ["pid0", "pid0.out", "*", "pid?", "*/pid0"])
def test_what_changes_takes_no_name_that_a_silent_kernel_may_have(word: str) -> None:
    assert some(changing=False).all(word)[0].component == "pid0"
    name = word.rpartition("/")[2]
    text = f"{word}: in unit; no answer from mute, which may have this name, too; write unit/{name}"
    with pytest.raises(NoAnswerError, match=re.escape(text)):
        some(changing=True).all(word)
    for exact in (f"unit/{name}", f"host/unit/{name}"):
        assert some(changing=True).all(exact)[0].component == "pid0"
    assert some(changing=True, silent=()).all(word)[0].component == "pid0"


@pytest.mark.parametrize(("kind", "word"), [("contexts", "loop"), ("connectors", "wire")])
def test_neither_does_it_take_a_context_or_connector(kind: str, word: str) -> None:
    assert len(some(changing=False).having(kind, word)) == 1
    with pytest.raises(NoAnswerError, match=f"{word}: in unit; no answer from mute, .*; write unit/{word}"):
        some(changing=True).having(kind, word)
    assert len(some(changing=True).having(kind, f"unit/{word}")) == 1


def test_without_a_name_what_changes_takes_no_kernel_beside_a_silent_one() -> None:
    assert some(changing=False).kernel().name == "unit"
    assert some(changing=True).kernel("unit").name == "unit"
    with pytest.raises(NoAnswerError, match="no kernel is named: unit runs, and there is no answer from mute"):
        some(changing=True).kernel()


@pytest.mark.parametrize("word", ["mute", "mute/", "mute/pid0", "host/mute/pid0"])
def test_a_silent_kernel_that_is_named_is_said_not_to_answer(word: str) -> None:
    with pytest.raises(NoAnswerError, match=f"^{word}: no answer from mute; it is stopped, or busy$"):
        some(changing=False).all(word)


@pytest.mark.slow
def test_each_command_with_an_operation_that_changes_something_asks_for_sure_names() -> None:
    changing = {row.name for row in OPERATIONS.values() if row.right is not Right.VIEW}
    careless = {}
    for path in sorted(Path(live.__file__).parent.rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        calls = (node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Call))
        words = {one.value for call in calls for one in call.args if isinstance(one, ast.Constant)}
        if (called := words & changing) and "changing=" not in text:
            careless[path.stem] = called
    assert careless == {"rates": {"measure"}}  # it ends with the command, and is said


@pytest.mark.slow(kept_by="test_what_changes_takes_no_name_that_a_silent_kernel_may_have")
async def test_commands_beside_a_kernel_that_does_not_answer(capsys: pytest.CaptureFixture[str]) -> None:
    async with controlled() as kernel:
        claim = Claim("host/mute", "0" * 16)  # it listens, and says nothing
        try:
            for words in (
                ["deactivate", "counter0"],
                ["exit", "counter0"],
                ["conf", "counter0", "step=2"],
                ["con", "counter0.out", "reader0.in"],
                ["dis", "counter0.out-reader0.in"],
                ["inject", "reader0.in", "1"],
                ["ctx", "stop", "loop"],
                ["vlog", "counter0", "--set", "debug"],
                ["reload", "counter0"],
                ["stop"],
            ):
                status, text = await commanded(capsys, *words)
                assert (words, status, "no answer from mute" in text) == (words, 5, True)
            assert kernel.components["counter0"].states["loop"].value == "active"
            assert len(kernel.connectors) == 1
            for words in (["con"], ["ctx"]):
                status, text = await commanded(capsys, *words)
                assert (status, "mute/  no answer" in text) == (0, True)
            assert (await commanded(capsys, "conf", "counter0"))[0] == 0
            assert await commanded(capsys, "deactivate", "unit/counter0") == (0, "")
        finally:
            claim.withdraw()
            claim.listener.close()


# -- one form of names, statuses, options and documents ----------------------------------------------------------------


async def test_a_kernel_is_named_with_or_without_a_slash(capsys: pytest.CaptureFixture[str]) -> None:
    async with controlled():
        for words in (["vlog"], ["con"], ["conf", "--dump", "-"], ["cat"], ["ls"]):
            plain, slash = [await commanded(capsys, *words, word) for word in ("unit", "unit/")]
            assert (words, plain[0], slash[0]) == (words, 0, 0)
            assert plain[1].partition("\n")[0] == slash[1].partition("\n")[0] or words == ["vlog"]


@pytest.mark.parametrize(
    "words",
    [
        ["conf", "unit/"],
        ["activate", "unit/"],
        ["fsm", "unit"],
        ["call", "unit/"],
        ["call", "counter0.out"],
        ["con", "counter0", "reader0.in"],
        ["print", "unit/"],
        ["vlog", "counter0.out"],
        ["check", "counter0"],
    ],
)
async def test_a_thing_of_the_wrong_kind_is_absent(capsys: pytest.CaptureFixture[str], words: list[str]) -> None:
    async with controlled():
        status, text = await commanded(capsys, *words)
        assert (status, text.startswith("aiorts: E-ABSENT: ")) == (6, True)


async def test_hints_are_names_of_the_kernel_that_is_meant(capsys: pytest.CaptureFixture[str]) -> None:
    async with controlled("one") as one, controlled("two"):
        await one.create(Counter, "only1")
        assert "did you mean" not in (await commanded(capsys, "cat", "two/only0"))[1]
        assert "there are counter0, reader0\n" in (await commanded(capsys, "cat", "two/zzzz"))[1]
        assert "there are one, two\n" in (await commanded(capsys, "cat", "zzzz/only1"))[1]
        status, text = await commanded(capsys, "reload", "nosuch")
        assert (status, "nosuch: no component has this name; for a type say which kernel" in text) == (6, True)


async def test_members_are_of_the_kernel_of_the_context(capsys: pytest.CaptureFixture[str]) -> None:
    async with controlled("one") as one, controlled("two"):
        status, text = await commanded(capsys, "ctx", "drop", "one/loop", "two/counter0")
        assert (status, "two/counter0: is of another kernel than one" in text) == (6, True)
        assert one.contexts["loop"].profile.members == ("counter0", "reader0")


@pytest.mark.parametrize(
    "words",
    [
        ["watch", "unit", "--kind", "HookFailed"],
        ["vlog", "-f"],
        ["print", "counter0.out"],
        ["hz", "counter0.out", "--interval", "0.01"],
        ["top", "--interval", "0.05"],
    ],
)
@pytest.mark.parametrize(("more", "wanted"), [((), 0), (("--count", "100000"), 6)])
async def test_a_kernel_that_ends_ends_what_follows_it(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    words: list[str],
    more: tuple[str, ...],
    wanted: int,
) -> None:
    answers: list[Any] = []
    result = Client._next

    def note(*given: Any) -> Any:
        answers.append(result(*given))
        return answers[-1]

    monkeypatch.setattr(Client, "_next", note)
    async with controlled():
        following = asyncio.ensure_future(commanded(capsys, *words, *more))
        async with asyncio.timeout(WAIT):
            while len(answers) < 2:  # names, and the first of what is followed
                await asyncio.sleep(0.005)
    status, text = await following
    assert (status, "unit: has ended" in text) == (wanted, True)


async def test_a_state_that_is_none_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    async with controlled():
        status, text = await commanded(capsys, "find", "--state", "wrong")
        assert (status, "'inactive', 'active', 'error', 'failed'" in text) == (2, True)
        assert await commanded(capsys, "find", "--state", "ACTIVE") == (0, "unit/counter0\nunit/reader0\n")


@pytest.mark.parametrize(
    ("words", "names"),
    [
        (["deactivate", "counter0", "reader0"], ["unit/counter0", "unit/reader0"]),
        (["exit", "reader0"], ["unit/reader0"]),
        (["dis", "counter0.out"], ["unit/counter0.out-reader0.in"]),
        (["ctx", "rate", "loop", "50"], ["unit/loop"]),
        (["vlog", "counter0", "--set", "info"], ["unit/counter0"]),
    ],
)
async def test_what_was_done_is_a_document(
    capsys: pytest.CaptureFixture[str], words: list[str], names: list[str]
) -> None:
    async with controlled():
        status, text = await commanded(capsys, *words, "--json")
        assert (status, json.loads(text)) == (0, {"done": [{"name": name} for name in names]})


async def test_lists_of_kernels_are_documents_of_one_form(capsys: pytest.CaptureFixture[str]) -> None:
    async with controlled():
        for command, kind in (("ls", "components"), ("con", "connectors"), ("ctx", "contexts")):
            document = json.loads((await commanded(capsys, command, "--json"))[1])
            (kernel,) = document["kernels"]
            assert (command, kernel["name"], document["no_answer"]) == (command, "unit", [])
            assert all(isinstance(one["name"], str) for one in kernel[kind])
        shown = json.loads((await commanded(capsys, "conf", "counter0", "step=3", "--json"))[1])
        assert [one["value"] for one in shown["parameters"]] == [3.0]
