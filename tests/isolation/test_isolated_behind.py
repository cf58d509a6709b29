"""A component in a process of its own that is behind on large arrays does at once what it is told, and what is on its
way to it is not lost by that."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Awaitable
from contextlib import AsyncExitStack
from typing import Any, TypeVar

import pytest
from anyio import fail_after, sleep

from aiorts import Kernel, LifecycleState, PeriodicContext, ThreadContext
from aiorts.errors import ComponentError, ProcessError
from aiorts.links import Links
from campaign import CAMPAIGN, cases, time_limit
from isolation.isolated_parts import Camera, Detector

pytestmark = pytest.mark.anyio
ERROR, ACTIVE, INACTIVE = LifecycleState.ERROR, LifecycleState.ACTIVE, LifecycleState.INACTIVE
BOUND = 1.0 if CAMPAIGN else 8.0
"""Seconds in which each is done: a short run stands beside other tests."""
T = TypeVar("T")


class Times:
    """How long each thing took that a component was told."""

    def __init__(self) -> None:
        self.seconds: dict[str, list[float]] = defaultdict(list)

    async def of(self, what: str, awaited: Awaitable[T]) -> T:
        began = time.perf_counter()
        with fail_after(60):
            found = await awaited
        self.seconds[what].append(time.perf_counter() - began)
        return found

    def check(self) -> None:
        for what, seconds in self.seconds.items():
            seconds.sort()
            print(
                f"{what:12} {len(seconds)} times: median {seconds[len(seconds) // 2]:.3f} s, worst {seconds[-1]:.3f} s"
            )
        assert {what: seconds[-1] for what, seconds in self.seconds.items() if seconds[-1] > BOUND} == {}


async def one_round(number: int, full: Any, times: Times) -> None:
    async with AsyncExitStack() as stack:
        kernel = await stack.enter_async_context(Kernel("behind"))
        camera = await kernel.create(Camera, "camera", waits=full == "block")
        detector: Any = await kernel.create_isolated(Detector, "detector")
        connector = await kernel.connect(camera.out, "detector.inp", full=full, length=8)
        await kernel.start(PeriodicContext(100.0), camera, activate=True)
        await times.of("first", kernel.start(PeriodicContext(50.0), detector, activate=True))
        await sleep(0.05 * (number % 20))
        await times.of("configure", detector.configure(level=number))
        await times.of("deactivate", kernel.deactivate(detector))
        assert detector.state is INACTIVE
        await sleep(0.02 * (number % 7))
        await times.of("activate", kernel.activate(detector))
        await sleep(0.03 * (number % 11))
        await times.of("configure", detector.configure(fails=True))
        with fail_after(20):
            while detector.state is not ERROR:
                await sleep(0.01)
        await times.of("configure", detector.configure(fails=False))
        await times.of("reset", kernel.reset(detector))
        await times.of("activate", kernel.activate(detector))
        await sleep(0.03 * (number % 13))
        assert (await kernel.service(Links).ledger(connector)).unexplained == 0
        if number % 2:
            detector = await times.of("move", kernel.move(detector, ThreadContext(50.0)))
            await sleep(0.2)
        assert detector.state is ACTIVE
        await times.of("close", stack.aclose())


@pytest.mark.slow(
    kept_by="links/test_control_first.py::test_control_goes_before_all_samples_that_wait_and_is_taken_when_they_are_not"
)
@pytest.mark.timeout(time_limit(6_000))
@pytest.mark.parametrize("full", ["overwrite", "reject", "block"])
async def test_behind_on_arrays_it_does_at_once_what_it_is_told(full: str) -> None:
    times = Times()
    for number in range(max(2, cases(100))):
        await one_round(number, full, times)
    times.check()


@pytest.mark.slow
async def test_one_that_does_not_answer_when_it_is_deactivated_is_in_error_and_the_caller_hears_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async with Kernel() as kernel:
        detector: Any = await kernel.create_isolated(Detector, "detector")
        await kernel.start(PeriodicContext(50.0), detector, activate=True)
        asked = detector._process.ask

        async def unheard(operation: str, **given: Any) -> Any:
            if operation == "deactivate":
                raise ProcessError("detector: deactivate: its process has not answered within 7 s")
            return await asked(operation, **given)

        monkeypatch.setattr(detector._process, "ask", unheard)
        with pytest.raises(ComponentError, match="deactivate: its process has not answered"):
            await kernel.deactivate(detector)
        with fail_after(10):
            while detector.state is not ERROR:
                await sleep(0.01)
        monkeypatch.setattr(detector._process, "ask", asked)
        await kernel.reset(detector)  # it is deactivated there as well, where it was active all the time
        await kernel.activate(detector)
        assert detector.state is ACTIVE
