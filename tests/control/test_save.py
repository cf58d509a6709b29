"""`aiorts save`: what runs becomes a system file, over the socket, and tools are no part of it."""

from __future__ import annotations

import asyncio
import json
import os
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from aiorts import EventContext, Kernel
from aiorts.cli.app import run_command
from aiorts.sessions import Client
from aiorts.system import check
from control_parts import WAIT, Counter, commanded, with_client

pytestmark = pytest.mark.anyio
SYSTEM = """schema = 1

[components.const]
type = "FlexiConst"
params.outputs = ["TimedDouble"]
params.constants = ["1"]

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


@asynccontextmanager
async def saveable(name: str = "unit", count: int = 1) -> AsyncIterator[Kernel]:
    """A kernel of this process with a socket, of components that plugins offer."""
    async with Kernel(services={"control": {"name": name}}) as kernel:
        kernel.services[0].table = None  # as where the command line asked for the socket
        work = EventContext(name="work")
        const = await kernel.create("FlexiConst", "const", outputs=["TimedDouble"], constants=["1"])
        dump = await kernel.create("FlexiDump", "dump", inputs=["TimedDouble"])
        await kernel.connect("const.output", "dump.input0", length=3)
        await kernel.start(work, const, dump)
        for number in range(1, count):
            await kernel.create("FlexiDump", f"dump{number}", inputs=["TimedDouble"])
            await kernel.connect("const.output", f"dump{number}.input0")
            await kernel.connect("const.output", f"dump{number}.input0", allow_duplicate=True, subscription="new")
        yield kernel


async def said(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    """The status of a command and what it printed, while the kernel runs on."""
    status = await asyncio.to_thread(run_command, words)
    out, err = capsys.readouterr()
    return status, out, err


async def test_what_runs_is_printed_or_written(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    file = tmp_path / "saved.toml"
    async with saveable():
        assert await said(capsys, "save") == (0, SYSTEM, "")
        assert await said(capsys, "save", "unit", "-o", str(file)) == (0, "", "")
        assert file.read_text() == SYSTEM
        assert [one for one in check(file) if one.severity == "error"] == []
        status, out, err = await said(capsys, "save", "unit", "-o", str(file))
        assert (status, out) == (2, "")
        assert "saved.toml: is there already; --force overwrites it" in err
        file.write_text("mine")
        assert (await said(capsys, "save", "unit/", "-o", str(file), "--force"))[0] == 0
        assert file.read_text() == SYSTEM
        status, out, _ = await said(capsys, "save", "--json")
        assert (status, json.loads(out)) == (0, {"text": SYSTEM, "notes": []})
        assert (await said(capsys, "save", "nobody"))[0] == 6


async def test_what_a_file_cannot_say_is_told_and_writes_none(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    async with saveable() as kernel:
        await kernel.activate(kernel.components["dump"])
        status, out, err = await said(capsys, "save")
        assert (status, out) == (0, SYSTEM.replace("activate = false\n", ""))
        assert err == "not in the file: work: const: not active, and active in the saved system with the others\n"
        await kernel.create(Counter, "counter")
        status, out, err = await said(capsys, "save", "-o", str(tmp_path / "saved.toml"))
        assert (status, out) == (2, "")
        assert "E-SYSTEM: counter: Counter is in" in err
        assert list(tmp_path.iterdir()) == []


async def test_connectors_of_tools_are_not_in_it() -> None:
    async with saveable():

        def use(client: Client) -> Any:
            client.stream("tap", port="const.output")
            return client.call("save", WAIT, folder="/")["text"]

        assert await with_client("unit", use) == SYSTEM


@pytest.mark.slow(kept_by="test_what_runs_is_printed_or_written")
async def test_a_thousand_components_and_two_thousand_connectors_are_saved() -> None:
    async with saveable(count=1000):
        text = (await with_client("unit", lambda client: client.call("save", WAIT, folder="/")))["text"]
    assert text.count("[components.") == 1001
    assert text.count("[[connections]]") == 1999
    assert text.count("allow_duplicate = true") == 999


_PLACE = """
from aiorts import Component, Param


class Place(Component):
    note = Param("", file="write")
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="file names that are no UTF-8")
async def test_paths_that_are_no_utf_8_are_shown_set_and_saved_or_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / os.fsdecode(b"r\xc3\xc4\xff")
    folder.mkdir()
    (folder / "place.py").write_text(_PLACE)
    note = str(folder / os.fsdecode(b"n\xfe"))
    async with Kernel(services={"control": {"name": "bytes"}}) as kernel:
        kernel.services[0].table = None
        place = await kernel.create(f"{folder / 'place.py'}:Place", "place")
        status, text = await commanded(capsys, "save", "-o", str(folder / "out.toml"))
        assert (status, text) == (0, "")
        saved = (folder / "out.toml").read_text("utf-8")
        assert 'type = "place.py:Place"' in saved
        status, text = await commanded(capsys, "save", "-o", str(tmp_path / "out.toml"))
        assert (status, "is no UTF-8, which TOML is" in text, len(text.splitlines())) == (2, True, 1), text
        assert "place.type: cannot be saved: 'r\\udcc3\\udcc4\\udcff/place.py:Place'" in text
        assert await commanded(capsys, "conf", "place", f"note={note}") == (0, "")
        assert place.configuration.values["note"] == note
        for words in (("cat", "place", "-l", "--json"), ("conf", "place", "--json")):
            status, text = await commanded(capsys, *words)
            assert (status, text.isascii(), json.dumps(note) in text) == (0, True, True), text
        status, text = await commanded(capsys, "save", "-o", str(folder / "other.toml"))
        assert (status, "place.params.note: cannot be saved: " in text) == (2, True), text
        assert sorted(path.name for path in folder.glob("*.toml")) == ["out.toml"]
