"""The lifecycle states, their transitions, and the text of a component's states. Pure.

The machine exists once for each pair of component and execution context (OMG RTC 1.1, section 5.2.2). `TRANSITIONS`
is the whole truth: the events that a state allows, the hooks that run on the way, in their order, and the state that
follows. `ON_FAILURE` has the consequence of a hook that raises. Two decisions differ from a literal reading of the
OMG text and follow OpenRTM-aist: leaving *active* through a failure runs `on_deactivated`
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
    """One state for a component that has these in its contexts: error before active before inactive; None for none."""
    return max(states, key=_WEIGHT.__getitem__, default=None)


@dataclass(frozen=True, slots=True)
class OverdueHook:
    """A hook that runs longer than its deadline, at one moment."""

    hook: str
    """The hook's name; "" where it is not known."""
    running_ns: int
    """The time for which the hook has run, on the kernel's clock."""
    deadline_ns: int
    """The time that the hook may take."""


def state_text(states: Mapping[str, str], overdue: Mapping[str, Mapping[str, Any]]) -> str:
    """The states of a component in all contexts in one line, without repetitions, each with its overdue hook.

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
    """An event for a component in one execution context."""

    ACTIVATE = "activate"
    DEACTIVATE = "deactivate"
    RESET = "reset"
    FAIL = "fail"


class Failure(StrEnum):
    """The consequence of a hook that raises."""

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
    """The transition by which `event` leads out of `state`, or None where it is refused (`ADVICE` says why)."""
    return TRANSITIONS.get((state, event))
