"""The folder of sockets: refused when it is not safe, held by one at a time, and nothing stale stays in it."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import fcntl
import os
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from aiorts import Kernel
from aiorts.errors import AbsentError, ControlError
from aiorts.sessions import Client, entries, folder
from control_parts import WAIT, controlled, entry_of, until, with_client

ROOT = Path(__file__).parents[2]


def make_link(place: Path) -> None:
    (place.parent / "elsewhere").mkdir(mode=0o700)
    place.symlink_to(place.parent / "elsewhere")


def make_open(place: Path) -> None:
    place.mkdir()
    place.chmod(0o755)


def make_foreign(place: Path) -> None:
    if os.geteuid() != 0:
        pytest.skip("needs root")
    place.mkdir(mode=0o700)
    os.chown(place, 65534, 65534)


def make_file(place: Path) -> None:
    place.write_text("", encoding="utf-8")


@pytest.mark.parametrize(
    ("make", "why"),
    [
        (make_link, "is a link"),
        (make_open, "lets others in"),
        (make_foreign, "belongs to another user"),
        (make_file, "is no folder"),
    ],
)
@pytest.mark.anyio
async def test_a_folder_that_is_not_safe_is_refused_by_all_and_the_run_goes_on(
    runtime: str, make: Callable[[Path], None], why: str, caplog: pytest.LogCaptureFixture
) -> None:
    make(Path(runtime, "aiorts"))
    with pytest.raises(ControlError, match=why):
        entries()
    async with controlled("unsafe") as kernel:
        assert kernel.address == ""
        assert kernel.state == "open"
    (line,) = [one for one in caplog.messages if "other terminals cannot look into this run" in one]
    assert why in line


@pytest.mark.parametrize(
    ("runtime_dir", "why"),
    [("missing", "cannot be made"), ("x" * 100, "longer than 107 bytes; set XDG_RUNTIME_DIR to a shorter path")],
)
@pytest.mark.anyio
async def test_where_there_can_be_no_socket_the_run_goes_on_with_one_warning(
    runtime: str,
    runtime_dir: str,
    why: str,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", f"{runtime}/{runtime_dir}")
    if runtime_dir != "missing":
        Path(runtime, runtime_dir).mkdir()
    async with controlled("nowhere") as kernel:
        assert kernel.address == ""
    (line,) = [one for one in caplog.messages if "other terminals cannot look into this run" in one]
    assert why in line


@pytest.mark.parametrize("given", [None, "", "relative/path"])
@pytest.mark.anyio
async def test_without_a_runtime_folder_it_is_in_the_temporary_folder(
    runtime: str, given: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(folder.tempfile, "gettempdir", lambda: runtime)
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    if given is not None:
        monkeypatch.setenv("XDG_RUNTIME_DIR", given)
    async with controlled("temporary"):
        assert Path(entry_of("temporary").path).parent == Path(runtime, f"aiorts-{os.geteuid()}")
        assert (await with_client("temporary", lambda client: client.call("names")))["state"] == "open"


@pytest.mark.parametrize("failing", ["write_text", "replace"])
@pytest.mark.anyio
async def test_a_full_disk_leaves_nothing_and_the_run_goes_on(
    runtime: str, failing: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def full(*_: Any, **__: Any) -> Any:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(*((Path, "write_text", full) if failing == "write_text" else (os, "replace", full)))
    async with controlled("full") as kernel:
        assert kernel.address == ""
        assert os.listdir(Path(runtime, "aiorts")) == []
    assert "No space left" in caplog.text


@pytest.mark.anyio
async def test_what_was_left_half_made_is_removed_by_the_next_reader(runtime: str) -> None:
    async with controlled("alive"):
        place = Path(runtime, "aiorts")
        before = set(os.listdir(place))
        with socket.socket(socket.AF_UNIX) as dead:
            dead.bind(str(place / "0000000000000001.sock"))
        (place / "0000000000000002.part").write_text("{", encoding="utf-8")
        (place / "0000000000000003.json").write_text("[]", encoding="utf-8")
        (place / "note.txt").write_text("of somebody", encoding="utf-8")
        assert [one.name for one in entries()] == ["alive"]
        assert set(os.listdir(place)) == before | {"note.txt"}


@pytest.mark.slow(kept_by="test_a_full_disk_leaves_nothing_and_the_run_goes_on")
@pytest.mark.anyio
async def test_who_holds_the_folder_for_long_keeps_others_from_no_run(
    runtime: str, caplog: pytest.LogCaptureFixture
) -> None:
    folder.private_folder()
    held = os.open(Path(runtime, "aiorts"), os.O_RDONLY)
    try:
        fcntl.flock(held, fcntl.LOCK_EX)
        async with controlled("stuck") as kernel:
            assert kernel.address == ""
            assert entries() == ()
    finally:
        os.close(held)
    assert "another process holds it; has one of yours been stopped?" in caplog.text


@pytest.mark.anyio
async def test_a_folder_that_is_deleted_harms_no_run(runtime: str) -> None:
    async with controlled("deleted") as kernel:
        entry = entry_of("deleted")
        with Client.open(entry, timeout=WAIT) as client:
            for one in Path(runtime, "aiorts").iterdir():
                one.unlink()
            Path(runtime, "aiorts").rmdir()
            assert (await asyncio.to_thread(client.call, "names"))["state"] == "open"
        assert entries() == ()
        with pytest.raises(AbsentError, match="is gone"):
            await asyncio.to_thread(Client.open, entry)
        assert kernel.state == "open"


@pytest.mark.slow(kept_by="control/test_socket.py::test_a_name_that_is_held_is_refused_with_its_holder")
@pytest.mark.fault("F15")
def test_of_two_that_begin_at_once_with_one_name_one_is_told_who_has_it() -> None:
    words = [sys.executable, "-m", "aiorts", "run", "--name", "both", str(ROOT / "examples/pid/system.toml")]
    both = [
        subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    try:
        until(lambda: any(one.poll() is not None for one in both), 60.0)
        (loser,) = [one for one in both if one.poll() is not None]
        (winner,) = [one for one in both if one is not loser]
        assert loser.wait() == 2
        assert loser.stderr is not None
        assert f"is held by process {winner.pid}" in loser.stderr.read()
        assert entry_of("both").pid == winner.pid
    finally:
        for one in both:
            one.kill()
            one.communicate(timeout=WAIT)


# -- other users, children, systems ------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.skipif(os.geteuid() != 0 or not hasattr(socket, "SO_PEERCRED"), reason="needs root, and Linux")
@pytest.mark.anyio
async def test_a_client_of_another_user_is_refused(caplog: pytest.LogCaptureFixture) -> None:
    async with controlled("foreign"):
        path = entry_of("foreign").path
        for one in (Path(path).parent.parent, Path(path).parent, Path(path)):
            one.chmod(0o777)  # as if the folder had let it in
        code = (
            "import os, socket, sys\nos.setuid(65534)\ns = socket.socket(socket.AF_UNIX)\ns.settimeout(20)\n"
            f"s.connect({path!r})\nprint(s.recv(100))"
        )
        words = [sys.executable, "-c", code]
        done = await asyncio.to_thread(subprocess.run, words, capture_output=True, text=True, timeout=WAIT, check=True)
    assert done.stdout == "b''\n"
    assert "a client of user 65534 was refused" in caplog.text


def sockets() -> int:
    """How many this process has open."""
    found = 0
    for one in os.listdir("/proc/self/fd"):
        with contextlib.suppress(OSError):
            found += os.readlink(f"/proc/self/fd/{one}").startswith("socket:")
    return found


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.anyio
async def test_a_forked_child_keeps_no_socket_open() -> None:
    async with controlled("forked"):
        client = await asyncio.to_thread(Client.open, entry_of("forked"))
        had = sockets()
        child = os.fork()
        if child == 0:
            os._exit(sockets())
        kept = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        assert kept == had - 4  # what listens, its end of the session, and the pair that wakes the thread
        assert (await asyncio.to_thread(client.call, "names"))["state"] == "open"
        client.close()


@pytest.mark.parametrize("missing", [(socket, "AF_UNIX"), (os, "geteuid")], ids=["AF_UNIX", "geteuid"])
@pytest.mark.anyio
async def test_a_system_without_such_sockets_runs_without_them(
    missing: tuple[Any, str], monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    kernel, named = Kernel(services={"control": {}}), Kernel(services={"control": {"name": "wanted"}})
    with monkeypatch.context() as patch:
        patch.setattr(folder, "is_supported", lambda: hasattr(*missing))
        patch.setattr("aiorts.control.server.service.is_supported", lambda: hasattr(*missing))
        patch.delattr(*missing)
        with pytest.raises(ControlError, match="no Unix sockets"):
            entries()
        async with kernel:
            assert kernel.address == ""
        assert caplog.messages == []
        async with named:
            assert kernel.address == ""
    assert "this system has no Unix sockets" in caplog.text


@pytest.mark.anyio
async def test_where_the_system_does_not_say_whose_a_client_is_the_folder_keeps_others_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delattr(socket, "SO_PEERCRED", raising=False)
    async with controlled("unsaid"):
        assert (await with_client("unsaid", lambda client: client.call("names")))["state"] == "open"
