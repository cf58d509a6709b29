"""Who can be reached: a run unless it says no, a program where it asks for it, and what each lets others do."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from aiorts.errors import DeniedError
from aiorts.sessions import Client, entries
from control_parts import WAIT, entry_of, running, until

SYSTEM = Path(__file__).parents[2] / "examples/pid/system.toml"


@pytest.mark.slow(kept_by="control/test_socket.py::test_who_may_only_look_is_denied")
@pytest.mark.parametrize("place", ["option", "file"])
def test_a_run_that_may_only_be_looked_at(place: str, tmp_path: Path) -> None:
    words = ["--control=view", str(SYSTEM)]
    if place == "file":
        file = Path(shutil.copytree(SYSTEM.parent, tmp_path / "pid"), SYSTEM.name)
        file.write_text(SYSTEM.read_text(encoding="utf-8") + '\n[control]\nmode = "view"\n', encoding="utf-8")
        words = [str(file)]
    with running("looked-at", *words), Client.open(entry_of("looked-at"), timeout=WAIT) as client:
        assert client.right == "view"
        assert client.call("names", WAIT)["state"] == "open"
        with pytest.raises(DeniedError):
            client.call("stop", WAIT)


@pytest.mark.slow(kept_by="control/test_socket.py::test_who_may_only_look_is_denied")
def test_a_run_that_is_not_to_be_reached_has_no_socket() -> None:
    words = [sys.executable, "-m", "aiorts", "run", "--control=off", "--for", "0.2", str(SYSTEM)]
    with subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL) as process:
        until(lambda: process.poll() is not None or entries())
        assert entries() == ()
        assert process.wait(WAIT) == 0


@pytest.mark.slow(kept_by="architecture/test_layers.py::test_a_microkernel_runs_components_with_no_service_loaded")
def test_a_kernel_of_a_program_imports_nothing_of_it_unless_asked() -> None:
    code = (
        "import asyncio, sys\nfrom aiorts import Kernel\n"
        "async def main(services):\n    async with Kernel(services=services) as kernel:\n"
        "        loaded = any(name in sys.modules for name in ('aiorts.control', 'aiorts.sessions'))\n"
        "        return bool(kernel.address), kernel.epoch != 0, loaded\n"
        "print(asyncio.run(main({})), asyncio.run(main({'control': {}})))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=WAIT, check=True)
    assert done.stdout == "(False, False, False) (True, True, True)\n"
