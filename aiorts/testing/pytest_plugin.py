"""Fixtures for pytest, found by entry point. Loading this imports nothing but pytest; a fixture imports what it needs.

`simulated_clock`: a SimulatedClock at 0, which `@simulated` tests run on when they ask for it.
`rig_factory`: makes `Rig`s and sees that each was closed.
`aiorts_kernel`: an open Kernel in debug mode on `simulated_clock`, for asynchronous tests (`@pytest.mark.anyio`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable, Iterator

    from aiorts.assembly import Kernel
    from aiorts.clock import SimulatedClock
    from aiorts.testing.rig import Rig


@pytest.fixture
def simulated_clock() -> SimulatedClock:
    """A simulated clock at 0 s."""
    from aiorts.clock import SimulatedClock

    return SimulatedClock()


@pytest.fixture
def rig_factory() -> Iterator[Callable[..., Rig]]:
    """Makes rigs; takes what `Rig` takes. A rig that was opened and not closed fails the test."""
    from aiorts.testing.rig import Rig

    made: list[Rig] = []

    def make(*components: Any, **options: Any) -> Rig:
        made.append(Rig(*components, **options))
        return made[-1]

    yield make
    left = [rig for rig in made if rig.is_open]
    if left:
        pytest.fail(f"{len(left)} rigs were not closed; use `async with rig_factory(...) as rig`")


@pytest.fixture
async def aiorts_kernel(simulated_clock: SimulatedClock) -> AsyncIterator[Kernel]:
    """An open kernel on the simulated clock; closed after the test."""
    from aiorts.assembly import Kernel

    async with Kernel(clock=simulated_clock, debug=True) as kernel:
        yield kernel
