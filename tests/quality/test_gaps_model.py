"""Any writes and changes of state, in virtual time and shuffled order: each silence is found, and no other."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from anyio import WouldBlock
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts import ExternalContext, Kernel, SimulatedClock
from aiorts.errors import PortTypeError
from aiorts.events import Event, WriterBack, WriterSilent
from aiorts.testing.simulation import simulate
from aiorts.types import TimedLong
from campaign import cases, time_limit
from quality.test_expiry import Sink, Source

GAP_NS = 300_000_000
CHANGES = st.lists(
    st.tuples(st.sampled_from(["write", "write", "bad", "read", "writer", "reader", "listen"]), st.integers(0, 9)),
    min_size=1,
    max_size=40,
)
OPTIONS = st.sampled_from(
    [
        {},
        {"full": "block", "length": 1, "timeout": None},
        {"full": "reject", "length": 1},
        {"subscription": "periodic", "push_rate": 3.0},
        {"dataflow": "pull"},
        {"lifespan": 0.45},
    ]
)


class Course:
    """What happened, and which events there are by that."""

    def __init__(self) -> None:
        self.active = True
        self.silent = False
        self.written = self.seen = 0
        self.look: int | None = GAP_NS + 1
        self.events: list[tuple[str, int]] = []
        self.moved = [0]
        """When a gap may have begun: writes and activations."""

    def pass_to(self, now: int) -> None:
        """Nothing happens until then but looks."""
        while self.look is not None and self.look <= now:
            if self.written > self.seen:
                self.seen = self.written
                self.look += GAP_NS + 1
            else:
                self.silent = True
                self.events.append(("WriterSilent", self.look))
                self.look = None

    def wrote(self, now: int) -> None:
        """One more sample, or one that waits for room."""
        self.written += 1
        self.moved.append(now)
        if self.active and self.silent:
            self._back(now)

    def switched(self, now: int, *, active: bool) -> None:
        """Both ends are active now, or one is not."""
        if active is self.active:
            return
        self.active = active
        self.look = None
        if active:
            self.moved.append(now)
            if self.silent and self.written > self.seen:
                self._back(now)
            elif not self.silent:
                self.look = now + GAP_NS + 1
            self.seen = self.written

    def _back(self, now: int) -> None:
        self.silent = False
        self.seen = self.written
        self.events.append(("WriterBack", now))
        self.look = now + GAP_NS + 1


def run(options: dict[str, Any], changes: list[tuple[str, int]], seed: int) -> None:
    async def main(clock: SimulatedClock) -> None:
        found: list[tuple[str, int]] = []
        course = Course()
        tasks: list[asyncio.Task[bool]] = []
        async with Kernel() as kernel:
            source, sink = await kernel.add(Source("source")), await kernel.add(Sink("sink"))
            contexts = [await kernel.start(ExternalContext(), one, activate=True) for one in (source, sink)]
            actives = [True, True]

            def note(event: Event) -> None:
                found.append((type(event).__name__, clock.monotonic_ns()))

            for kind in (WriterSilent, WriterBack):
                kernel.bus.subscribe(kind, note)
            wire = await kernel.connect(source.out, sink.inp, max_gap=GAP_NS / 1e9, **options)
            number = 0
            for what, steps in changes:
                now = clock.monotonic_ns()
                course.pass_to(now)
                if what == "write":
                    number += 1
                    waits = wire.profile.full == "block" and sink.inp.is_new
                    if not waits:
                        course.wrote(now)
                        source.out.write_nowait(TimedLong(0, number))
                    elif not tasks:
                        course.wrote(now)
                        tasks.append(asyncio.create_task(source.out.write(TimedLong(0, number))))
                elif what == "bad":
                    with pytest.raises((PortTypeError, WouldBlock)):
                        source.out.write_nowait("no sample")  # type: ignore[arg-type]
                elif what == "read":
                    sink.inp.drain()
                    tasks = [task for task in tasks if not task.done()]
                elif what == "listen":
                    kernel.listen(wire, lambda event: None)
                else:
                    index = what == "reader"
                    context, one = contexts[index], (source, sink)[index]
                    await (context.deactivate if actives[index] else context.activate)(one)
                    actives[index] = not actives[index]
                    course.switched(now, active=all(actives))
                for _ in range(5):
                    await asyncio.sleep(0)
                tasks = [task for task in tasks if not task.done()]
                await asyncio.sleep(steps * 0.0701)
            course.pass_to(clock.monotonic_ns())
            silent, missed = wire.statistics.silent, wire.statistics.missed_gaps
            assert missed == sum(kind == "WriterSilent" for kind, _ in found)
            assert silent is (bool(found) and found[-1][0] == "WriterSilent")
        assert found == course.events
        for kind, when in found:
            if kind == "WriterSilent":
                last = max(moment for moment in course.moved if moment < when)
                assert GAP_NS < when - last <= 2 * (GAP_NS + 1)

    simulate(main, seed=seed)


@pytest.mark.slow(kept_by="quality/test_gaps.py::test_a_gap_is_found_within_two_of_them_and_its_end_at_once")
@pytest.mark.timeout(time_limit(1200))
@settings(max_examples=cases(5_000), deadline=None)
@given(OPTIONS, CHANGES, st.integers(0, 1_000))
def test_each_silence_is_found_and_no_other(options: dict[str, Any], changes: list[tuple[str, int]], seed: int) -> None:
    run(options, changes, seed)
