"""The declaration of a state machine's table: states, transitions, timers, history.

    Chart(
        State("closed", On("button", to="open"), initial=True),
        State("open", After(5.0, to="closed"), entry="lamp_on", exit="lamp_off"),
    )

`charting.py` checks and compiles a table, `interpreter.py` runs it. Actions, guards and delays are names of the owner's
methods and parameters, or plain functions that get the owner as first argument. `In("open")` as a guard is true while
that state is active.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

from aiorts.errors import DeclarationError
from aiorts.late import dataclass

Act: TypeAlias = "str | Callable[..., Any]"
"""The name of a method of the owner, or a function that gets the owner; both may take the event's data."""
Acts: TypeAlias = "Act | Sequence[Act] | None"
"""No action, one, or several in order."""


@dataclass(frozen=True, slots=True)
class In:
    """A guard that is true while a state of the chart is active; `~In("open")` is true while it is not."""

    state: str
    active: bool = True

    def __post_init__(self) -> None:
        if not isinstance(self.state, str):
            raise DeclarationError(f"In({self.state!r}): expected the name of a state")

    def __invert__(self) -> In:
        return In(self.state, not self.active)

    def __str__(self) -> str:
        return f"{'' if self.active else '!'}In('{self.state}')"


Guard: TypeAlias = "Act | In"
Guards: TypeAlias = "Guard | Sequence[Guard] | None"
"""No guard, one, or several that must all be true; `In` guards are evaluated first."""


@dataclass(frozen=True, slots=True)
class On:
    """A transition for an event.

    Without `to` it is internal: only the action runs, no state is left or entered. With `to` it is external: its
    state is left and entered again even if the target lies inside. `local=True` keeps a state that contains the target
    active. The first in the order of writing whose guard is true is taken; inner states come first.
    """

    event: str
    """The event's name, which also matches names that begin with it and a dot ("door" matches "door.open", as in
    SCXML). "*" matches any event that comes through a port or `send`."""
    to: str | None = None
    guard: Guards = None
    """A predicate without side effects, never `async`; `In` tests whether another state is active."""
    action: Acts = None
    local: bool = False


@dataclass(frozen=True, slots=True)
class After:
    """A transition `seconds` after its state was entered, on the kernel's clock; leaving the state ends the timer.

    It fires once for each entry; if its guard is false then, it does not fire again.
    """

    seconds: float | str
    """More than 0, or the name of a parameter of the owner, read when the state is entered."""
    to: str | None = None
    guard: Guards = None
    action: Acts = None
    local: bool = False


@dataclass(frozen=True, slots=True)
class Always:
    """A transition without event, taken as soon as its state is active and its guard is true.

    The guard is evaluated when the state is entered, after every event, also one without effect, and in every cycle.
    """

    to: str | None = None
    guard: Guards = None
    action: Acts = None
    local: bool = False


Way: TypeAlias = On | After | Always
"""A transition of any kind."""


class State:
    """One state, with transitions and states inside; earlier transitions are tried first.

    Args:
        name: letters, digits, "_" and "-"; unique in its chart.
        parts: transitions (`On`, `After`, `Always`) and, inside this one, further states.
        initial: whether it is entered when the state around it is; exactly one of several siblings is.
        entry: run when it is entered. init: then, when it enters its initial state by default. exit: when it is left.
        do: run once in each cycle of the execution context while it is active.
        defer: events that are kept while it is active, unless a transition of this state or of one inside it takes
            them; they are carried out, in the order of arrival, as soon as no active state defers them.
    """

    __slots__ = ("defer", "do", "entry", "exit", "init", "initial", "name", "parts")

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
        defer: str | Sequence[str] = (),
    ) -> None:
        self.name = name
        self.parts = parts
        self.initial = initial
        self.entry = entry
        self.init = init
        self.exit = exit
        self.do = do
        if not isinstance(defer, Sequence):
            raise DeclarationError(f"{name!r}: defer = {defer!r}: expected an event's name, or a tuple of names")
        self.defer = (defer,) if isinstance(defer, str) else tuple(defer)

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
            for name in ("initial", "entry", "init", "exit", "do", "defer")
            if getattr(self, name)
        ]
        return f"{type(self).__name__}({', '.join(words)})"


class Parallel(State):
    """A state whose states, its regions, are all active at once. Regions are never initial.

    Args: see `State`.
    """

    __slots__ = ()

    kind = "parallel"


class End(State):
    """A final state: the state around it is done, which raises the event "done.state.NAME". It has no transitions.

    At the top of a chart it ends the machine.
    """

    __slots__ = ()

    kind = "final"

    def __init__(self, name: str, *, initial: bool = False, entry: Acts = None, exit: Acts = None) -> None:  # noqa: A002
        super().__init__(name, initial=initial, entry=entry, exit=exit)


@dataclass(frozen=True, slots=True)
class History:
    """A target that stands for the states that were active in the state around it when that state was last left.

    Shallow: its own states; those inside them begin at their initial state. `deep=True`: all states inside.
    """

    name: str
    to: str | None = None
    """The target while there is no history yet; by default the initial state, or all regions."""
    deep: bool = False


def acts_of(acts: Acts) -> tuple[Act, ...]:
    """One action, several or none, as a tuple."""
    if acts is None:
        return ()
    return (acts,) if isinstance(acts, str) or callable(acts) else tuple(acts)


def guards_of(guards: Guards) -> tuple[Guard, ...]:
    """One guard, several or none, as a tuple: `In` guards first."""
    if guards is None:
        return ()
    those = tuple(guards) if isinstance(guards, Sequence) and not isinstance(guards, str) else (guards,)
    for guard in those:
        if not (isinstance(guard, str | In) or callable(guard)):
            raise DeclarationError(
                f"guard = {guard!r}: expected a method's name, a function, In(...) or ~In(...); a tuple takes several"
            )
    return tuple(sorted(those, key=lambda guard: not isinstance(guard, In)))
