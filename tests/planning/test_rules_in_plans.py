"""What a rule has connected comes back with what a plan takes back; what a plan connects is the plan's."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from aiorts import Kernel
from aiorts.errors import ApplyError
from aiorts.system import build, load, wanted
from aiorts.testing import simulate
from planning.test_apply import check_ledgers

PARTS = """
from aiorts import Component, InPort, OutPort, Param
from aiorts.types import TimedLong

class Ramp(Component):
    out = OutPort(TimedLong)
    def on_execute(self):
        self.out.write_nowait(TimedLong(data=1))

class Meter(Component):
    inp = InPort(TimedLong)
    reads: bool = Param(True)
    def on_execute(self):
        if self.reads:
            self.inp.drain()

class Five(Component):
    pose = OutPort(TimedLong)
    number = 0
    def on_execute(self):
        self.number += 1
        if self.number <= 5:
            self.pose.write_nowait(TimedLong(data=self.number))

class Logger(Component):
    poses = InPort(TimedLong)

class Failing(Component):
    def on_activated(self):
        raise ValueError("dark")
"""
TAKEN_OVER = '[[connections]]\nfrom = "five.pose"\nto = "logger.poses"\nlength = 9\n'
ALL = {"ramp": "Ramp", "meter": "Meter", "five": "Five", "logger": "Logger"}
CHANGES = {
    "the writer goes": (("ramp", "meter", "logger"), ""),
    "the reader goes": (("ramp", "meter", "five"), ""),
    "both go": (("ramp", "meter"), ""),
    "taken over": (tuple(ALL), TAKEN_OVER),
}
PAIR = "five.pose-logger.poses"


def a_system(folder: Path, names: tuple[str, ...] = tuple(ALL), more: str = "", *, end: str = "") -> Path:
    """A system of these components; `end`: "worse" in its window, or "fails" when it is applied."""
    (folder / "parts.py").write_text(PARTS)
    kinds = {name: ALL[name] for name in names} | ({"failing": "Failing"} if end == "fails" else {})
    text = 'schema = 1\n[[rules]]\nfrom = "*.pose"\nto = "logger.*"\nlength = 8\nmax = 1\n'
    text += "".join(f'[components.{name}]\ntype = "parts.py:{kind}"\n' for name, kind in kinds.items())
    text += f'[contexts.work]\nkind = "periodic"\nrate = 100.0\nmembers = {list(kinds)}\n'
    text += f'[[connections]]\nfrom = "ramp.out"\nto = "meter.inp"\n{more}'
    file = folder / "system.toml"
    worse = "[components.meter]\nparams.reads = false" if end == "worse" else "[components.meter]"
    file.write_text(text.replace("[components.meter]", worse))
    return file


def unread(logger: Any) -> list[int]:
    """What can be read; it is read."""
    return [sample.data for sample in logger.poses.drain()]


@pytest.mark.parametrize("end", ["worse", "fails"])
@pytest.mark.parametrize("change", CHANGES)
def test_a_plan_that_is_taken_back_brings_back_what_a_rule_connected(change: str, end: str, tmp_path: Path) -> None:
    async def main() -> None:
        async with Kernel() as kernel:
            await build(kernel, load(a_system(tmp_path)))
            await kernel.sleep(1.0)
            there, logger = kernel.connectors[PAIR], kernel.components["logger"]
            five: Any = kernel.components["five"]
            after = wanted(load(a_system(tmp_path, *CHANGES[change], end=end)))
            if end == "fails":
                with pytest.raises(ApplyError) as refused:
                    await kernel.apply(after)
                assert refused.value.not_undone == ()
            else:
                applied = await kernel.apply(after, window=1.0)
                assert (applied.done, applied.notes) == (False, ())
            await kernel.sleep(0.1)
            assert kernel.components["logger"] is logger
            assert kernel.connectors[PAIR] is there
            check_ledgers(kernel)
            assert unread(logger) == [1, 2, 3, 4, 5]
            five.number = 0
            await kernel.sleep(0.1)
            assert unread(logger) == [1, 2, 3, 4, 5]
            assert (await kernel.apply(wanted(load(a_system(tmp_path))), dry_run=True)).plan.empty

    simulate(main())


def test_what_a_plan_has_taken_over_is_its_own(tmp_path: Path) -> None:
    async def main() -> None:
        async with Kernel() as kernel:
            await build(kernel, load(a_system(tmp_path)))
            await kernel.sleep(0.1)
            taken_over = wanted(load(a_system(tmp_path, *CHANGES["taken over"])))
            await kernel.apply(taken_over)
            await kernel.sleep(0.1)
            assert kernel.connectors[PAIR].profile.length == 9
            assert (await kernel.apply(taken_over, dry_run=True)).plan.empty
            await kernel.save(tmp_path / "saved.toml")
            assert 'to = "logger.poses"' in (tmp_path / "saved.toml").read_text()

    simulate(main())


def test_another_pair_has_its_turn_when_it_is_final_that_one_is_gone(tmp_path: Path) -> None:
    async def main() -> None:
        async with Kernel() as kernel:
            ALL["six"] = "Five"
            try:
                before, after = (tuple(ALL)), tuple(name for name in ALL if name != "five")
                await build(kernel, load(a_system(tmp_path, before)))
                await kernel.sleep(1.0)
                applied = await kernel.apply(wanted(load(a_system(tmp_path, after))), window=1.0)
            finally:
                del ALL["six"]
            assert applied.done, applied.rolled_back
            await kernel.sleep(0.1)
            assert set(kernel.connectors) == {"ramp.out-meter.inp", "six.pose-logger.poses"}

    simulate(main())
