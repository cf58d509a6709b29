"""The lifecycle states: which follows which, and how a component's state is put in words. Pure.

The machine exists once for each pair of component and execution context (OMG RTC 1.1, section 5.2.2). `TRANSITIONS`
is the whole truth: what may be asked for in which state, which hooks run on the way, in which order, and where the pair
then is. `ON_FAILURE` says what a hook that raises leads to. Two decisions differ from a literal reading of the
OMG text and are taken from what OpenRTM-aist settled on: leaving *active* through a failure runs `on_deactivated`
before `on_aborting`, and an `on_activated` that raises goes the same way (it may have acquired half of its
resources).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from enum import StrEnum
from typing import Any, Final

from aiorts.late import dataclass


class LifecycleState(StrEnum):
    """The lifecycle state of a component in one execution context."""

    INACTIVE = "inactive"
    ACTIVE = "active"
    ERROR = "error"


def joint(states: Iterable[LifecycleState]) -> LifecycleState | None:
    """The one state of a component that has these states in its contexts; None without any."""
    return max(states, key=_WEIGHT.__getitem__, default=None)


@dataclass(frozen=True, slots=True)
class OverdueHook:
    """A hook that runs longer than its deadline, at one moment."""

    hook: str
    """Its name; "" where it is not known which it is."""
    running_ns: int
    """For so long, on the kernel's clock."""
    deadline_ns: int
    """Nanoseconds that the hook may take."""


def state_text(states: Mapping[str, str], overdue: Mapping[str, Mapping[str, Any]]) -> str:
    """The states of a component in all contexts in one line, each said once, with the hook that is late there.

    Args:
        states: lifecycle states by context.
        overdue: the plain form of an `OverdueHook` for each context where one is.
    """
    texts = (
        f"{state}, {_overdue_text(**overdue[context])}" if context in overdue else state
        for context, state in states.items()
    )
    return ", ".join(dict.fromkeys(texts)) or "in no context"


def _overdue_text(hook: str, running_ns: int, deadline_ns: int, **_later: Any) -> str:
    return f"{hook or 'a hook'} for {running_ns / 1e9:.1f} s (deadline {deadline_ns / 1e9:g} s)"


_WEIGHT: Final = {LifecycleState.INACTIVE: 0, LifecycleState.ACTIVE: 1, LifecycleState.ERROR: 2}


class Event(StrEnum):
    """What may happen to a component in one execution context."""

    ACTIVATE = "activate"
    DEACTIVATE = "deactivate"
    RESET = "reset"
    FAIL = "fail"


class Failure(StrEnum):
    """What a hook that raises leads to."""

    REFUSE = "refuse"
    """The component is not created; the caller gets the error."""
    ABORT = "abort"
    """The component goes to error."""
    STAY = "stay"
    """The component stays in error; the causes are chained."""
    RECORD = "record"
    """The transition completes; the cause stays in `last_error` and is published."""


ON_FAILURE: dict[str, Failure] = {
    "on_initialize": Failure.REFUSE,
    "on_finalize": Failure.RECORD,
    "on_startup": Failure.ABORT,
    "on_shutdown": Failure.RECORD,
    "on_activated": Failure.ABORT,
    "on_deactivated": Failure.RECORD,
    "on_execute": Failure.ABORT,
    "on_state_update": Failure.ABORT,
    "on_rate_changed": Failure.ABORT,
    "on_aborting": Failure.STAY,
    "on_error": Failure.STAY,
    "on_reset": Failure.STAY,
}
HOOKS = tuple(ON_FAILURE)
OUTSIDE = frozenset({"on_initialize", "on_finalize"})
"""Hooks that run in no context; they have limits of their own."""
CYCLE_HOOKS = tuple(hook for hook in HOOKS if hook not in OUTSIDE)
"""Hooks that a context runs."""


@dataclass(frozen=True, slots=True)
class Transition:
    """One way out of a state: the hooks to run, in order, and the state that follows."""

    hooks: tuple[str, ...]
    target: LifecycleState


_I, _A, _E = LifecycleState.INACTIVE, LifecycleState.ACTIVE, LifecycleState.ERROR

TRANSITIONS: dict[tuple[LifecycleState, Event], Transition] = {
    (_I, Event.ACTIVATE): Transition(("on_activated",), _A),
    (_I, Event.FAIL): Transition(("on_aborting",), _E),
    (_A, Event.DEACTIVATE): Transition(("on_deactivated",), _I),
    (_A, Event.FAIL): Transition(("on_deactivated", "on_aborting"), _E),
    (_E, Event.RESET): Transition(("on_reset",), _I),
    (_E, Event.FAIL): Transition((), _E),
}

ADVICE: dict[tuple[LifecycleState, Event], str] = {
    (_I, Event.DEACTIVATE): "it is inactive already",
    (_I, Event.RESET): "only a component in error is reset",
    (_A, Event.ACTIVATE): "it is active already",
    (_A, Event.RESET): "only a component in error is reset; deactivate it instead",
    (_E, Event.ACTIVATE): "reset it first",
    (_E, Event.DEACTIVATE): "it is in error and does not run; reset it instead",
}


def transition(state: LifecycleState, event: Event) -> Transition | None:
    """The way that `event` leads out of `state`, or None where it is refused (`ADVICE` says why)."""
    return TRANSITIONS.get((state, event))
