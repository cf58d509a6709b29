"""Methods that run on the current transport or receiver, which may be replaced while a method waits for the lock."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any, Concatenate, ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


def at_current(method: Callable[Concatenate[Any, P], R]) -> Callable[Concatenate[Any, P], R]:
    """Run a method under the lock, on the transport or receiver that is the current one once the lock is taken.

    `offer`, `wait_for_room`, `read` and `read_newest` run for each sample and repeat this code: a call costs too much.
    """

    @wraps(method)
    def run(self: Any, /, *args: P.args, **words: P.kwargs) -> R:
        with self.guard():
            now = self.current
            found: R = method(self, *args, **words) if now is self else getattr(now, method.__name__)(*args, **words)
            return found

    return run
