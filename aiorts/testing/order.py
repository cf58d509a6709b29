"""Shuffles the tasks that are ready at one instant, into an order that asyncio allows as well as the usual order.

In each turn of a loop the tasks that are ready change places, at random and reproducibly. Promised orders stay:

- Callbacks run in the order in which `call_soon` took them, as asyncio documents, and no task passes one: tasks that
  were ready before a callback run before it, later ones after it. So a future's done callbacks, the wake-up of the task
  that awaits it, and calls that a task schedules before it goes on keep their order.
- A task that gives up its turn (`sleep(0)`) goes on after everything that was ready then.
- Nothing moves from one turn to another.

asyncio promises no order of tasks that were woken or made meanwhile, nor of loop timers of the same moment (asyncio:
"the order in which they are called is undefined").
"""

from __future__ import annotations

import asyncio
import inspect
from random import Random
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections import deque

_WAKE_UPS: Final = ("task_wakeup", "__wakeup")
"""The names of the callback that wakes a task, in asyncio's C and in its Python code."""


class Shuffle:
    """Changes the order of ready handles by `seed`: the same seed and the same turns give the same order."""

    def __init__(self, seed: int) -> None:
        self._random = Random(seed)  # noqa: S311 - an order is no secret

    def __call__(self, ready: deque[asyncio.Handle]) -> None:
        """Reorder the handles that are ready in this turn, in place."""
        if len(ready) < 2:
            return
        order: list[asyncio.Handle] = []
        first = 0
        """The index of the first handle that may still change places."""
        # Handles are taken one by one: a thread may append others meanwhile, which run after these.
        for handle in [ready.popleft() for _ in range(len(ready))]:
            if _moves(handle):
                order.insert(self._random.randint(first, len(order)), handle)
            else:
                order.append(handle)
                if _task_of(handle) is None:  # a task gave up its turn: others may come before it
                    first = len(order)
        ready.extendleft(reversed(order))


def _moves(handle: asyncio.Handle) -> bool:
    """Whether this handle may change places with those that became ready before it in the same turn."""
    if isinstance(handle, asyncio.TimerHandle):
        return True
    task = _task_of(handle)
    if task is None:
        return False
    if getattr(_callback_of(handle), "__name__", "") in _WAKE_UPS:
        return True
    coroutine = task.get_coro()
    return inspect.iscoroutine(coroutine) and inspect.getcoroutinestate(coroutine) == inspect.CORO_CREATED


def _task_of(handle: asyncio.Handle) -> asyncio.Task[Any] | None:
    owner = getattr(_callback_of(handle), "__self__", None)
    return owner if isinstance(owner, asyncio.Task) else None


def _callback_of(handle: asyncio.Handle) -> Any:
    return handle._callback  # type: ignore[attr-defined] # None once it was cancelled
