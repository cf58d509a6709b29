"""Who may not bring code names files below the folder of the run alone, whatever way the path comes in."""

from __future__ import annotations

import asyncio
import dataclasses
import re
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from aiorts import Component, EventContext, Kernel, Param
from aiorts.control import Control, Right
from aiorts.control.operations import OPERATIONS
from aiorts.errors import ApplyError, ConfigurationError, DeclarationError, DeniedError
from aiorts.guide import pages
from aiorts.model.plain import plain
from aiorts.observe import system_profile
from aiorts.sessions import Client, answer_in, framed, frames
from aiorts.sessions.protocol import NEWEST, OLDEST
from aiorts.system import check
from aiorts_flexi.recordings.logger import FlexiLogger
from control import test_table
from control_parts import WAIT, controlled, entry_of
from file_parts import PLACES, SECRET, WAYS, Call, Keeper, made

pytestmark = pytest.mark.anyio


@asynccontextmanager
async def filing(home: Path, *, files: bool = True) -> AsyncIterator[Kernel]:
    """A kernel with a logger and a keeper, whose run names the folder `allowed`, or none."""
    allowed = made(home)
    table = {"name": "filing", **({"files": allowed} if files else {})}
    async with Kernel(services={"control": table}) as kernel:
        kernel.services[0].table = None  # as where the command line asked for the socket
        await kernel.create(FlexiLogger, "log", logfile=home / "own.mcap", inputs=("TimedDouble",))
        await kernel.add(Keeper("keeper"))
        yield kernel


async def asked(kernel: Kernel, right: Right, call: Call) -> str:
    """The code of what the kernel refuses the call with over a socket with this right; "" where it is done."""
    operation, arguments = call
    control = kernel.service(Control)
    request = {"id": 1, "op": operation, "epoch": control.hello["epoch"], "args": arguments}

    def ask() -> str:
        if right is Right.CODE:
            with Client.open(entry_of("filing"), timeout=WAIT) as client:
                sent = client._socket
                sent.sendall(framed(request))
                return answer(sent)
        with control.admit(right, "a test") as sent:
            sent.sendall(framed({"hello": {"oldest": OLDEST, "newest": NEWEST, "who": "it"}}) + framed(request))
            return answer(sent)

    def answer(sent: Any) -> str:
        buffer = bytearray()
        sent.settimeout(WAIT)
        while True:
            buffer += sent.recv(65_536)
            for frame in frames(buffer, 1 << 20):
                found = answer_in(frame)
                if "error" in found:
                    assert SECRET[:4] not in found["error"]["text"]
                    return str(found["error"]["code"])
                if "ok" in found:
                    return ""

    return await asyncio.to_thread(ask)


def told(kernel: Kernel, home: Path) -> set[str]:
    """What may not be as it was: files that a client named, and components of it."""
    log = kernel.components["log"]
    values = {str(one["logfile"]) for one in log.configuration.sets.values() if "logfile" in one}
    named = {"configured"} if values != {str(home / "own.mcap")} else set()
    written = {"written"} if (home / "secret.txt").read_text() != SECRET else set()
    return named | written | ({"created"} if "new" in kernel.components else set())


@pytest.mark.parametrize("files", [True, False], ids=["files", "no files"])
@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("way", WAYS)
async def test_who_operates_names_files_below_the_folder_of_the_run(
    way: str, place: str, files: bool, tmp_path: Path
) -> None:
    path, allowed = PLACES[place]
    async with filing(tmp_path, files=files) as kernel:
        code = await asked(kernel, Right.OPERATE, WAYS[way](str(tmp_path / path), tmp_path))
        if allowed and files:
            # A replay reads its file when it is configured, and there is none.
            assert code == ("E-CONFIG" if way == "create to replay" else "")
        else:
            # A plan is carried out step by step, and taken back whole where one is refused.
            assert code == (ApplyError.code if way.startswith(("apply", "change")) else DeniedError.code)
            assert told(kernel, tmp_path) == set()


@pytest.mark.parametrize("way", WAYS)
async def test_who_may_only_look_names_none_and_who_brings_code_names_any(way: str, tmp_path: Path) -> None:
    async with filing(tmp_path, files=False) as kernel:
        call = WAYS[way](str(tmp_path / "allowed-not" / "new.txt"), tmp_path)
        assert await asked(kernel, Right.VIEW, call) == DeniedError.code
        assert told(kernel, tmp_path) == set()
        assert await asked(kernel, Right.CODE, call) == ("E-CONFIG" if way == "create to replay" else "")


@pytest.mark.parametrize("path", ["secret.txt", "allowed/new.txt"])
async def test_a_path_from_the_current_folder_is_where_it_leads(
    path: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    async with filing(tmp_path) as kernel:
        code = await asked(kernel, Right.OPERATE, WAYS["configure"](path, tmp_path))
        assert code == ("" if path.startswith("allowed") else DeniedError.code)


async def test_a_file_that_is_written_by_default_is_named_by_who_creates_the_component(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    create = (
        "create",
        {"type": "FlexiLogger", "name": "new", "params": {"inputs": ["TimedDouble"], "existing": "overwrite"}},
    )
    async with filing(tmp_path) as kernel:
        assert await asked(kernel, Right.OPERATE, create) == DeniedError.code
        assert await asked(kernel, Right.CODE, create) == ""


class Reads(Component):
    """Reads a file of its own, or another; its hook configures it as it likes."""

    map = Param(Path("/etc/map"), file="read")
    note = Param("", file="write")
    other: Path | None = Param(None, type=Path | None)

    async def on_activated(self) -> None:
        await self.configure(map="/etc/its own", other="/etc/another of its own")


async def test_what_was_there_may_be_named_again_and_hooks_name_what_they_like(tmp_path: Path) -> None:
    async with filing(tmp_path) as kernel:
        reads = await kernel.add(Reads("reads"), other="/etc/of the file")
        await kernel.start(EventContext(name="loop"), reads)

        async def configured(**values: Any) -> str:
            return await asked(kernel, Right.OPERATE, ("configure", {"component": "reads", "values": {"": values}}))

        assert await configured(map="/etc/map", other="/etc/of the file") == ""
        assert await configured(other="none") == ""
        assert await configured(other="/etc/of the file") == DeniedError.code
        assert await configured(map="/etc/another") == DeniedError.code
        assert await configured(note="/etc/passwd") == DeniedError.code
        assert await configured(note=str(tmp_path / "allowed/note")) == ""
        assert await asked(kernel, Right.OPERATE, ("activate", {"component": "reads"})) == ""
        assert (reads.map, reads.other) == (Path("/etc/its own"), Path("/etc/another of its own"))


async def test_a_change_that_is_taken_back_has_the_files_that_were_there(tmp_path: Path) -> None:
    async with filing(tmp_path) as kernel:
        change = WAYS["change"](str(tmp_path / "allowed/new.txt"), tmp_path)
        assert await asked(kernel, Right.OPERATE, change) == ""  # the session ends, and does not decide
        async with asyncio.timeout(WAIT):
            while told(kernel, tmp_path):
                await asyncio.sleep(0.01)


async def test_the_first_bytes_of_a_file_are_in_no_message_of_a_kernel(tmp_path: Path) -> None:
    async with filing(tmp_path) as kernel:
        for text in ("rootx:0:0", '{"a": 1}\n{secret', "secret;text\n"):
            (tmp_path / "secret.txt").write_text(text)
            with pytest.raises(ConfigurationError) as refused:
                await kernel.create(FlexiLogger, "new", mode="replay", logfile=tmp_path / "secret.txt")
            said = "".join(str(one) for one in (refused.value, refused.value.__cause__))
            assert "rootx" not in said
            assert "secret;" not in said
            assert "{secret" not in said


@pytest.mark.slow(kept_by="test_who_operates_names_files_below_the_folder_of_the_run")
async def test_no_operation_opens_a_file_that_its_arguments_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each text of the arguments of each operation is the path of a file, or of code in it."""
    canary = tmp_path / "canary.py"
    canary.write_text("raise SystemExit\n")
    opened: list[str] = []
    watched = [True]

    def hook(event: str, args: tuple[Any, ...]) -> None:
        if watched and event == "open" and "canary" in str(args[0]):
            opened.append(str(args[0]))

    sys.addaudithook(hook)
    async with filing(tmp_path) as kernel:
        for text in (str(canary), f"{canary}:Canary", str(tmp_path)):
            monkeypatch.setitem(test_table.VALUES, str, text)
            for row in OPERATIONS.values():
                if row.name != "stop":
                    whole = {
                        one.name: test_table.given(kind)
                        for one in dataclasses.fields(row.arguments)
                        if (kind := test_table.hints(row.arguments)[one.name])
                    }
                    await asked(kernel, Right.OPERATE, (row.name, plain(whole)))
        watched.clear()
    assert opened == []


def test_the_guide_has_each_way_that_a_file_is_named() -> None:
    """The table's rows by operation, and whether `--files` binds them, are what the tests above show."""
    page = next(one for one in pages() if one.name == "secure-network")
    text = page.text.partition("## Files that clients name")[2].partition("\n## ")[0]
    rows = [re.findall(r"`(\w+)`", line.split("|")[1]) for line in text.splitlines() if line.startswith("| `")]
    shown = {name for row in rows for name in row}
    assert shown <= set(OPERATIONS)
    assert {way("", Path())[0] for way in WAYS.values()} <= shown
    brings_code = {name for name, row in OPERATIONS.items() if row.demands is not None or row.right is Right.CODE}
    assert brings_code - {"catalogue"} <= shown  # which demands the right to operate, for what is installed


def test_a_parameter_that_names_a_file_says_what_is_done_with_it(tmp_path: Path) -> None:
    with pytest.raises(DeclarationError, match="file='append': expected 'read' or 'write'"):
        type("Wrong", (Component,), {"path": Param(Path("a"), file="append")})  # type: ignore[arg-type]
    with pytest.raises(DeclarationError, match="file='read': needs a path or text, the type is float"):
        type("Wrong", (Component,), {"path": Param(1.0, file="read")})
    reads = Reads("reads")
    profile = reads.configuration.profile
    assert [one.file for one in profile.parameters] == ["read", "write", "write"]
    (tmp_path / "reads.py").write_text(
        "from pathlib import Path\nfrom aiorts import Component, Param\nclass Reads(Component):\n"
        '    said = Param(Path("a"), file="read")\n    unsaid = Param(Path("b"))\n'
    )
    (tmp_path / "system.toml").write_text(
        'schema = 1\n[components.reads]\ntype = "reads.py:Reads"\n[contexts.loop]\n'
        'kind = "event"\nmembers = ["reads"]\n'
    )
    found = [one for one in check(tmp_path / "system.toml") if one.code == "W-FILE"]
    assert [(one.severity, one.where) for one in found] == [("warning", "components.reads")]
    assert found[0].message.startswith("unsaid is a path, and its class does not say")


async def test_a_report_says_which_parameters_name_files() -> None:
    async with controlled() as kernel:
        await kernel.add(Reads("reads"))
        report = system_profile(kernel).components["reads"].params
        assert {name: one.file for name, one in report.items()} == {"map": "read", "note": "write", "other": "write"}


def test_a_folder_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"files: .*there is no such folder"):
        Kernel(services={"control": {"name": "it", "files": tmp_path / "none"}})
    with pytest.raises(ConfigurationError, match=r"files: '': there is no such folder"):
        Kernel(services={"control": {"name": "it", "files": ""}})
