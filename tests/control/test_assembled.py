"""Whether a system is assembled, and the name of a kernel that lasts: what a client that draws it has to know."""

from __future__ import annotations

import asyncio
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from aiorts import Kernel, PeriodicContext
from aiorts.events import Change, ProfileSnapshot
from aiorts.observe import SystemProfile, profile_from_plain
from aiorts.sessions import Client, Entry, entries
from aiorts.system import build, load
from control_parts import WAIT, controlled, entry_of, until, with_client

SLOW = """
import asyncio
from pathlib import Path
from aiorts import Component

class Slow(Component):
    async def on_initialize(self):
        while not Path(__file__).with_name("go").exists():
            await asyncio.sleep(0.01)
"""
SYSTEM = """
schema = 1
[components.one]
type = "slow_part.py:Slow"
[components.two]
type = "slow_part.py:Slow"
[contexts.loop]
kind = "periodic"
rate = 100.0
members = ["one", "two"]
"""


@pytest.mark.anyio
async def test_the_profile_and_a_change_say_when_all_of_a_system_file_is_there(tmp_path: Path) -> None:
    (tmp_path / "slow_part.py").write_text(SLOW)
    (tmp_path / "system.toml").write_text(SYSTEM)
    async with Kernel(services={"control": {"name": "built"}}) as kernel:
        assert kernel.profile().assembled is None
        building = asyncio.ensure_future(build(kernel, load(tmp_path / "system.toml")))
        with await asyncio.to_thread(lambda: Client.open(entry_of("built"), timeout=WAIT)) as client:
            while kernel.registry.assembled is None:
                await kernel.sleep(0.01)
            assert (await asyncio.to_thread(client.call, "names"))["assembled"] is False
            stream = await asyncio.to_thread(client.stream, "changes")
            profile = profile_from_plain(ProfileSnapshot, stream.began).apply()
            assert profile.assembled is False
            (tmp_path / "go").touch()
            kinds = []
            while not profile.assembled:
                change = profile_from_plain(Change, await asyncio.to_thread(stream.next, WAIT))
                kinds.append(change.kind)
                profile = change.apply(profile)
            assert kinds[-1] == "Assembled"
            assert set(profile.components) == {"one", "two"}
            assert {*profile.components["two"].states.values()} == {"active"}
            assert (await asyncio.to_thread(client.call, "names"))["assembled"] is True
        await building
        assert profile.structure() == profile_from_plain(SystemProfile, kernel.profile().to_plain()).structure()


@pytest.mark.anyio
async def test_the_profile_and_a_change_say_that_a_kernel_closes_before_anything_goes() -> None:
    async with Kernel() as kernel:
        await kernel.start(PeriodicContext(rate=100.0, name="loop"))
        seen = kernel.changes()
        profile = (await anext(seen)).apply()
    kinds, states = [], []
    async for change in seen:
        profile = change.apply(profile)
        kinds.append(change.kind)
        states.append(profile.state)
    first = kinds.index("Closing")
    assert states == ["open"] * first + ["closing"] * (len(kinds) - first)
    assert kinds.index("ContextStopped") > first


@pytest.mark.slow
@pytest.mark.parametrize("named", [False, True])
def test_a_kernel_is_known_again_after_a_restart(tmp_path: Path, named: bool) -> None:
    (tmp_path / "slow_part.py").write_text(SLOW)
    (tmp_path / "go").touch()
    (tmp_path / "system.toml").write_text(SYSTEM)
    seen: list[tuple[str, str, Any]] = []
    for _ in range(2):
        words = ["--name", "robot"] if named else []
        with started(tmp_path / "system.toml", *words) as entry, Client.open(entry, timeout=WAIT) as client:
            names, profile = client.call("names", WAIT), client.call("profile", WAIT)
            assert names["lasting"] == profile["lasting"] == client.hello["lasting"]
            seen.append((entry.address, client.hello["lasting"], client.hello["epoch"]))
    (address, lasting, epoch), (other, again, later) = seen
    assert lasting == again
    assert epoch != later
    if named:
        assert lasting == address == other
    else:
        assert address != other
        assert lasting == f"{address.partition('/')[0]}/{tmp_path.name}:{tmp_path / 'system.toml'}"


@contextmanager
def started(file: Path, *words: str) -> Iterator[Entry]:
    """`aiorts run FILE` in a process of its own, by its entry; it is killed at the end."""
    process = subprocess.Popen([sys.executable, "-m", "aiorts", "run", str(file), *words], stdout=subprocess.DEVNULL)
    try:
        yield until(lambda: next((one for one in entries() if one.pid == process.pid), None))
    finally:
        process.kill()
        process.wait(WAIT)


@pytest.mark.anyio
async def test_a_program_that_makes_its_components_itself_does_not_say() -> None:
    async with controlled("programmed"):
        found: dict[str, Any] = await with_client("programmed", lambda client: client.call("profile", WAIT))
    assert found["assembled"] is None
