"""Decides when a failed component is recovered, and how often. Pure.

A component in error is recovered after a delay. The delay doubles with each failure, and is back at `backoff` once the
component has run for a whole `window` after a recovery. After `budget` recoveries within `window` seconds it stays in
error.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from types import MappingProxyType
from typing import Final, Literal

from aiorts.errors import ConfigurationError
from aiorts.late import dataclass
from aiorts.model.declared import check_declared, expected_of, option
from aiorts.model.lifecycle import CYCLE_HOOKS

_MOST: Final = 1_000_000
_FACTOR: Final = 2.0
_AGES: Final = 1e9
"""The longest time in seconds: a longer time never passes, and its nanoseconds could exceed a float."""
ACTING: Final = ("restart", "deadline", "deadlines")
"""The options of which at least one is given: without them nothing is done."""


@dataclass(frozen=True, slots=True)
class Supervision:
    """The options of `Kernel.supervise`; the keys of a system file's table have the same names.

    A deadline of the component comes before that of the context. In a thread nothing can be cancelled: a hook over its
    deadline is reported while it runs, and is an error when it returns.

    Raises:
        ConfigurationError: a value is out of range; names it.
    """

    restart: Literal["never", "reset", "restart"] = option(
        "never", "What is done about an error: never; reset (on_reset, active again); restart (a new instance)."
    )
    backoff: float = option(0.1, "The delay of the first recovery.", unit="s", above=0)
    backoff_max: float = option(30.0, "The delay up to which it doubles with each failure.", unit="s", above=0)
    budget: int = option(5, "Recoveries within the window at the most.", low=0, high=1_000_000)
    window: float = option(30.0, "The time over which recoveries are counted.", unit="s", above=0)
    deadline: float | None = option(None, "The longest that each of its hooks may take.", unit="s", above=0)
    deadlines: Mapping[str, float] = option(
        MappingProxyType({}), "The same for single hooks, by name; it comes before deadline."
    )

    def __post_init__(self) -> None:
        check_declared(self)
        if self.backoff_max < self.backoff:
            raise ConfigurationError(f"backoff_max = {self.backoff_max!r}: is less than backoff = {self.backoff!r}")
        for hook, seconds in self.deadlines.items():
            if hook not in CYCLE_HOOKS:
                known = ", ".join(CYCLE_HOOKS)
                raise ConfigurationError(f"deadlines: no hook {hook!r} that a context runs; there are {known}")
            if what := expected_of(Supervision, "deadline", seconds):
                raise ConfigurationError(f"deadlines.{hook} = {seconds!r}: {what}")
        object.__setattr__(self, "deadlines", MappingProxyType(dict(self.deadlines)))

    @property
    def limits(self) -> Mapping[str, float] | None:
        """Seconds for every hook that has a limit; None when there is no limit at all."""
        limits = {} if self.deadline is None else dict.fromkeys(CYCLE_HOOKS, self.deadline)
        limits.update(self.deadlines)
        return MappingProxyType(limits) if limits else None


class Attempts:
    """The recoveries of one component; times are nanoseconds of one clock that does not go back."""

    __slots__ = ("_given", "_level", "_policy", "exhausted", "total")

    def __init__(self, policy: Supervision) -> None:
        self._policy = policy
        self._given: deque[int] = deque()
        """Times of the recoveries, within the window."""
        self._level = 0
        self.total = 0
        """The number of recoveries since the beginning."""
        self.exhausted = False
        """Whether the component was given up."""

    def failed(self, now_ns: int) -> float | None:
        """Record a failure at `now_ns`; returns seconds until the recovery, or None when there is none (any more)."""
        policy, given = self._policy, self._given
        if self.exhausted or policy.restart == "never":
            return None
        window_ns = round(min(policy.window, _AGES) * 1e9)
        if given and now_ns - given[-1] >= window_ns:
            self._level = 0
        while given and now_ns - given[0] >= window_ns:
            given.popleft()
        if len(given) >= policy.budget:
            self.exhausted = True
            return None
        # Not `2 ** level`: after a day of failures the number would exceed a float.
        delay = policy.backoff
        for _ in range(self._level):
            if delay >= policy.backoff_max:
                break
            delay *= _FACTOR
        delay = min(delay, policy.backoff_max)
        self._level = min(self._level + 1, _MOST)
        self.total += 1
        given.append(now_ns + round(min(delay, _AGES) * 1e9))
        return delay
