"""Runs a generated system and ends it, in one of several ways; what is wrong then."""

from __future__ import annotations

import asyncio
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import AsyncExitStack, ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final

from aiorts import Kernel
from aiorts.links import Links
from aiorts.system import build, ended_in_error, parse
from aiorts.testing import MemoryNetwork, simulate
from endings.generated import PARTS, System, faults
from run_parts import limited

LONGEST: Final = 60.0
"""Seconds that a run, or its end, may take on a machine that others use, too."""
LONG: Final = 0.1
"""Seconds in which a system has read something."""


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
    books = books_of(folder)
    if system.moment > LONG and not any(book["counts"].get("read") for book in books.values()):
        said.append("nothing was read")
    return said + faults(system, books)


# -- in processes of their own -----------------------------------------------------------------------------------------


@contextmanager
def _run(folder: Path, file: str, environment: dict[str, str], *options: str) -> Iterator[subprocess.Popen[str]]:
    """A run of this system file; it is over when the block is."""
    said = folder / f"{file}.err"
    with said.open("w") as stream:
        process = subprocess.Popen(
            [sys.executable, "-m", "aiorts", "run", file, *options],
            cwd=folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=stream,
            text=True,
        )
        try:
            with limited(process, seconds=LONGEST):
                yield process
        finally:
            process.communicate(timeout=LONGEST)


def _is_ready(process: subprocess.Popen[str]) -> bool:
    assert process.stdout is not None
    return process.stdout.readline() == "ready\n"


def ended_by(way: str, system: System, folder: Path, *, simulated: bool) -> list[str]:
    """Run it with `aiorts run` and end it in this way: "for", "stop" or "term"; what is wrong then.

    Where time is simulated all of it is in one kernel: time stands still as long as another process may send something.
    """
    if simulated:
        system = replace(system, peer=set())
    _prepared(folder)
    (folder / "main.toml").write_text(system.text(folder))
    (folder / "peer.toml").write_text(system.text(folder / "peer", of_peer=True))
    found = list[str]()
    # What is counted begins with the first context: some of them end before everything has started.
    seconds = 0.001 + system.moment + 0.4 * (system.seed % 4)
    options = ["--for", f"{seconds:.4f}"] if way == "for" else []
    options += ["--simulate"] if simulated else []
    with ExitStack() as stack:
        runtime = stack.enter_context(tempfile.TemporaryDirectory(prefix="end"))  # short: sockets lie in it
        environment = os.environ | {"XDG_RUNTIME_DIR": runtime, "AIORTS_PLUGINS": ""}
        if system.peer:
            peer = stack.enter_context(_run(folder, "peer.toml", environment))
            if not _is_ready(peer):
                found.append("peer: was not ready")
        with _run(folder, "main.toml", environment, "--name", "main", *options) as process:
            if not _is_ready(process) and way != "for":
                found.append("was not ready")
            if way != "for":
                time.sleep(system.moment)
            if way == "term":
                process.send_signal(signal.SIGTERM)
            if way == "stop":
                command = [sys.executable, "-m", "aiorts", "stop", "main", "--timeout", "20"]
                stop = subprocess.run(
                    command, env=environment, capture_output=True, text=True, timeout=LONGEST, check=False
                )
                if stop.returncode or stop.stderr:
                    found.append(f"stop: status {stop.returncode}: {stop.stderr}")
            process.wait(LONGEST)
        found += _of_end("main.toml", folder, process.returncode, STATUS[way])
        if system.peer:
            peer.send_signal(signal.SIGTERM)
            peer.wait(LONGEST)
            found += _of_end("peer.toml", folder, peer.returncode, STATUS["term"])
    return found + faults(system, books_of(folder))


def _of_end(file: str, folder: Path, status: int, right: int) -> list[str]:
    """What a run has said that is no warning, and its status where that is not right."""
    said = (folder / f"{file}.err").read_text()
    wrong = [f"{file}: {line}" for line in said.splitlines() if not re.search(r"\bwarning: |: W-", line)]
    return wrong if status == right else [f"{file}: status {status}", *wrong]


STATUS: Final = {"for": 0, "stop": 0, "term": 128 + signal.SIGTERM}

WAYS: Final[dict[str, Callable[[System, Path], list[str]]]] = {
    **{f"with {time}": partial(left_by_with, simulated=time == "simulated") for time in ("real", "simulated")},
    **{
        f"{way} {time}": partial(ended_by, way, simulated=time == "simulated")
        for way in STATUS
        for time in ("real", "simulated")
    },
}
"""The ways in which a system is ended, by name."""
