"""`@simulated` runs an asynchronous test in virtual time, as an ordinary test: every pytest plugin leaves it alone."""

from __future__ import annotations

import functools
import inspect
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

from aiorts.clock import SimulatedClock
from aiorts.testing.simulation import simulate

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine

P = ParamSpec("P")
T = TypeVar("T")


def simulated(test: Callable[P, Coroutine[Any, Any, T]]) -> Callable[P, T]:
    """A synchronous function that runs `test` on a simulated loop; fixtures and parametrisation work as before.

    The clock is the argument that is a SimulatedClock (the fixture `simulated_clock`), if there is one, else a new one;
    inside, `current_clock()` returns it.

    Raises:
        TypeError: `test` is no coroutine function.
    """
    if not inspect.iscoroutinefunction(test):
        raise TypeError(f"@simulated: expected an `async def` function, got {test!r}")

    @functools.wraps(test)
    def run(*args: P.args, **kwargs: P.kwargs) -> T:
        clock = next((one for one in (*args, *kwargs.values()) if isinstance(one, SimulatedClock)), None)
        return simulate(test(*args, **kwargs), clock=clock)

    return run
