"""Components for kernels in other processes, and those processes."""

from __future__ import annotations

import asyncio
import shutil
import subprocess
import textwrap
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import ExitStack, asynccontextmanager
from pathlib import Path
from typing import ClassVar

from anyio import fail_after, sleep

from aiorts import Component, InPort, OutPort, Param
from aiorts.errors import AiortsError
from aiorts.sessions import entries
from aiorts.types import TimedLong
from control_parts import running, with_client

WAIT = 20.0
GRIPPER = Path(__file__).with_name("remote_gripper.py")


class Local(Component):
    """A member that is here."""

    out = OutPort(TimedLong)
    inp = InPort(TimedLong, length=10_000)
    gain: int = Param(1)
    configurations: ClassVar[Mapping[str, Mapping[str, object]]] = {"large": {"gain": 1000}}


FILE = """
    schema = 1
    [links]
    [components.gripper]
    type = "gripper.py:Gripper"
    [components.finger]
    type = "gripper.py:Gripper"
    [contexts.loop]
    kind = "periodic"
    rate = 200.0
    activate = {activate}
    members = ["gripper", "finger"]
    [components.keeper]
    type = "gripper.py:Keeper"
    [contexts.keeping]
    kind = "periodic"
    rate = 10.0
    members = ["keeper"]
"""


@asynccontextmanager
async def left(
    tmp_path: Path, name: str = "left", *words: str, activate: bool = False
) -> AsyncIterator[subprocess.Popen[str]]:
    """A kernel with a gripper in a process of its own, from when its contexts run; it is killed at the end."""
    file = tmp_path / f"{name}.toml"
    shutil.copy(GRIPPER, tmp_path / "gripper.py")
    file.write_text(textwrap.dedent(FILE.format(activate=str(activate).lower())))
    with ExitStack() as stack:
        process = await asyncio.to_thread(stack.enter_context, running(name, str(file), *words))
        with fail_after(WAIT):
            while not await _has_begun(name):
                await sleep(0.02)
        yield process


async def _has_begun(name: str) -> bool:
    if not any(one.name == name for one in entries()):
        return False
    try:
        return bool((await with_client(name, lambda client: client.call("names")))["components"]["keeper"])
    except (AiortsError, LookupError):
        return False


async def until(holds: Callable[[], object], seconds: float = WAIT) -> None:
    with fail_after(seconds):
        while not holds():
            await sleep(0.005)
