"""Methods that run on the current transport or receiver: another one may have its place once the lock is taken."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any, Concatenate, ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


def at_current(method: Callable[Concatenate[Any, P], R]) -> Callable[Concatenate[Any, P], R]:
    """Run a method under the lock and on the current transport or receiver: it may be replaced before the lock is free.

    Paths of each sample (`offer`, `wait_for_room`, `read`, `read_newest`) have this written out: a call costs too much.
    """

    @wraps(method)
    def run(self: Any, /, *args: P.args, **words: P.kwargs) -> R:
        with self.guard():
            now = self.current
            found: R = method(self, *args, **words) if now is self else getattr(now, method.__name__)(*args, **words)
            return found

    return run
