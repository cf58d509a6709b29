"""Components that break one promise each; the conformance suite must find every one of them."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable

from aiorts import Component, InPort, OutPort
from aiorts.testing import faults
from aiorts.types import TimedDouble


class SwallowsCancellation(Component):
    """Takes a cancellation for a reason to try once more."""

    async def on_execute(self) -> None:
        for _ in range(3):
            try:
                await asyncio.sleep(1.0)
            except asyncio.CancelledError:
                continue


class WorksOnce(Component):
    """Cannot be activated a second time."""

    def on_activated(self) -> None:
        if hasattr(self, "opened"):
            raise OSError("the device is open")
        self.opened = True


_numbers = itertools.count()


class CountsOn(Component):
    """What it writes depends on what other instances did before."""

    result = OutPort(TimedDouble)

    def on_execute(self) -> None:
        self.result.write_nowait(TimedDouble(0, next(_numbers)))


class ChokesOnData(Component):
    """Divides by what it is given."""

    divisor = InPort(TimedDouble)

    def on_execute(self) -> None:
        _ = 1.0 / self.divisor.read_nowait().data


WRONG: dict[str, tuple[Callable[[], Component], str]] = {
    "swallows a cancellation": (SwallowsCancellation, "passes_on_cancellation"),
    "ignores every cancellation": (lambda: faults.Hanging("on_execute"), "passes_on_cancellation"),
    "leaves a task": (lambda: faults.Leaking("on_activated"), "leaves_nothing_behind"),
    "leaves a task at the end": (lambda: faults.Leaking("on_finalize"), "leaves_nothing_behind"),
    "blocks the loop": (lambda: faults.Blocking("on_execute", 0.12, times=1), "does_not_block_the_loop"),
    "changes what it wrote": (faults.Aliasing, "does_not_change_what_it_wrote"),
    "returns a value": (lambda: faults.Returning("on_execute", 5), "keeps_to_the_rules_of_hooks"),
    "fails at the end": (lambda: faults.Failing("on_shutdown"), "keeps_to_the_rules_of_hooks"),
    "fails on its input": (ChokesOnData, "keeps_to_the_rules_of_hooks"),
    "works once": (WorksOnce, "can_be_activated_again"),
    "depends on the past": (CountsOn, "is_deterministic"),
}
"""What is wrong -> the component, and the check that must find it."""
