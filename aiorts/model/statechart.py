"""The table of a state machine, as it is written: states, transitions, timers, history. Nothing here runs.

    Chart(
        State("closed", On("button", to="open"), initial=True),
        State("open", After(5.0, to="closed"), entry="lamp_on", exit="lamp_off"),
    )

`charting.py` checks a table and lays it out, `interpreter.py` runs it. What a table may name (actions, guards,
delays) are names of the owner's methods and parameters, or plain functions that get the owner as first argument.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

__all__ = ("Act", "Acts", "After", "Always", "End", "History", "On", "Parallel", "State", "Way", "acts_of")

Act: TypeAlias = "str | Callable[..., Any]"
"""The name of a method of the owner, or a function that gets the owner; both may take what came with the event."""
Acts: TypeAlias = "Act | Sequence[Act] | None"
"""Nothing, one, or several in order."""


@dataclass(frozen=True, slots=True)
class On:
    """What an event leads to.

    Without `to` it is an internal transition: only the action runs, no state is left or entered. With `to` it is
    external: its state is left and entered again where the target lies inside. `local=True` keeps a state that
    contains the target as it is. The first in the order of writing whose guard says yes is taken; states further
    inside come first.
    """

    event: str
    """The event's name; "*" is any that comes through a port or `send`."""
    to: str | None = None
    guard: Act | None = None
    """A predicate: it only looks, and is never `async`."""
    action: Acts = None
    local: bool = False


@dataclass(frozen=True, slots=True)
class After:
    """What happens `seconds` after its state was entered, on the kernel's clock; leaving the state ends the timer.

    It fires once for each entry, whatever its guard says then.
    """

    seconds: float | str
    """More than 0, or the name of a parameter of the owner, read when the state is entered."""
    to: str | None = None
    guard: Act | None = None
    action: Acts = None
    local: bool = False


@dataclass(frozen=True, slots=True)
class Always:
    """What happens at once, without an event, as soon as its state is active and its guard says yes."""

    to: str | None = None
    guard: Act | None = None
    action: Acts = None
    local: bool = False


Way: TypeAlias = On | After | Always
"""A transition, by what sets it off."""


class State:
    """One state: transitions and states inside, in the order that decides.

    Args:
        name: letters, digits, "_" and "-"; unique in its chart.
        parts: transitions (`On`, `After`, `Always`) and, inside this one, further states.
        initial: whether it is entered when the state round it is; exactly one of several siblings is.
        entry: run when it is entered. init: then, when it enters its initial state by itself. exit: when it is left.
        do: run once in each cycle of the execution context while it is active.
    """

    __slots__ = ("do", "entry", "exit", "init", "initial", "name", "parts")

    kind = "state"

    def __init__(
        self,
        name: str,
        *parts: State | History | Way,
        initial: bool = False,
        entry: Acts = None,
        init: Acts = None,
        exit: Acts = None,  # noqa: A002 - the word users expect
        do: Acts = None,
    ) -> None:
        self.name = name
        self.parts = parts
        self.initial = initial
        self.entry = entry
        self.init = init
        self.exit = exit
        self.do = do

    def _values(self) -> tuple[object, ...]:
        return (self.kind, *(getattr(self, name) for name in State.__slots__))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, State) and self._values() == other._values()

    def __hash__(self) -> int:
        return hash((self.kind, self.name))

    def __repr__(self) -> str:
        words = [repr(self.name), *map(repr, self.parts)]
        words += [
            f"{name}={getattr(self, name)!r}"
            for name in ("initial", "entry", "init", "exit", "do")
            if getattr(self, name)
        ]
        return f"{type(self).__name__}({', '.join(words)})"


class Parallel(State):
    """A state whose states, its regions, are all active at once. Args: see `State`; regions are never initial."""

    __slots__ = ()

    kind = "parallel"


class End(State):
    """A state in which the one round it is done: that raises the event "done.state.<name>". Nothing leads out.

    At the top of a chart it ends the machine.
    """

    __slots__ = ()

    kind = "final"

    def __init__(self, name: str, *, initial: bool = False, entry: Acts = None, exit: Acts = None) -> None:  # noqa: A002
        super().__init__(name, initial=initial, entry=entry, exit=exit)


@dataclass(frozen=True, slots=True)
class History:
    """A target that stands for what was active, when it was last left, inside the state that this stands in.

    Shallow: which of its states; what is inside those begins anew. `deep=True`: everything inside.
    """

    name: str
    to: str | None = None
    """Where it leads before the first time; the initial state, or all regions, where nothing is said."""
    deep: bool = False


def acts_of(acts: Acts) -> tuple[Act, ...]:
    """One, several or none, as a tuple."""
    if acts is None:
        return ()
    return (acts,) if isinstance(acts, str) or callable(acts) else tuple(acts)
