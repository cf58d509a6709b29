"""A force-controlled manipulator, in a simulator and in real time: four runs, one table, and what must hold of them.

Run: python examples/manipulator/compare.py

The system is the first example of N. Ando, T. Suehiro, T. Kotoku, "A Software Platform for Component Based RT-System
Development: OpenRTM-Aist" (SIMPAR 2008): force sensor, joystick, damper controller and arm, written separately, run one
after the other in one task of 2 ms. There a controller leaves the simulator OpenHRP3 for the real robot unchanged; so
it does here, and says the same to the last bit. Exits with 1 and a line for each promise that does not hold:

- the force is within 2 % of the set-point after 1 s, and stays there;
- another configuration set has another overshoot, the one that its damping must have;
- the brake, a service that the joystick calls, stops the arm within two ticks;
- what the controller was told in real time, told again in the simulator, has the same answers.
"""

from __future__ import annotations

import contextlib
import io
import logging
import sys
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from aiorts import Context, Kernel, run
from aiorts.system import build, load
from aiorts.testing import simulate

HERE = Path(__file__).parent
WRONG = "not as promised: "


@dataclass(frozen=True, slots=True)
class Played:
    """One run of a system file."""

    where: str
    table: list[str]
    """What it printed and what it did not complain of; the first line is the table's head, where there is a table."""
    faults: list[str]
    loop: Context
    """What ran the controller."""


def play(where: str, file: str, *changes: str) -> Played:
    """Run a system file as `aiorts run FILE --set CHANGE ...` does."""
    system = load(HERE / file, changes)

    async def main() -> tuple[int, Context]:
        async with Kernel() as kernel:
            await build(kernel, system)
            loop = kernel.contexts["loop"]
            return await kernel.wait_stop_requested(), loop

    with contextlib.redirect_stdout(io.StringIO()) as said:
        status, loop = simulate(main()) if system.clock.kind == "simulated" else run(main)
    lines = said.getvalue().splitlines()
    faults = [f"{where}: {line.removeprefix(WRONG)}" for line in lines if line.startswith(WRONG)]
    if status and not faults:
        faults = [f"{where}: ended with status {status}"]
    return Played(where, [line for line in lines if not line.startswith(WRONG)], faults, loop)


def highest(recording: Path) -> float:
    """What the wall felt at most, N."""
    return max((float(line.split(",")[-1]) for line in recording.read_text().splitlines()), default=0.0)


def main(folder: Path) -> int:
    """Play all four, show what they say; 1 when anything is not as promised."""
    damped, brisk, real = (folder / f"{name}.csv" for name in ("damped", "brisk", "real"))
    runs = [
        play("simulator", "sim.toml", f"judge.record={damped}"),
        play("simulator", "sim.toml", f"judge.record={brisk}", "damper.active=brisk"),
        play("real time", "real.toml", f"judge.record={real}"),
        play("replayed", "replay.toml", f"tape.path={real}"),
    ]
    faults = [fault for played in runs for fault in played.faults]
    if highest(brisk) < highest(damped) + 1.0:
        faults.append(f"brisk reaches {highest(brisk):.2f} N and damped {highest(damped):.2f} N: that is no difference")
    times = runs[2].loop.statistics
    late = times.lateness_total_ns / max(times.cycles, 1) / 1e6
    print(*(f"{'':11}{line}" for line in runs[0].table[:1]), sep="\n")
    for played in runs:
        print(*(f"{played.where:11}{line}" for line in played.table[-1:]), sep="\n")
    print(f"{'real time':11}{times.cycles} ticks of 2 ms, each {late:.2f} ms late on average, {times.skipped} skipped")
    for fault in faults:
        print(f"{WRONG}{fault}")
    return 1 if faults else 0


if __name__ == "__main__":
    logging.getLogger("aiorts").setLevel(logging.ERROR)  # that ticks came late stands in the last row
    with TemporaryDirectory() as name:
        sys.exit(main(Path(name)))
