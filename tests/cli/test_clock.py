"""`[clock]` of a system file: it decides how time passes, unless the command line does."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from run_parts import here

PARTS = """
from aiorts import Component, OutPort
from aiorts.types import TimedLong

class Teller(Component):
    out = OutPort(TimedLong)
    ticks = 0
    def on_execute(self):
        self.ticks += 1
        if self.ticks == 11:
            kind = type(self.clock).__name__
            print(kind, round(self.clock.speed, 6), flush=True)
            self.finish()
"""


@pytest.fixture
def write(tmp_path: Path) -> Callable[[str], str]:
    def write(clock: str, rate: float = 10.0) -> str:
        (tmp_path / "parts.py").write_text(PARTS)
        path = tmp_path / "system.toml"
        path.write_text(
            f'schema = 1\n[components.it]\ntype = "parts.py:Teller"\n{clock}\n'
            f'[contexts.c]\nkind = "periodic"\nrate = {rate}\nmembers = ["it"]\n'
        )
        return str(path)

    return write


@pytest.mark.parametrize(
    ("clock", "arguments", "rate", "said"),
    [
        ("", [], 1000.0, "SystemClock 1.0"),
        ('[clock]\nkind = "simulated"', [], 0.01, "SimulatedClock 1.0"),
        ('[clock]\nkind = "scaled"\nspeed = 100', [], 10.0, "ScaledClock 100.0"),
        ('[clock]\nkind = "scaled"\nspeed = 0.001', ["--speed", "200"], 10.0, "ScaledClock 200.0"),
        ('[clock]\nkind = "scaled"\nspeed = 0.001', ["--simulate"], 0.01, "SimulatedClock 1.0"),
        ('[clock]\nkind = "simulated"', ["--speed", "200"], 10.0, "ScaledClock 200.0"),
    ],
)
def test_the_clock_of_the_file_is_taken_and_the_command_line_wins(
    write: Callable[..., str],
    clock: str,
    arguments: list[str],
    rate: float,
    said: str,
) -> None:
    done = here("run", write(clock, rate), *arguments)
    assert (done.returncode, done.stdout.strip(), done.stderr) == (0, said, "")
