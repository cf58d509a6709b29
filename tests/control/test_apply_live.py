"""`aiorts plan FILE --live` and `aiorts apply FILE --live`: the file and what runs are two views of one system."""

from __future__ import annotations

import asyncio
import json
import os
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from aiorts import Kernel
from aiorts.cli.app import run_command
from aiorts.errors import AiortsError, RecordError
from aiorts.model.wanted.carried import carried, received
from aiorts.sessions import Client
from aiorts.system import build, load, wanted
from control_parts import WAIT, with_client

pytestmark = pytest.mark.anyio
SYSTEM = """schema = 1
[components.const]
type = "FlexiConst"
params = { outputs = ["TimedDouble"], constants = ["1"] }
[components.dump]
type = "FlexiDump"
params.inputs = ["TimedDouble"]
[[connections]]
from = "const.output"
to = "dump.input0"
length = 3
[contexts.work]
kind = "event"
members = ["const", "dump"]
activate = false
"""
OTHER = (
    SYSTEM.replace("length = 3", "length = 5").replace('["const", "dump"]', '["const", "dump", "more"]')
    + """[components.more]
type = "FlexiDump"
params.inputs = ["TimedDouble"]
[[connections]]
from = "const.output"
to = "more.input0"
"""
)
STEPS = """+ create more (FlexiDump)
+ connect const.output -> more.input0
~ change const.output -> dump.input0: length 3 -> 5
~ move work: +more
"""


@asynccontextmanager
async def built(folder: Path) -> AsyncIterator[Kernel]:
    """A kernel of this process with a socket, of the system of `system.toml`; `other.toml` lies beside it."""
    (folder / "system.toml").write_text(SYSTEM)
    (folder / "other.toml").write_text(OTHER)
    async with Kernel(services={"control": {"name": "unit"}}) as kernel:
        kernel.services[0].table = None  # as where the command line asked for the socket
        await build(kernel, load(folder / "system.toml"))
        yield kernel


async def said(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, str, str]:
    """The status of a command and what it printed, while the kernel runs on."""
    status = await asyncio.to_thread(run_command, [str(word) for word in words])
    out, err = capsys.readouterr()
    return status, out, err


@pytest.mark.slow(kept_by="test_a_dry_run_says_all_and_does_nothing")
@pytest.mark.row(110)
async def test_what_runs_is_compared_with_a_file(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    system, other, saved = (tmp_path / f"{name}.toml" for name in ("system", "other", "saved"))
    async with built(tmp_path) as kernel:
        assert await said(capsys, "plan", system, "--live", "unit") == (0, "", "")
        assert (await said(capsys, "save", "unit", "-o", saved))[0] == 0
        assert await said(capsys, "plan", saved, "--live", "unit/") == (0, "", "")
        assert await said(capsys, "plan", other, "--live", "unit") == (1, STEPS, "")
        await kernel.disconnect(kernel.connectors["const.output-dump.input0"])
        drift = "+ connect const.output -> dump.input0 (length 3)\n"
        assert await said(capsys, "plan", system, "--live", "unit") == (1, drift, "")


@pytest.mark.row(112)
async def test_a_dry_run_says_all_and_does_nothing(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    async with built(tmp_path) as kernel:
        connectors = dict(kernel.connectors)
        assert await said(capsys, "apply", tmp_path / "other.toml", "--live", "unit", "--dry-run") == (1, STEPS, "")
        status, out, _ = await said(capsys, "apply", tmp_path / "other.toml", "--dry-run", "--json")
        assert (status, [one["step"] for one in json.loads(out)["steps"]]) == (
            1,
            ["Create", "Connect", "Change", "Move"],
        )
        assert list(kernel.components) == ["const", "dump"]
        assert kernel.connectors == connectors
        assert await said(capsys, "plan", tmp_path / "system.toml", "--live", "unit") == (0, "", "")


@pytest.mark.slow(kept_by="test_a_dry_run_says_all_and_does_nothing")
@pytest.mark.row(108, 109)
async def test_the_system_of_a_file_is_made_of_what_runs(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    system, other = tmp_path / "system.toml", tmp_path / "other.toml"
    async with built(tmp_path) as kernel:
        const = kernel.components["const"]
        assert await said(capsys, "apply", other, "--live", "unit") == (0, f"{STEPS}done\n", "")
        assert list(kernel.components) == ["const", "dump", "more"]
        assert kernel.components["const"] is const
        assert kernel.connectors["const.output-dump.input0"].profile.length == 5
        assert await said(capsys, "apply", other, "--window", "0.05") == (0, "no difference\n", "")
        await kernel.remove(kernel.components["dump"])
        status, out, _ = await said(capsys, "apply", system, "--json", "--window", "0.05")
        assert status == 0
        assert {key: value for key, value in json.loads(out).items() if key != "steps"} == {
            "refused": [],
            "done": True,
            "rolled_back": "",
            "notes": [],
        }
        assert await said(capsys, "plan", system, "--live", "unit") == (0, "", "")


@pytest.mark.row(108)
async def test_what_fails_leaves_all_as_it_was(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    (tmp_path / "broken.py").write_text(
        "from aiorts import Component\n\n\nclass Broken(Component):\n"
        "    async def on_initialize(self) -> None:\n        raise ValueError('no such device')\n"
    )
    file = tmp_path / "broken.toml"
    file.write_text(OTHER + '[components.broken]\ntype = "broken.py:Broken"\n')
    async with built(tmp_path) as kernel:
        connectors = dict(kernel.connectors)
        status, out, err = await said(capsys, "apply", file, "--live", "unit")
        assert (status, out) == (1, "")
        assert "E-APPLY" in err
        assert "no such device" in err
        assert "all of it was taken back" in err
        assert list(kernel.components) == ["const", "dump"]
        assert kernel.connectors == connectors
        assert await said(capsys, "plan", tmp_path / "system.toml", "--live", "unit") == (0, "", "")


@pytest.mark.slow(kept_by="test_a_dry_run_says_all_and_does_nothing")
@pytest.mark.row(108)
async def test_what_does_worse_is_taken_back_with_the_figure(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "late.py").write_text(
        "from aiorts import Component\n\n\nclass Late(Component):\n"
        "    async def on_execute(self) -> None:\n        raise ValueError('no such device')\n"
    )
    more = '[components.late]\ntype = "late.py:Late"\n[contexts.fast]\nkind = "periodic"\nrate = 100.0\n'
    (tmp_path / "late.toml").write_text(f'{OTHER}{more}members = ["late"]\n')
    async with built(tmp_path) as kernel:
        status, out, _ = await said(capsys, "apply", tmp_path / "late.toml", "--window", "0.2")
        assert status == 1
        assert "+ create late (late.py:Late)\n" in out
        assert out.splitlines()[-1].startswith("taken back: late")
        assert "no such device" in out
        assert list(kernel.components) == ["const", "dump"]
        assert await said(capsys, "plan", tmp_path / "system.toml", "--live", "unit") == (0, "", "")


@pytest.mark.slow(kept_by="test_a_dry_run_says_all_and_does_nothing")
async def test_what_cannot_be_done_is_refused_with_status_2(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    system = tmp_path / "system.toml"
    async with built(tmp_path):
        (tmp_path / "clock.toml").write_text(SYSTEM + '[clock]\nkind = "simulated"\n')
        why = "the clock of a system that runs cannot be changed"
        for words in (("plan", "--live", "unit"), ("apply",), ("apply", "--dry-run")):
            status, out, err = await said(capsys, words[0], tmp_path / "clock.toml", *words[1:])
            assert (status, out) == (2, "")
            assert why in err
        assert (await said(capsys, "plan", system))[0] == 2
        assert (await said(capsys, "plan", system, system, "--live", "unit"))[0] == 2
        assert (await said(capsys, "plan", system, "--live", "nobody"))[0] == 6
        system.write_text(SYSTEM.replace("FlexiDump", "FlexiDumb"))
        assert "FlexiDump" in (await said(capsys, "apply", system))[2]


async def test_a_file_of_another_system_is_refused_unless_forced(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    other = tmp_path / "another.toml"
    other.write_text(SYSTEM.replace("const", "first").replace("firstants", "constants").replace("dump", "last"))
    async with built(tmp_path) as kernel:
        status, out, err = await said(capsys, "apply", other, "--live", "unit")
        assert (status, out, list(kernel.components)) == (2, "", ["const", "dump"])
        assert f"has none of the components of unit (process {os.getpid()})" in err
        assert "remove all of them: dump, const; if it is meant for this kernel, give --force" in " ".join(err.split())
        assert (await said(capsys, "apply", f"unit={other}"))[0] == 2
        assert (await said(capsys, "apply", other, "--live", "unit", "--force"))[0] == 0
        assert list(kernel.components) == ["first", "last"]


@pytest.mark.parametrize("text", ["", "[", "[]", '{"components":1}', '{"contexts":[{"name":"a"}]}', "[" * 5000])
async def test_a_text_that_is_no_system_is_refused_with_its_code(text: str, tmp_path: Path) -> None:
    async with built(tmp_path) as kernel:

        def codes(client: Client) -> list[str]:
            found = []
            for operation in ("plan", "apply"):
                with pytest.raises(AiortsError) as caught:
                    client.call(operation, WAIT, wanted=(text,))
                found.append(caught.value.code)
            return found

        assert await with_client("unit", codes) == [RecordError.code] * 2
        assert list(kernel.components) == ["const", "dump"]


def test_a_system_is_read_as_it_was_sent(tmp_path: Path) -> None:
    text = (
        OTHER + '[components.const.sets.far]\nconstants = ["inf"]\n[components.const.supervision]\nrestart = "reset"\n'
    )
    (tmp_path / "system.toml").write_text(text + '[components.const.start]\nafter = ["dump active"]\n')
    made = wanted(load(tmp_path / "system.toml"))
    assert received(carried(made)) == made
