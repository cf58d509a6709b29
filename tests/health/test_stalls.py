"""What the machine took of the loop's time explains overruns that a hook is blamed for; it is looked up and no more."""

from __future__ import annotations

import asyncio
import os
import sys
import time
from typing import Any

import pytest

from aiorts import Component, Kernel, PeriodicContext
from aiorts.events import Overrun
from aiorts.health import Health, measuring, stalls
from aiorts.health.stalls import Stalls
from aiorts.model.blame import Blame

pytestmark = pytest.mark.anyio
MS = 1_000_000
HOOK = Blame("hook", "worker", "on_execute", held_ns=20 * MS)


class Counted(Stalls):
    """Has looked at these moments, counted from now, at so much that the machine had taken by then."""

    looks: tuple[tuple[int, int], ...] = ()
    taken_ns = 0

    def look(self) -> int:
        self._looks.clear()
        self._looks.extend((time.monotonic_ns() + at_ns, taken_ns) for at_ns, taken_ns in self.looks)
        self.total_ns = self.taken_ns
        return self.taken_ns


@pytest.mark.slow
async def test_who_is_to_blame_is_asked_again_where_the_machine_took_as_much_as_it_was_late(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(measuring, "Stalls", Counted)
    async with Kernel() as kernel:
        worker = await kernel.create(Component, "worker")
        await kernel.start(PeriodicContext(rate=1.0, name="loop"), worker)  # so slow that none of its own is late
        measured = asyncio.ensure_future(Health(kernel).window(0.2))
        await asyncio.sleep(0.02)

        def overran(late_ns: int, *looks: tuple[int, int], taken_ns: int) -> None:
            Counted.looks, Counted.taken_ns = looks, taken_ns
            kernel.bus.publish(Overrun("loop", 1, late_ns, "skip", HOOK))

        overran(2_000 * MS, (-5_000 * MS, 0), (-4_000 * MS, 300 * MS), (-500 * MS, 900 * MS), taken_ns=2_300 * MS)
        overran(2_000 * MS, (-5_000 * MS, 0), (-4_000 * MS, 300 * MS), (-500 * MS, 900 * MS), taken_ns=2_200 * MS)
        Counted.taken_ns = 0
        found = (await measured).contexts["loop"]
    assert (found.by_machine, found.left_out) == (1, 1)


async def test_it_looks_while_it_is_open_and_leaves_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stalls, "_EVERY", 0.001)
    if sys.platform != "linux" or not os.path.exists("/proc/self/schedstat"):
        pytest.skip("needs a system that counts how long threads wait for a processor")
    files = set(os.listdir("/proc/self/fd"))
    looked = Stalls(asyncio.get_running_loop())
    try:
        began = time.monotonic_ns()
        first = looked.look()
        await asyncio.sleep(0.02)
        assert 0 <= first <= looked.look()
        assert 0 <= looked.since(began) <= time.monotonic_ns() - began
        assert len(looked._looks) > 3
    finally:
        looked.close()
        looked.close()
    assert set(os.listdir("/proc/self/fd")) == files
    assert looked._timer is None


async def test_a_thread_that_comes_and_goes_is_counted(monkeypatch: pytest.MonkeyPatch, tmp_path: Any) -> None:
    monkeypatch.setattr(stalls, "_THREADS", str(tmp_path))

    def count(thread: str, stalled_ns: int) -> None:
        (tmp_path / thread).mkdir(exist_ok=True)
        (tmp_path / thread / "schedstat").write_text(f"1000 {stalled_ns} 7\n")

    count("1", 500)
    looked = Stalls(asyncio.get_running_loop())
    try:
        count("1", 600)
        count("2", 50)
        assert looked.look() == 100
        count("2", 80)
        assert looked.look() == 130
        (tmp_path / "1" / "schedstat").unlink()
        (tmp_path / "1").rmdir()
        count("2", 90)
        (tmp_path / "3").mkdir()
        assert looked.look() == 140
        assert looked.since(0) == 140
    finally:
        looked.close()


async def test_where_the_system_does_not_count_it_the_machine_took_nothing(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Any
) -> None:
    monkeypatch.setattr(stalls, "_THREADS", str(tmp_path / "none"))
    looked = Stalls(asyncio.get_running_loop())
    assert (looked.look(), looked.since(0)) == (0, 0)
    (tmp_path / "none" / "1").mkdir(parents=True)
    (tmp_path / "none" / "1" / "schedstat").write_text("nothing")
    other = Stalls(asyncio.get_running_loop())
    assert (other.look(), other.since(0)) == (0, 0)
    monkeypatch.setattr(stalls, "_THREADS", str(tmp_path / "gone"))
    assert other.look() == 0
    other.close()
    looked.close()
