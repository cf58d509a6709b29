"""Runs a generated system and ends it, in one of several ways; what is wrong then."""

from __future__ import annotations

import asyncio
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any, Final

from aiorts import Kernel
from aiorts.links import Links
from aiorts.system import build, ended_in_error, parse
from aiorts.testing import MemoryNetwork, simulate
from endings.generated import PARTS, System, faults

LONGEST: Final = 60.0
"""Seconds that a run, or its end, may take on a machine that others use, too."""
NOT_ALL_WELL: Final = ("E-", "W-", "Traceback", "Error", "failed")


def books_of(folder: Path) -> dict[str, Any]:
    """What components have written, by name."""
    found = {path.stem: path for path in folder.glob("*.json")}
    found |= {f"peer/{path.stem}" if path.stem == "keeper" else path.stem: path for path in folder.glob("peer/*.json")}
    return {name: json.loads(path.read_text()) for name, path in found.items()}


def _prepared(folder: Path) -> Path:
    (folder / "peer").mkdir(parents=True)
    shutil.copy(PARTS, folder)
    return folder


# -- in this process ---------------------------------------------------------------------------------------------------


async def _session(system: System, folder: Path, network: MemoryNetwork | None) -> list[str]:
    """Build it, leave its kernel at its moment, then that of its peer."""
    name, said = system.name_of_peer(), list[str]()
    async with AsyncExitStack() as stack:
        if system.peer:
            peer = await stack.enter_async_context(Kernel(name))
            if network is not None:
                peer.service(Links).use(network.transport(name))
                await peer.service(Links).opened()
            text = system.text(folder / "peer", of_peer=True, links=network is None)
            await build(peer, parse(text, folder / "peer.toml"))
        async with Kernel("main") as kernel:
            if network is not None:
                kernel.service(Links).use(network.transport("main"))
            await build(kernel, parse(system.text(folder), folder / "main.toml"))
            await kernel.sleep(system.moment)
            for _ in range(system.turns):
                await asyncio.sleep(0)
        said += [f"{name}: in error: {error}" for name, error in ended_in_error(kernel).items()]
    return said


def left_by_with(system: System, folder: Path, *, simulated: bool) -> list[str]:
    """End it by leaving `async with Kernel()`; what is wrong then."""
    _prepared(folder)
    if simulated:
        said = simulate(_session(system, folder, MemoryNetwork(seed=system.seed)), seed=system.seed)
    else:
        said = asyncio.run(_session(system, folder, None))
    return said + faults(system, books_of(folder))
