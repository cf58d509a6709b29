"""`aiorts apply KERNEL=FILE KERNEL=FILE`: all of several kernels are changed, or none."""

from __future__ import annotations

import asyncio
import json
import signal
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from aiorts import Kernel
from aiorts.control import Control, Right
from aiorts.errors import DeniedError, StateError
from aiorts.model.wanted.carried import carried
from aiorts.sessions import Client, Outcome, Running, answer_in, change_all, framed, frames, kernels
from aiorts.sessions.protocol import NEWEST, OLDEST
from aiorts.system import build, load, wanted
from control.test_apply_live import OTHER, SYSTEM, said
from control_parts import WAIT, running

pytestmark = pytest.mark.anyio


@asynccontextmanager
async def two(folder: Path) -> AsyncIterator[tuple[Kernel, Kernel]]:
    """Two kernels of this process with sockets, of the same system."""
    (folder / "system.toml").write_text(SYSTEM)
    (folder / "other.toml").write_text(OTHER)
    async with AsyncExitStack() as stack:
        made = []
        for name in ("one", "two"):
            kernel = await stack.enter_async_context(Kernel(name, services={"control": {"name": name}}))
            kernel.services[0].table = None  # as where the command line asked for the socket
            await build(kernel, load(folder / "system.toml"))
            made.append(kernel)
        yield made[0], made[1]


def parts(file: Path) -> tuple[str, ...]:
    return (carried(wanted(load(file))),)


async def together(*asked: tuple[str, Path]) -> Outcome:
    """What becomes of changing these kernels, from a thread."""

    def work() -> Outcome:
        with kernels(WAIT) as found:
            return change_all([(found.kernel(name), parts(file)) for name, file in asked], WAIT)

    return await asyncio.to_thread(work)


@pytest.mark.slow
async def test_all_are_changed(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    async with two(tmp_path) as made:
        other = tmp_path / "other.toml"
        status, out, _ = await said(capsys, "apply", f"one={other}", f"two={other}")
        assert (status, out.splitlines()[-1]) == (0, "done")
        assert sum(line.startswith("two: + create more") for line in out.splitlines()) == 1
        assert [list(one.components) for one in made] == [["const", "dump", "more"]] * 2
        status, out, _ = await said(capsys, "apply", f"one={other}", f"two={other}", "--json")
        assert (status, json.loads(out)["kept"]) == (0, {"one": [], "two": []})


@pytest.mark.slow
async def test_none_is_changed_where_one_refuses_the_plan(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    async with two(tmp_path) as made:
        (tmp_path / "clock.toml").write_text(SYSTEM + '[clock]\nkind = "simulated"\n')
        words = [f"one={tmp_path / 'other.toml'}", f"two={tmp_path / 'clock.toml'}"]
        status, _, err = await said(capsys, "apply", *words)
        assert (status, "two: " in err) == (2, True)
        assert [list(one.components) for one in made] == [["const", "dump"]] * 2


def broken(folder: Path) -> Path:
    """A file of a system with a component that cannot be made."""
    (folder / "broken.py").write_text(
        "from aiorts import Component\n\n\nclass Broken(Component):\n"
        "    async def on_initialize(self) -> None:\n        raise ValueError('no such device')\n"
    )
    file = folder / "broken.toml"
    file.write_text(OTHER + '[components.broken]\ntype = "broken.py:Broken"\n')
    return file


async def test_what_was_changed_is_taken_back_where_a_step_fails_in_another(tmp_path: Path) -> None:
    async with two(tmp_path) as (one, other):
        dump, connectors = one.components["dump"], dict(one.connectors)
        outcome = await together(("one", tmp_path / "other.toml"), ("two", broken(tmp_path)))
        assert (outcome.failed, outcome.kept, outcome.unsure) == ("two", {}, ())
        assert outcome.text.startswith("taken back: two: ")
        assert "no such device" in outcome.text
        for kernel in (one, other):
            assert list(kernel.components) == ["const", "dump"]
        assert one.components["dump"] is dump
        assert one.connectors == connectors


@pytest.mark.slow
async def test_a_kernel_whose_coordinator_is_gone_takes_its_change_back(tmp_path: Path) -> None:
    async with two(tmp_path) as (one, _):
        made = parts(tmp_path / "other.toml")

        def change() -> list[Any]:
            with kernels(WAIT) as found:
                return list(found.kernel("one").client.call("change", WAIT, wanted=made)["steps"])

        assert len(await asyncio.to_thread(change)) == 4
        async with asyncio.timeout(WAIT):
            while list(one.components) != ["const", "dump"]:
                await asyncio.sleep(0.01)
        outcome = await together(("one", tmp_path / "other.toml"))  # it may be changed again
        assert (outcome.text, list(one.components)) == ("done", ["const", "dump", "more"])


async def test_nothing_is_decided_where_nothing_is_changed(tmp_path: Path) -> None:
    async with two(tmp_path):

        def decide() -> None:
            with kernels(WAIT) as found:
                found.kernel("one").client.call("decide", WAIT, keep=True)

        with pytest.raises(StateError, match="nothing is changed in this session"):
            await asyncio.to_thread(decide)


LASTING = SYSTEM.replace('kind = "event"', 'kind = "periodic"\nrate = 10.0').replace("activate = false\n", "")
MORE = OTHER.replace('kind = "event"', 'kind = "periodic"\nrate = 10.0').replace("activate = false\n", "")


@pytest.mark.slow(kept_by="test_what_was_changed_is_taken_back_where_a_step_fails_in_another")
@pytest.mark.parametrize("when", ["before it is changed", "before all are told to keep it"])
def test_a_kernel_that_is_killed_is_named_with_what_was_kept(when: str, tmp_path: Path) -> None:
    system, other = tmp_path / "system.toml", tmp_path / "other.toml"
    system.write_text(LASTING)
    other.write_text(MORE)
    with running("one", str(system)), running("two", str(system)) as killed, kernels(WAIT) as found:
        pairs = [(found.kernel(name), parts(other)) for name in ("one", "two")]

        class Killing(Client):
            """The session with the one that is killed."""

            def call(self, operation: str, wait: float | None = WAIT, /, **arguments: object) -> Any:
                if operation == ("change" if when == "before it is changed" else "decide"):
                    killed.send_signal(signal.SIGKILL)
                    killed.wait(WAIT)
                return super().call(operation, wait, **arguments)

        with Killing.open(pairs[1][0].client.entry) as last:
            outcome = change_all([pairs[0], (Running(last, pairs[1][0].names), pairs[1][1])], WAIT)
        assert (outcome.failed, outcome.unsure) == ("two", ("two",))
        names = list(pairs[0][0].client.call("names", WAIT)["components"])
        if when == "before it is changed":
            assert (outcome.text.startswith("taken back: two: "), names) == (True, ["const", "dump"])
        else:
            assert outcome.text.startswith("partly applied: kept in one (4 steps); two: ")
            assert names == ["const", "dump", "more"]


@pytest.mark.parametrize("strange", ["broken.py:Broken", "os.path:Broken", "evil:run"])
async def test_who_may_only_operate_brings_no_code(strange: str, tmp_path: Path) -> None:
    async with two(tmp_path) as (one, _):
        control, given = one.service(Control), json.loads(parts(tmp_path / "system.toml")[0])
        if strange == "evil:run":
            given["connections"][0]["options"]["convert"] = strange
        else:
            given["components"].append({"name": "more", "type": strange})
        call = {"id": 1, "op": "apply", "epoch": control.hello["epoch"], "args": {"wanted": [json.dumps(given)]}}

        def ask() -> list[Any]:
            buffer, came = bytearray(), []  # type: tuple[bytearray, list[Any]]
            with control.admit(Right.OPERATE, "a test") as connected:
                connected.settimeout(WAIT)
                connected.sendall(framed({"hello": {"oldest": OLDEST, "newest": NEWEST, "who": "it"}}) + framed(call))
                while len(came) < 2:
                    buffer += connected.recv(65_536)
                    came += [answer_in(frame) for frame in frames(buffer, 1 << 20)]
            return came

        came = await asyncio.to_thread(ask)
        assert came[1]["error"]["code"] == DeniedError.code
        assert strange in came[1]["error"]["text"]
        assert list(one.components) == ["const", "dump"]
