"""Typed events for observers: what happened, as frozen values, in the order it happened.

An observer is a function called on the kernel's loop, or a coroutine function with a bounded queue of its own. One
that raises is counted and logged and goes on being called; one that holds the loop is named. Nothing is kept: an
observer that comes late has missed what was before.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from dataclasses import field
from time import perf_counter_ns
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

from aiorts.errors import DeclarationError
from aiorts.kernel.loop.guarded import guarded
from aiorts.kernel.loop.observers import AsyncObserver, Observer, ObserverStatistics, check_length, is_async
from aiorts.late import dataclass

if TYPE_CHECKING:
    from aiorts.model.blame import Blame
    from aiorts.model.lifecycle import LifecycleState
    from aiorts.model.profile import ConnectorProfile, PortProfile
    from aiorts.model.service_profile import ServiceConnectorProfile

__all__ = (
    "Bus",
    "CallFailed",
    "ComponentAdded",
    "ComponentRemoved",
    "Connected",
    "ContextStarted",
    "ContextStopped",
    "ConnectorChanged",
    "ConversionFailed",
    "Disconnected",
    "Event",
    "HookAfter",
    "HookBefore",
    "HookFailed",
    "MemberAdded",
    "MemberRemoved",
    "Observer",
    "Overrun",
    "ParametersChanged",
    "PortAdded",
    "PortRemoved",
    "RateChanged",
    "ServiceCalled",
    "StateChanged",
    "ThreadsExhausted",
)


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened. Subscribing to this class means all events but `HookBefore`, `HookAfter` and
    `ServiceCalled`."""

    quiet: ClassVar[bool] = False
    """Whether it is only sent to those who subscribe to its very class."""
    of_samples: ClassVar[bool] = False
    """Whether connectors must take the long way to have it."""

    sequence: int = field(default=0, compare=False, repr=False, kw_only=True)
    """Its number on the bus, from 1, without gaps; 0 for one that was not published."""


@dataclass(frozen=True, slots=True)
class Assembled(Event):
    """All that a run was to begin with is there: created, connected, its contexts started, its members activated."""


@dataclass(frozen=True, slots=True)
class Closing(Event):
    """The kernel begins to close: its components end from now on, and all that it is made of goes."""


@dataclass(frozen=True, slots=True)
class ComponentAdded(Event):
    """A component was created and initialised."""

    component: str


@dataclass(frozen=True, slots=True)
class ComponentRemoved(Event):
    """A component was finalised and removed."""

    component: str


@dataclass(frozen=True, slots=True)
class PortAdded(Event):
    """A port was added, at creation or at run time."""

    component: str
    port: PortProfile


@dataclass(frozen=True, slots=True)
class PortRemoved(Event):
    """A port was removed at run time; its connectors have ended."""

    component: str
    port: PortProfile


@dataclass(frozen=True, slots=True)
class Connected(Event):
    """A connector was made."""

    connector: ConnectorProfile | ServiceConnectorProfile


@dataclass(frozen=True, slots=True)
class ConnectorChanged(Event):
    """Options of a connector were changed; `before` has those that were in force."""

    connector: ConnectorProfile
    before: ConnectorProfile


@dataclass(frozen=True, slots=True)
class ConversionFailed(Event):
    """The converter of a connector raised, or made a wrong type: the first time, and again after it has worked.

    The samples are dropped as unconverted; the connector's ledger counts each.
    """

    connector: str
    error: str
    """The exception or fault, and its place."""


@dataclass(frozen=True, slots=True)
class Disconnected(Event):
    """A connector has ended."""

    connector: ConnectorProfile | ServiceConnectorProfile


@dataclass(frozen=True, slots=True)
class ContextStarted(Event):
    """An execution context runs, with the members it was started with."""

    context: str


@dataclass(frozen=True, slots=True)
class ContextStopped(Event):
    """An execution context has ended and has no members any more; `error` says why if it was not requested."""

    context: str
    error: str | None = None


@dataclass(frozen=True, slots=True)
class MemberAdded(Event):
    """A component was attached to a context that runs."""

    context: str
    component: str


@dataclass(frozen=True, slots=True)
class MemberRemoved(Event):
    """A component was detached from a context that goes on."""

    context: str
    component: str


@dataclass(frozen=True, slots=True)
class StateChanged(Event):
    """A component's lifecycle state in a context changed."""

    component: str
    context: str
    old: LifecycleState
    new: LifecycleState


@dataclass(frozen=True, slots=True)
class HookFailed(Event):
    """A hook raised, timed out or returned a value; the exception has its traceback."""

    component: str
    context: str
    hook: str
    error: BaseException
    origin: str = field(default="", compare=False)
    """`file:line` of the user's code that it came from, "" where there is none."""


@dataclass(frozen=True, slots=True)
class HookBefore(Event):
    """A hook is about to run; only sent to those who subscribe to this very class."""

    quiet: ClassVar[bool] = True
    component: str
    context: str
    hook: str


@dataclass(frozen=True, slots=True)
class HookAfter(Event):
    """A hook has run; `error` is what it raised. Only sent to those who subscribe to this very class."""

    quiet: ClassVar[bool] = True
    component: str
    context: str
    hook: str
    error: BaseException | None


@dataclass(frozen=True, slots=True)
class RateChanged(Event):
    """A context has another rate, in Hz."""

    context: str
    rate: float


@dataclass(frozen=True, slots=True)
class Overrun(Event):
    """A cycle was not done when the next was due: `skipped` ticks were left out."""

    context: str
    skipped: int
    late_ns: int
    policy: str = "skip"
    """The policy: "skip" leaves the missed ticks out, "catch_up" runs them."""
    blame: Blame | None = field(default=None, compare=False)
    """The code that made it late: a finding about the event; two events are compared without it."""


@dataclass(frozen=True, slots=True)
class ThreadsExhausted(Event):
    """Calls wait for a thread of the pool (`anyio.to_thread`, `asyncio.to_thread`): once until none waits any more."""

    waiting: int
    """Calls that wait for a thread."""
    threads: int
    """Threads of that pool, all of them busy."""


@dataclass(frozen=True, slots=True)
class ParametersChanged(Event):
    """Parameters have other values since this moment."""

    component: str
    values: tuple[tuple[str, Any], ...]


@dataclass(frozen=True, slots=True)
class ServiceCalled(Event):
    """A call through a service port has ended; only sent to those who subscribe to this very class."""

    quiet: ClassVar[bool] = True

    caller: str
    """The path of the required interface."""
    provider: str
    """The path of the provided interface."""
    method: str
    elapsed_ns: int
    """From asking to the answer."""
    error: BaseException | None
    """The error that the caller got."""


@dataclass(frozen=True, slots=True)
class CallFailed(Event):
    """A provider raised in a served call, answered with a wrong type, or did not answer in time."""

    caller: str
    provider: str
    method: str
    error: BaseException
    """The error that the caller got; the provider's own exception is its cause."""


E = TypeVar("E", bound=Event)
_AT_ONCE = 1000
"""Events caused by observers that are published before the loop has its turn."""
_HOOKS = (HookBefore, HookAfter)


class Bus:
    """Publishes events to those who subscribed to their class."""

    def __init__(
        self, wanted_changed: Callable[[], None] = lambda: None, check_thread: Callable[[str], None] = lambda what: None
    ) -> None:
        self._wanted_changed = wanted_changed
        self._check_thread = check_thread
        self._observers: tuple[Observer, ...] = ()
        self._wanted: dict[type[Event], bool] = {}
        self.hooks_wanted = False
        """Whether there is an observer of HookBefore or HookAfter: they cost nothing otherwise."""
        self.samples_wanted = False
        """Whether there is an observer of ConnectorEvent of all connectors; the same."""
        self.calls_wanted = False
        """Whether there is an observer of ServiceCalled."""
        self.sequence = 0
        """Number of the event published last."""
        self._telling = self._resuming = False
        self._later: deque[tuple[Event, tuple[Observer, ...]]] = deque()
        """Events that observers caused while they were notified of another."""

    @property
    def observers(self) -> tuple[ObserverStatistics, ...]:
        """The subscriptions, each with its counts."""
        return tuple(observer.statistics for observer in self._observers)

    def subscribe(
        self,
        kind: type[E],
        observer: Callable[[E], object],
        *,
        length: int = 1024,
    ) -> Callable[[], None]:
        """Call `observer` with each event of `kind` (or a class derived from it) until the returned function is
        called.

        A plain function is called at once, on the loop: it must not take long. An `async def` is awaited in a task of
        its own, one event after the other; at most `length` events wait for it, the oldest beyond are dropped and
        counted. One that raises is counted and logged, and goes on being called.

        Raises:
            DeclarationError: not a class of events, or nothing to call.
            ConfigurationError: the length is none.
            ThreadError: not on the kernel's loop.
        """
        if not (isinstance(kind, type) and issubclass(kind, Event)):
            raise DeclarationError(f"subscribe({kind!r}): expected a class of events, such as StateChanged")
        if not callable(observer):
            raise DeclarationError(f"subscribe({kind.__name__}): expected a function to call, got {observer!r:.80}")
        check_length("subscribe", length)
        self._check_thread("bus.subscribe")
        entry = (AsyncObserver if is_async(observer) else Observer)(kind, observer, length)
        self._observers += (entry,)
        self._recount()

        def unsubscribe() -> None:
            self._check_thread("unsubscribe")
            if entry in self._observers:
                self._observers = tuple(one for one in self._observers if one is not entry)
                entry.end()
                self._recount()

        return unsubscribe

    def publish(self, event: Event, listeners: tuple[Observer, ...] = ()) -> None:
        """Publish an event to its subscribers and to these listeners."""
        self.sequence = sequence = self.sequence + 1
        object.__setattr__(event, "sequence", sequence)
        observers = (*listeners, *self._observers) if listeners else self._observers
        if self._telling or self._later:
            # An observer did what is an event in its turn: the others hear of it after the one it follows from.
            self._later.append((event, observers))
            if not self._telling:
                self._deliver_later()
            return
        self._telling = True
        try:
            self._notify(event, observers)
        finally:
            self._telling = False
        if self._later:
            self._deliver_later()

    def _deliver_later(self) -> None:
        later = self._later
        self._telling = True
        try:
            for _ in range(_AT_ONCE):
                if not later:
                    return
                self._notify(*later.popleft())
        finally:
            self._telling = False
        if not self._resuming:
            # Observers that answer each event with another one do not hold the loop.
            self._resuming = True
            asyncio.get_running_loop().call_soon(self._resume)

    def _resume(self) -> None:
        self._resuming = False
        if not self._telling:
            self._deliver_later()

    def _notify(self, event: Event, observers: tuple[Observer, ...]) -> None:
        for observer in observers:
            kind = observer.kind
            if isinstance(event, kind) and not (event.quiet and kind is Event) and not observer.ended:
                began_ns = perf_counter_ns()
                try:
                    observer.notify(event)
                except BaseException as error:  # noqa: BLE001 - an observer's fault must not become the kernel's
                    guarded("could not tell of an observer", observer.failed, event, error)
                observer.took(perf_counter_ns() - began_ns, event)

    async def aclose(self, patience: float = 1.0) -> None:
        """Give the asynchronous observers `patience` seconds for what waits, and end them."""
        await asyncio.gather(*(observer.aclose(patience) for observer in self._observers))

    def wants(self, kind: type[Event]) -> bool:
        """Whether an event of `kind` has an observer: one that is costly to make is not made for none."""
        known = self._wanted.get(kind)
        if known is None:
            known = self._wanted[kind] = any(issubclass(kind, observer.kind) for observer in self._observers)
        return known

    def _recount(self) -> None:
        hooks = any(observer.kind in _HOOKS for observer in self._observers)
        self.calls_wanted = any(observer.kind is ServiceCalled for observer in self._observers)
        self._wanted.clear()
        samples = any(observer.kind.of_samples for observer in self._observers)
        if self.hooks_wanted is not hooks or self.samples_wanted is not samples:
            self.hooks_wanted, self.samples_wanted = hooks, samples
            self._wanted_changed()
