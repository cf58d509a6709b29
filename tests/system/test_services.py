"""Service ports in system files: run, checked before they run, drawn."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from aiorts.system import check, graph, load

PARTS = """
from typing import Protocol
from aiorts import Component, Provided, Required

class Brake(Protocol):
    async def stop(self, force: float) -> bool: ...

class Other(Protocol):
    async def stop(self, force: str) -> bool: ...

class Pid(Component):
    brake = Required[Brake]()
    async def on_execute(self) -> None:
        print(await self.brake.proxy.stop(1.0))
        self.finish()

class Brakes(Component):
    service = Provided[Brake]()
    async def stop(self, force: float) -> bool:
        return force == 1.0

class Wrong(Component):
    service = Provided[Other]()
    async def stop(self, force: str) -> bool:
        return True
"""
SYSTEM = """schema = 1
[components.pid0]
type = "parts.py:Pid"
[components.brake0]
type = "parts.py:Brakes"
[[connections]]
from = "pid0.brake"
to = "brake0.service"
[contexts.loop]
kind = "periodic"
rate = 100.0
members = ["pid0", "brake0"]
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    (tmp_path / "parts.py").write_text(PARTS)
    path = tmp_path / "system.toml"
    path.write_text(SYSTEM)
    return path


@pytest.mark.slow(kept_by="services/test_service_wiring.py::test_a_system_file_connects_service_ports")
def test_a_call_goes_through_a_connection_of_the_file(file: Path) -> None:
    command = [sys.executable, "-m", "aiorts", "run", str(file), "--simulate", "--for", "1"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=50, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "True\n", "")


@pytest.mark.row(68)
def test_an_interface_that_does_not_fit_is_found_before_anything_runs(file: Path) -> None:
    assert check(file) == ()
    file.write_text(SYSTEM.replace(":Brakes", ":Wrong"))
    (found,) = check(file)
    assert (found.code, found.line) == ("E-INTERFACE", 8)
    assert "parameter force: is str, not float" in found.message


def test_a_service_is_no_data_port_and_drives_no_cycle(file: Path) -> None:
    assert "brake: Brake" in graph(load(file))
    file.write_text(SYSTEM.replace('kind = "periodic"\nrate = 100.0', 'kind = "event"'))
    assert check(file) == ()
