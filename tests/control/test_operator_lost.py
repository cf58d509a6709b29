"""What components do when the link to who operates them is lost: clients in processes of their own are killed."""

from __future__ import annotations

import asyncio
import logging
import subprocess
import sys
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from aiorts import Component, Composite, Kernel, Param, PeriodicContext
from aiorts.errors import DeclarationError
from aiorts.planning import wanted_of
from aiorts.supervision import Supervision
from aiorts.system import build, check, load, wanted
from control_parts import WAIT, commanded

PROGRAM = Path(__file__).with_name("holding_program.py")
Hold = Callable[..., Awaitable["subprocess.Popen[str]"]]
ACTIVATE = ("activate=stops", "activate=fails", "activate=stays")


class Stays(Component):
    """Says nothing."""

    step = Param(1)


class Stops(Stays):
    """Is a drive."""

    on_link_lost = "deactivate"


class Fails(Stays):
    """Is one that somebody has to look after."""

    on_link_lost = "error"


class Slow(Stays):
    """Takes its time to become active."""

    begun = False

    async def on_activated(self) -> None:
        self.begun = True
        await asyncio.sleep(1.0)


class SlowStops(Slow):
    """Is a drive."""

    on_link_lost = "deactivate"


class SlowFails(Slow):
    """Is one that somebody has to look after."""

    on_link_lost = "error"


@asynccontextmanager
async def three() -> AsyncIterator[Kernel]:
    """The three in a kernel with a socket, inactive."""
    async with Kernel(services={"control": {"name": "unit"}}) as kernel:
        made = [await kernel.create(kind, kind.__name__.lower()) for kind in (Stops, Fails, Stays)]
        await kernel.start(PeriodicContext(rate=100.0, name="loop"), *made)
        yield kernel


@pytest.fixture
def hold() -> Iterator[Hold]:
    """What makes a client that has done these and holds its session; in a thread, since this process serves it."""
    made: list[subprocess.Popen[str]] = []

    def begin(*words: str) -> subprocess.Popen[str]:
        command = [sys.executable, str(PROGRAM), "unit", *words]
        made.append(client := subprocess.Popen(command, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE))
        assert client.stdout is not None
        assert client.stdout.readline() == "holds\n"
        return client

    yield lambda *words: asyncio.to_thread(begin, *words)
    for client in made:
        client.kill()
        client.communicate(timeout=WAIT)


def states(kernel: Kernel) -> list[str]:
    """Of stops, fails and stays."""
    return [kernel.components[name].states["loop"].value for name in ("stops", "fails", "stays")]


async def until(kernel: Kernel, expected: list[str]) -> None:
    """Wait for these states."""
    async with asyncio.timeout(WAIT):
        while states(kernel) != expected:
            await asyncio.sleep(0.01)


def said(caplog: pytest.LogCaptureFixture) -> list[str]:
    """What the log has on operators."""
    return [one.message for one in caplog.records if "the link to its operator is lost" in one.message]


@pytest.mark.slow(kept_by="first")
def test_each_does_what_it_says_when_the_client_is_killed(hold: Hold, caplog: pytest.LogCaptureFixture) -> None:
    async def main() -> None:
        async with three() as kernel:
            client = await hold(*ACTIVATE)
            assert states(kernel) == ["active", "active", "active"]
            client.kill()
            await until(kernel, ["inactive", "error", "active"])

    with caplog.at_level(logging.WARNING):
        asyncio.run(main())
    own = [text for text in said(caplog) if text.startswith(("stops: ", "fails: ", "stays: "))]
    assert [text.partition(":")[0] for text in own] == ["stops", "fails"]
    assert all("the operator [process" in text for text in own)


@pytest.mark.slow(kept_by="first")
def test_who_ends_in_order_is_not_lost(
    hold: Hold, caplog: pytest.LogCaptureFixture, capsys: pytest.CaptureFixture[str]
) -> None:
    async def main() -> None:
        async with three() as kernel:
            for name in ("stops", "fails", "stays"):
                assert (await commanded(capsys, "activate", name))[0] == 0
            client = await hold("configure=stops", "configure=fails")
            await asyncio.to_thread(client.communicate, "\n", WAIT)
            assert client.returncode == 0
            assert (await commanded(capsys, "ls"))[0] == 0  # whatever came before is dealt with by now
            assert states(kernel) == ["active", "active", "active"]

    with caplog.at_level(logging.WARNING):
        asyncio.run(main())
    assert said(caplog) == []


@pytest.mark.slow
def test_one_of_the_same_name_that_comes_later_has_no_operator(hold: Hold, caplog: pytest.LogCaptureFixture) -> None:
    async def main() -> None:
        async with three() as kernel:
            client = await hold(*ACTIVATE)
            await kernel.remove(kernel.components["stops"])
            await kernel.contexts["loop"].add(await kernel.create(Stops, "stops"))
            if kernel.components["stops"].states["loop"].value == "inactive":  # it joins as the others are
                await kernel.activate("stops")
            client.kill()
            await until(kernel, ["active", "error", "active"])

    with caplog.at_level(logging.WARNING):
        asyncio.run(main())
    assert not any(text.startswith("stops: ") for text in said(caplog))


@pytest.mark.slow(kept_by="first")
def test_the_operator_is_who_has_changed_it_last(hold: Hold) -> None:
    async def main() -> None:
        async with three() as kernel:
            first = await hold(*ACTIVATE)
            second = await hold("configure=stops")
            first.kill()
            await until(kernel, ["active", "error", "active"])
            second.kill()
            await until(kernel, ["inactive", "error", "active"])

    asyncio.run(main())


@pytest.mark.slow(kept_by="first")
@pytest.mark.parametrize(("kind", "after"), [(SlowStops, "inactive"), (SlowFails, "error"), (Slow, "active")])
def test_an_activation_that_is_under_way_when_the_client_is_killed(hold: Hold, kind: type[Slow], after: str) -> None:
    async def main() -> None:
        async with Kernel(services={"control": {"name": "unit"}}) as kernel:
            drive = await kernel.create(kind, "drive")
            await kernel.start(PeriodicContext(rate=100.0, name="loop"), drive)
            client = await hold("begin=drive")
            async with asyncio.timeout(WAIT):
                while not drive.begun:
                    await asyncio.sleep(0.01)
            client.kill()
            await asyncio.to_thread(client.wait, WAIT)
            await asyncio.sleep(1.5)  # longer than the activation takes
            async with asyncio.timeout(WAIT):
                while drive.states["loop"].value != after:
                    await asyncio.sleep(0.01)
            shown = kernel.profile().components["drive"].last_error or ""
            assert ("is lost" in shown) == (after == "error")  # it was activated after that, and yet it has failed

    asyncio.run(main())


@pytest.mark.slow(kept_by="first")
@pytest.mark.parametrize("own_schedule", [False, True])
def test_who_operates_a_composite_operates_its_members(hold: Hold, own_schedule: bool) -> None:
    async def main() -> None:
        async with Kernel(services={"control": {"name": "unit"}}) as kernel:
            hand = Composite("hand", Stops("stops"), Stays("stays"), own_schedule=own_schedule)
            arm = await kernel.add(Composite("arm", hand, *([] if own_schedule else [Fails("fails")]), errors="report"))
            await kernel.start(PeriodicContext(rate=100.0, name="loop"), hand if own_schedule else arm)
            client = await hold("activate=arm")
            client.kill()
            expected = {"stops": "inactive", "stays": "active", **({} if own_schedule else {"fails": "error"})}
            async with asyncio.timeout(WAIT):
                while {name: kernel.components[name].states["loop"].value for name in expected} != expected:
                    await asyncio.sleep(0.01)

    asyncio.run(main())


@pytest.mark.slow(kept_by="test_an_activation_that_is_under_way_when_the_client_is_killed")
def test_a_second_member_whose_turn_is_still_to_come_when_the_client_is_killed(hold: Hold) -> None:
    async def main() -> None:
        async with Kernel(services={"control": {"name": "unit"}}) as kernel:
            first, second = Slow("first"), SlowStops("second")
            hand = Composite("hand", first, second, own_schedule=True)  # its members change in one action
            await kernel.add(Composite("arm", hand))
            await kernel.start(PeriodicContext(rate=100.0, name="loop"), hand)
            client = await hold("begin=arm")
            async with asyncio.timeout(WAIT):
                while not first.begun:
                    await asyncio.sleep(0.01)
            client.kill()
            await asyncio.to_thread(client.wait, WAIT)
            await asyncio.sleep(2.5)  # longer than both activations take
            async with asyncio.timeout(WAIT):
                while second.states["loop"].value != "inactive":
                    await asyncio.sleep(0.01)

    asyncio.run(main())


@pytest.mark.slow(kept_by="test_who_operates_a_composite_operates_its_members")
def test_who_starts_a_context_with_members_operates_them(hold: Hold) -> None:
    async def main() -> None:
        async with Kernel(services={"control": {"name": "unit"}}) as kernel:
            stops = await kernel.create(Stops, "stops")
            client = await hold("start=stops")
            assert stops.states["loop"].value == "active"
            client.kill()
            async with asyncio.timeout(WAIT):
                while stops.states["loop"].value != "inactive":
                    await asyncio.sleep(0.01)

    asyncio.run(main())


def test_another_word_is_refused_when_the_class_is_made() -> None:
    with pytest.raises(
        DeclarationError, match=r"Odd.on_link_lost: expected 'continue', 'deactivate', 'error', got 'stop'"
    ):
        type("Odd", (Component,), {"on_link_lost": "stop"})


def test_check_shows_what_each_does(tmp_path: Path) -> None:
    (tmp_path / "drives.py").write_text(
        "from aiorts import Component\n\nclass Drive(Component):\n    on_link_lost = 'deactivate'\n\n"
        "class Plain(Component):\n    pass\n"
    )
    (tmp_path / "system.toml").write_text(
        'schema = 1\n[components.left]\ntype = "drives.py:Drive"\n[components.plain]\ntype = "drives.py:Plain"\n'
        '[contexts.loop]\nkind = "periodic"\nrate = 1.0\nmembers = ["left", "plain"]\n'
    )
    (found,) = check(tmp_path / "system.toml")
    assert (found.severity, found.code, found.line) == ("note", "N-OPERATOR", 2)
    assert found.message == "left is deactivated when the link to its operator is lost (Drive.on_link_lost)"


DRIVES = """
import asyncio

from aiorts import Component


class Drive(Component):
    on_link_lost = "deactivate"


class Plain(Component):
    pass


class Newer(Component):
    pass


class Late(Component):
    on_link_lost = "deactivate"
    begun = False

    async def on_activated(self):
        self.begun = True
        await asyncio.sleep(1.0)
"""


def a_file(folder: Path, name: str = "system", kind: str = "Plain", says: str = "error", of_drive: str = "") -> Path:
    """A system with a left drive, of which the file may say nothing, and a plain component, of which it says `says`."""
    (folder / "drives.py").write_text(DRIVES)
    (file := folder / f"{name}.toml").write_text(
        f'schema = 1\n[components.left]\ntype = "drives.py:Drive"\n{of_drive}'
        f'[components.plain]\ntype = "drives.py:{kind}"\non_link_lost = "{says}"\n'
        '[contexts.loop]\nkind = "periodic"\nrate = 100.0\nmembers = ["left", "plain"]\nactivate = false\n'
    )
    return file


def test_check_shows_what_the_file_says_of_it(tmp_path: Path) -> None:
    plain, left = check(a_file(tmp_path, of_drive='on_link_lost = "continue"\n'))[::-1]
    assert (left.severity, left.code, left.line) == ("note", "N-OPERATOR", 4)
    assert left.message == "left goes on when the link to its operator is lost (components.left.on_link_lost)"
    assert (plain.severity, plain.code, plain.line) == ("note", "N-OPERATOR", 7)
    assert plain.message == "plain goes to error when the link to its operator is lost (components.plain.on_link_lost)"


def test_check_refuses_another_word_and_names_the_near_one(tmp_path: Path) -> None:
    found = [one for one in check(a_file(tmp_path, says="deactivated")) if one.severity == "error"]
    assert [one.line for one in found] == [6]
    assert "unknown on_link_lost 'deactivated'; did you mean 'deactivate'?" in found[0].message


@pytest.mark.slow(kept_by="first")
def test_what_the_file_says_is_done_when_the_client_is_killed(hold: Hold, tmp_path: Path) -> None:
    async def main() -> None:
        async with Kernel(services={"control": {"name": "unit"}}) as kernel:
            await build(kernel, load(a_file(tmp_path, of_drive='on_link_lost = "continue"\n')))
            client = await hold("activate=left", "activate=plain")
            client.kill()
            async with asyncio.timeout(WAIT):
                while kernel.components["plain"].states["loop"].value != "error":
                    await asyncio.sleep(0.01)
            assert kernel.components["left"].states["loop"].value == "active"

    asyncio.run(main())


def test_what_the_file_says_is_saved_planned_and_changed(tmp_path: Path) -> None:
    async def main() -> None:
        async with Kernel() as kernel:
            await build(kernel, load(a_file(tmp_path)))
            assert (await kernel.apply(wanted(load(a_file(tmp_path))), dry_run=True)).plan.empty
            await kernel.save(tmp_path / "saved.toml")
            assert (tmp_path / "saved.toml").read_text().count("on_link_lost") == 1
            assert wanted(load(tmp_path / "saved.toml")) == wanted_of(kernel)
            changed = wanted(load(a_file(tmp_path, "next", says="deactivate")))
            (step,) = (await kernel.apply(changed)).plan.steps
            assert step.text == "supervise plain: on_link_lost error -> deactivate"
            assert wanted_of(kernel).components["plain"].on_link_lost == "deactivate"

    asyncio.run(main())


@pytest.mark.slow(kept_by="first")
def test_what_the_file_says_holds_for_newer_code_and_for_another_type(hold: Hold, tmp_path: Path) -> None:
    async def main() -> None:
        async with Kernel(services={"control": {"name": "unit"}}) as kernel:
            await build(kernel, load(a_file(tmp_path)))
            (tmp_path / "drives.py").write_text(f"{DRIVES}\n# newer\n")
            await kernel.reload("Plain")
            newer = wanted(load(a_file(tmp_path, "next", "Newer")))
            await kernel.apply(replace(newer, services=wanted_of(kernel).services))
            client = await hold("activate=plain")
            client.kill()
            async with asyncio.timeout(WAIT):
                while kernel.components["plain"].states["loop"].value != "error":
                    await asyncio.sleep(0.01)
            await kernel.remove(kernel.components["plain"])
            await kernel.create(Stays, "plain")
            assert wanted_of(kernel).components["plain"].on_link_lost == ""

    asyncio.run(main())


def test_what_the_file_says_holds_for_the_instance_that_a_restart_makes(tmp_path: Path) -> None:
    async def main() -> None:
        async with Kernel() as kernel:
            await build(kernel, load(a_file(tmp_path)))
            plain = kernel.components["plain"]
            kernel.supervise(plain, Supervision("restart", backoff=0.001))
            kernel.registry.task_failed(plain, "its task", ValueError("fails"))
            async with asyncio.timeout(WAIT):
                while kernel.components.get("plain") in (None, plain):
                    await asyncio.sleep(0.01)
            assert wanted_of(kernel).components["plain"].on_link_lost == "error"

    asyncio.run(main())


@pytest.mark.slow(kept_by="first")
def test_who_has_loaded_a_configuration_operates_what_is_in_it(hold: Hold, tmp_path: Path) -> None:
    async def main() -> None:
        async with three() as kernel:
            await kernel.contexts["loop"].activate(*kernel.components.values())
            (file := tmp_path / "robot.toml").write_text("schema = 1\n[components.stops.sets.default]\nstep = 3\n")
            client = await hold(f"load={file}")
            assert kernel.components["stops"].configuration.values["step"] == 3
            client.kill()
            await until(kernel, ["inactive", "active", "active"])

    asyncio.run(main())


def a_context(member: str, kind: str) -> str:
    """A component that the next system has, too, alone in an active context."""
    return (
        f'[components.{member}]\ntype = "drives.py:{kind}"\n'
        f'[contexts.own]\nkind = "periodic"\nrate = 100.0\nmembers = ["{member}"]\n'
    )


@asynccontextmanager
async def of_file(file: Path) -> AsyncIterator[Kernel]:
    """A kernel that has the system of a file, and of which a plan takes the socket not away."""
    async with Kernel(services={"control": {"name": "unit"}}) as kernel:
        kernel.services[0].table = None  # as where the command line asked for the socket
        await build(kernel, load(file))
        yield kernel


@pytest.mark.slow(kept_by="first")
@pytest.mark.parametrize("how", ["apply", "change"])
def test_who_has_had_a_plan_carried_out_operates_what_it_changed(hold: Hold, tmp_path: Path, how: str) -> None:
    async def main() -> None:
        running = a_file(tmp_path)
        running.write_text(running.read_text().replace("activate = false\n", ""))
        changed = a_file(tmp_path, "next")
        changed.write_text(running.read_text() + a_context("right", "Drive"))
        async with of_file(running) as kernel:
            client = await hold(f"{how}={changed}")
            assert kernel.components["right"].states["own"].value == "active"
            client.kill()
            async with asyncio.timeout(WAIT):
                while kernel.components["right"].states["own"].value != "inactive":
                    await asyncio.sleep(0.01)
            assert kernel.components["left"].states["loop"].value == "active"  # the plan did not touch it

    asyncio.run(main())


@pytest.mark.slow(kept_by="test_who_has_had_a_plan_carried_out_operates_what_it_changed")
def test_a_plan_that_is_carried_out_when_the_client_is_killed(hold: Hold, tmp_path: Path) -> None:
    async def main() -> None:
        running, changed = a_file(tmp_path), a_file(tmp_path, "next")
        changed.write_text(running.read_text() + a_context("late", "Late"))
        async with of_file(running) as kernel:
            client = await hold(f"begin_apply={changed}")
            async with asyncio.timeout(WAIT):
                while "late" not in kernel.components or not kernel.components["late"].begun:  # type: ignore[attr-defined]
                    await asyncio.sleep(0.01)
            client.kill()
            await asyncio.to_thread(client.wait, WAIT)
            await asyncio.sleep(1.5)  # longer than the plan takes
            async with asyncio.timeout(WAIT):
                while kernel.components["late"].states["own"].value != "inactive":
                    await asyncio.sleep(0.01)

    asyncio.run(main())
