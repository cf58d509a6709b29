"""ls, cat and find show what runs; names mean one thing, or say what is wrong with them."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import re
import signal
import threading
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path

import pytest

from aiorts import Component, EventContext, Kernel, PeriodicContext, ThreadContext
from aiorts.cli.app import run_command
from aiorts.cli.commands.live.look.ls import ls
from aiorts.cli.commands.live.measure.readings import counters_in
from aiorts.cli.commands.live.measure.table import View, tables, text_of
from aiorts.cli.commands.live.target import complete, complete_changes
from aiorts.sessions import AsyncClient, Client
from aiorts.sessions.target import entry_named
from control_parts import WAIT, Counter, controlled, entry_of, running, with_client

pytestmark = pytest.mark.anyio
SYSTEM = Path(__file__).parents[2] / "examples" / "pid" / "system.toml"


async def said(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str]:
    """The status of a command and what it printed, while the kernel runs on."""
    status = await asyncio.to_thread(run_command, words)
    out, err = capsys.readouterr()
    return status, out + err


@asynccontextmanager
async def two() -> AsyncIterator[tuple[Kernel, Kernel]]:
    """Two kernels, unit and other; counter0 is in both, only1 in the second."""
    async with AsyncExitStack() as stack:
        unit = await stack.enter_async_context(controlled("unit"))
        other = await stack.enter_async_context(controlled("other"))
        await other.create(Counter, "only1")
        yield unit, other


async def test_the_part_of_a_component_is_that_of_the_whole_profile() -> None:
    async with controlled("part", rate=1.0) as kernel:
        part = await with_client("part", lambda client: client.call("part", components=["reader0"]))
        whole = kernel.profile().to_plain()
        assert part["components"] == {"reader0": whole["components"]["reader0"]}
        assert list(part["connectors"]) == ["counter0.out-reader0.in"]
        assert list(part["contexts"]) == ["loop"]
        assert part["service_connectors"] == {}


class Held(Component):
    """Its hook does not return before it is let go, whatever cancels it."""

    begun: threading.Event
    free: threading.Event

    def on_execute(self) -> None:
        self.begun.set()
        assert self.free.wait(30.0)


class Stubborn(Held):
    async def on_execute(self) -> None:
        self.begun.set()
        while not self.free.is_set():
            with contextlib.suppress(asyncio.CancelledError):
                await asyncio.sleep(0.05)


@pytest.mark.parametrize("kind", ["thread", "task"])
async def test_a_hook_over_its_deadline_is_told_with_the_state_wherever_that_is_shown(
    kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    late = r"active, on_execute for \d\.\d s \(deadline 0\.2 s\)"
    async with controlled() as kernel:
        free = threading.Event()
        try:
            for name, own, deadline in (("within0", "long", 60.0), ("held0", "own", 0.2)):
                held = await kernel.create(Held if kind == "thread" else Stubborn, name)
                held.begun, held.free = threading.Event(), free
                context = {"thread": ThreadContext, "task": PeriodicContext}[kind]
                await kernel.start(context(rate=100.0, name=own, deadline=deadline), held, activate=True)
                assert await asyncio.to_thread(held.begun.wait, WAIT)
            await asyncio.sleep(0.4)
            components = kernel.profile().components
            assert [name for name, one in components.items() if one.overdue] == ["held0"]
            found = components["held0"].overdue["own"]
            assert (found.hook, found.deadline_ns) == ("on_execute", 200_000_000)
            assert found.running_ns > 200_000_000
            _, text = await said(capsys, "ls", "-l", "unit/held0")
            assert re.search(late, text), text
            _, text = await said(capsys, "cat", "unit/held0")
            assert re.search(late.replace("active", "active in own"), text), text
            _, text = await said(capsys, "ls", "--json", "unit/held0")
            assert json.loads(text)["kernels"][0]["components"][0]["overdue"]["own"]["hook"] == "on_execute"
            counted = counters_in(await with_client("unit", lambda client: client.call("statistics")))
            (row,) = [line for line in text_of(tables(counted, None, {}), View()) if line.startswith("held0")]
            assert re.search(late, row), row
        finally:
            free.set()


@pytest.mark.row(121)
async def test_ls_shows_kernels_components_ports_and_what_globs_mean(capsys: pytest.CaptureFixture[str]) -> None:
    async with two():
        whole = "other/\n  counter0\n  reader0\n  only1\nunit/\n  counter0\n  reader0\n"
        assert await said(capsys, "ls") == (0, whole)
        assert await said(capsys, "ls", "unit") == (0, "unit/\n  counter0\n  reader0\n")
        assert await said(capsys, "ls", "unit/reader0") == (0, "unit/reader0\n  in  in  TimedDouble\n")
        assert await said(capsys, "ls", "only?.*") == (0, "other/only1.out  out TimedDouble\n")
        assert await said(capsys, "ls", "unit/loop") == (0, "unit/loop  context of counter0, reader0\n")
        status, text = await said(capsys, "ls", "-R", "-l", "unit/")
        assert (status, "counter0  active  loop\n    out  out  TimedDouble\n" in text) == (0, True)
        status, text = await said(capsys, "ls", "--json", "only1")
        (kernel,) = json.loads(text)["kernels"]
        (only1,) = kernel["components"]
        assert (kernel["name"], kernel["contexts"], only1["name"], only1["states"]) == ("other", [], "only1", {})
        assert [port["name"] for port in only1["ports"]] == ["out"]


async def test_cat_tells_of_each_kind_of_thing(capsys: pytest.CaptureFixture[str]) -> None:
    async with controlled() as kernel:
        await kernel.start(EventContext(name="events"), await kernel.create(Counter, "idle0"))
        wanted = {
            "counter0": ("Writes 1, 2, 3 ...", "active in loop", "step  1.0", "counter0.out -> reader0.in", "100 Hz"),
            "idle0": ("inactive in events", "not connected"),
            "counter0.out": ("out TimedDouble", "written"),
            "counter0.out-reader0.in": ("dropped", "subscription flush"),
            "loop": ("members  counter0, reader0", "overruns"),
            "unit": ("3: 2 active, 1 inactive", "SystemClock", "context loop"),
        }
        for word, texts in wanted.items():
            status, text = await said(capsys, "cat", "-l", word)
            assert (status, [one for one in texts if " ".join(one.split()) not in " ".join(text.split())]) == (0, [])
        status, text = await said(capsys, "cat", "--json", "counter0.out", "loop")
        port, context = json.loads(text)
        assert (port["kind"], port["name"], list(port["components"])) == ("port", "unit/counter0.out", ["counter0"])
        assert (context["kind"], list(context["contexts"]), context["components"]) == ("context", ["loop"], {})


async def test_cat_of_a_kernel_tells_who_looks_on(capsys: pytest.CaptureFixture[str]) -> None:
    def look_on(client: Client) -> tuple[int, str]:
        client.stream("tap", port="counter0.out")
        status = run_command(["cat", "unit/"])
        return status, capsys.readouterr().out

    async with controlled():
        status, text = await with_client("unit", look_on)
    assert (status, "reads  counter0.out  " in text) == (0, True)


@pytest.mark.parametrize(
    ("words", "lines"),
    [
        (["--type", "Counter"], ["other/counter0", "other/only1", "unit/counter0"]),
        (["--type", "*:Cou*", "--state", "active"], ["other/counter0", "unit/counter0"]),
        (["other", "--name", "o*"], ["other/only1"]),
        (["--port-type", "TimedDouble", "--name", "reader0"], ["other/reader0.in", "unit/reader0.in"]),
    ],
)
async def test_find_prints_the_names_of_what_fits(
    capsys: pytest.CaptureFixture[str], words: list[str], lines: list[str]
) -> None:
    async with two():
        assert await said(capsys, "find", *words) == (0, "".join(f"{line}\n" for line in lines))
        assert await said(capsys, "find", "--name", "nosuch") == (1, "")


@pytest.mark.fault("F19")
@pytest.mark.parametrize("command", ["cat", "ls", "activate", "conf"])
async def test_who_is_absent_is_told_with_who_is_near(capsys: pytest.CaptureFixture[str], command: str) -> None:
    async with controlled():
        status, text = await said(capsys, command, "unit/couter0")
        assert (status, text) == (
            6,
            "aiorts: E-ABSENT: unit/couter0: nothing that runs has this name; did you mean counter0?\n",
        )


async def test_a_kernel_is_meant_without_the_number_of_its_process_where_no_other_is(
    capsys: pytest.CaptureFixture[str],
) -> None:
    async with controlled(f"web-{os.getpid()}") as kernel:
        assert (await said(capsys, "conf", "web/counter0", "step=3"))[0] == 0
        assert kernel.components["counter0"].params["step"].value == 3.0
        status, text = await said(capsys, "ls", "-l", "web")
        assert (status, f"web-{os.getpid()}/" in text) == (0, True)
        assert entry_named("web").name == f"web-{os.getpid()}"
        async with controlled("web") as other:
            assert (await said(capsys, "conf", "web/counter0", "step=4"))[0] == 0
            assert [one.components["counter0"].params["step"].value for one in (kernel, other)] == [3.0, 4.0]


@pytest.mark.fault("F19")
async def test_an_ambiguous_name_is_told_with_the_candidates(capsys: pytest.CaptureFixture[str]) -> None:
    text = "aiorts: E-AMBIGUOUS: counter0: 2 have this name: other/counter0, unit/counter0; write one of these\n"
    async with two() as (unit, other):
        assert await said(capsys, "conf", "counter0", "step=3") == (6, text)
        assert [kernel.components["counter0"].params["step"].value for kernel in (unit, other)] == [1.0, 1.0]
        assert (await said(capsys, "conf", "only1", "step=3"))[0] == 0
        assert (await said(capsys, "conf", "unit/counter0", "step=3"))[0] == 0
        assert (await said(capsys, "conf", f"{other.address}/counter0", "step=4"))[0] == 0
        assert [kernel.components["counter0"].params["step"].value for kernel in (unit, other)] == [3.0, 4.0]


@pytest.mark.fault("F19")
@pytest.mark.parametrize(
    "words", [["deactivate", "counter0"], ["exit", "counter0"], ["cat", "loop"], ["ls", "counter0"]]
)
async def test_no_command_takes_several_for_one(capsys: pytest.CaptureFixture[str], words: list[str]) -> None:
    async with two() as kernels:
        status, text = await said(capsys, *words)
        assert (status, text.startswith(f"aiorts: E-AMBIGUOUS: {words[1]}: 2 have this name: other/")) == (6, True)
        assert [kernel.components["counter0"].states["loop"].value for kernel in kernels] == ["active", "active"]
        assert (await said(capsys, "deactivate", "*/counter0"))[0] == 0
        assert [kernel.components["counter0"].states["loop"].value for kernel in kernels] == ["inactive", "inactive"]


@pytest.mark.fault("F19")
async def test_who_may_only_look_is_denied(capsys: pytest.CaptureFixture[str]) -> None:
    async with controlled(mode="view"):
        assert (await said(capsys, "cat", "counter0"))[0] == 0
        status, text = await said(capsys, "deactivate", "counter0")
        assert (status, text.startswith("aiorts: E-DENIED: deactivate: needs the right 'operate'")) == (4, True)


@pytest.mark.slow(kept_by="test_who_may_only_look_is_denied")
@pytest.mark.fault("F19")
def test_a_stopped_kernel_gives_no_answer_and_delays_nobody_else(capsys: pytest.CaptureFixture[str]) -> None:
    with running("stopped", str(SYSTEM)) as process, running("alive", str(SYSTEM)):
        process.send_signal(signal.SIGSTOP)
        try:
            assert run_command(["ls"]) == 0
            assert f"stopped/  no answer (process {process.pid})" in capsys.readouterr().out
            assert run_command(["cat", "alive/pid0"]) == 0
            capsys.readouterr()
            assert run_command(["cat", "stopped/pid0"]) == 5
            assert capsys.readouterr().err == (
                "aiorts: E-NO-ANSWER: stopped/pid0: no answer from stopped; it is stopped, or busy\n"
            )
            assert run_command(["inspect", "stopped"]) == 5
            capsys.readouterr()
            assert run_command(["find", "--name", "pid0"]) == 5
            assert capsys.readouterr() == (
                "alive/pid0\n",
                "aiorts: E-NO-ANSWER: stopped: no answer; what is in it is not known\n",
            )
            assert offered("alive/pid0.") == ["alive/pid0.measured", "alive/pid0.command"]
        finally:
            os.kill(process.pid, signal.SIGCONT)


def offered(word: str) -> list[str]:
    return [one.value for one in complete(ls.make_context("ls", []), ls.params[0], word)]


async def test_names_ports_and_parameters_are_completed() -> None:
    def changes() -> list[str]:
        context = ls.make_context("ls", [])
        context.params["name"] = "only1"
        return [one.value for one in complete_changes(context, ls.params[0], "s")]

    async def asked(question: Callable[..., list[str]], *words: str) -> list[str]:
        for _ in range(50):  # a shell waits 50 ms: on a busy machine, or at the first question, nothing may come
            if found := await asyncio.to_thread(question, *words):
                return found
        return []

    async with two():
        assert await asked(offered, "o") == ["only1", "other/"]
        assert await asked(offered, "unit/") == ["unit/", "unit/counter0", "unit/reader0"]
        assert await asked(offered, "only1.") == ["only1.out"]
        assert await asyncio.to_thread(offered, "nosuch.") == []
        assert await asked(changes) == ["step="]


class Tripping(Component):
    """Fails in one cycle, whenever it is told to."""

    trips = True

    def on_execute(self) -> None:
        if self.trips:
            self.trips = False
            raise ValueError("tripped")


async def test_who_was_reset_after_an_error_is_shown_as_it_is_and_with_no_error(
    capsys: pytest.CaptureFixture[str],
) -> None:
    async with controlled() as kernel:
        one = await kernel.create(Tripping, "one")
        context = await kernel.start(PeriodicContext(rate=100.0, name="second"), one, activate=True)
        async with asyncio.timeout(WAIT):
            while one.state != "error":
                await asyncio.sleep(0.005)
        looks = (("ls", "-l", "one"), ("ls", "--json", "one"), ("cat", "one"), ("cat", "unit"))
        before = [(await said(capsys, *words))[1] for words in looks]
        assert "failed" in before[0]
        assert '"failed": true' in before[1]
        assert all("ValueError: tripped" in text for text in before[2:])
        assert kernel.profile().components["one"].last_error == "ValueError: tripped"
        assert await said(capsys, "reset", "one") == (0, "")
        after = [(await said(capsys, *words))[1] for words in looks]
        assert not [text for text in after if "tripped" in text or "failed" in text.replace('"failed": false', "")]
        assert "inactive" in after[0]
        assert isinstance(one.last_error, ValueError)  # for whoever looks into it in the program
        one.trips = True
        await context.activate(one)
        async with asyncio.timeout(WAIT):
            while one.state != "error":
                await asyncio.sleep(0.005)
        assert "failed" in (await said(capsys, "ls", "-l", "one"))[1]


async def test_what_is_named_twice_is_looked_at_once() -> None:
    """A viewer that named one thing 8,000 times held the loop, and filled the memory."""
    async with controlled("twice") as kernel, AsyncClient.connect(entry_of("twice"), right="view") as client:
        kernel.components["counter0"].log.warning("once")
        wire, at = "counter0.out-reader0.in", ["counter0"] * 8_000
        lines = client.stream("log", components=at, follow=False)
        await lines.open()
        assert [line["text"] for line in lines.began] == ["once"]
        assert len(await client.call("connectors", names=[wire] * 8_000)) == 1
        assert len(await client.call("connectors", at=at)) == 1
        once = await client.call("dump_configuration", components=["counter0"])
        assert await client.call("dump_configuration", components=at) == once
