"""The manipulator gets another controller while it runs, and misses at the most one of 500 ticks a second."""

from __future__ import annotations

import asyncio
import shutil
from pathlib import Path

import pytest

from aiorts import Connector, Kernel
from aiorts.model.wanted.applied import Applied
from aiorts.system import build, load, wanted
from aiorts.testing import simulate

pytestmark = pytest.mark.slow(kept_by="planning/test_roll_back.py::test_who_is_gone_ends_when_it_is_final")

EXAMPLE = Path(__file__).parents[2] / "examples" / "manipulator"
MOVED = "    def on_reload(self, old):\n        self.speed = old.speed\n"
"""Another type takes over how fast the arm is to move."""
CHANGES = {
    "another set": [('active = "damped"', 'active = "brisk"')],
    "another type": [('"damper.py:Damper"', '"other.py:Stiff"')],
    "another component": [
        ("[components.damper]", "[components.stiff]"),
        ('"damper.py:Damper"', '"other.py:Stiff"'),
        ('"joystick", "damper", "arm"]', '"joystick", "stiff", "arm"]'),
        ("damper.force", "stiff.force"),
        ("damper.push", "stiff.push"),
        ("damper.command", "stiff.command"),
    ],
}
TICK = 0.002


@pytest.fixture(params=CHANGES)
def files(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Path, Path]:
    """The system in real time, and the one with another controller."""
    folder = Path(shutil.copytree(EXAMPLE, tmp_path / "manipulator"))
    damper = (folder / "damper.py").read_text()
    (folder / "other.py").write_text(damper.replace("class Damper", "class Stiff") + "\n" + MOVED)
    text = (folder / "real.toml").read_text()
    for before, after in CHANGES[request.param]:
        assert before in text
        text = text.replace(before, after)
    (folder / "other.toml").write_text(text)
    return folder / "real.toml", folder / "other.toml"


def written(kernel: Kernel, *paths: str) -> dict[Connector, int]:
    """What went through the connectors to these in-ports."""
    return {one: one.statistics.written for one in kernel.connectors.values() if one.in_.path in paths}


async def switched(kernel: Kernel, files: tuple[Path, Path]) -> tuple[Applied, int, int]:
    """Ticks that were left out, of the arm and of who commands it."""
    await build(kernel, load(files[0]))
    await kernel.sleep(0.3003)
    change, clock = wanted(load(files[1])), kernel.clock
    await kernel.sleep(0.0503)
    began_ns, ticks, commands = clock.monotonic_ns(), written(kernel, "judge.speed"), written(kernel, "arm.command")
    applied = await kernel.apply(change)
    await kernel.sleep(0.1)
    due = round((clock.monotonic_ns() - began_ns) / 1e9 / TICK)
    seen = [
        sum(one.statistics.written - those.get(one, 0) for one in {**those, **written(kernel, path)})
        for those, path in ((ticks, "judge.speed"), (commands, "arm.command"))
    ]
    return applied, due - seen[0], due - seen[1]


def test_at_most_one_tick_is_left_out(files: tuple[Path, Path]) -> None:
    async def main() -> None:
        async with Kernel() as kernel:
            applied, ticks, commands = await switched(kernel, files)
            assert applied.done
            assert applied.notes == ()
            assert 0 <= ticks <= 1
            assert 0 <= commands <= 1

    simulate(main())


def test_every_tick_of_the_arm_has_its_command_but_one_in_real_time(files: tuple[Path, Path]) -> None:
    """A machine that is busy leaves out ticks of the whole composite."""

    async def main() -> None:
        async with Kernel() as kernel:
            applied, ticks, commands = await switched(kernel, files)
            assert applied.done
            assert applied.notes == ()
            assert ticks - 1 <= commands <= ticks + 1

    asyncio.run(main())
