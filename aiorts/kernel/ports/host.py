"""The host of ports: all that a port uses of its component and its kernel.

A component has one host from its construction on; the kernel fills in the rest when the component is added.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Protocol

from aiorts.clock import to_ns
from aiorts.errors import ClosedError, StateError, ThreadError

if TYPE_CHECKING:
    from aiorts.clock import Clock
    from aiorts.kernel.loop.blocking import Blocking, PortLock
    from aiorts.kernel.loop.timers import Cancellable
    from aiorts.kernel.ports import Port, Turns


class KernelSide(Protocol):
    """The kernel, as far as the hosts of ports use it."""

    debug: bool
    name: str
    bus: Any
    closed: bool
    thread_id: int | None
    call_at: Callable[[int, Callable[[], None]], Cancellable]

    @property
    def clock(self) -> Clock: ...

    """The clock of all periods and timeouts."""

    @property
    def loop(self) -> asyncio.AbstractEventLoop: ...

    """The loop that the kernel was opened on."""

    def time_ns(self) -> int: ...

    @property
    def connections(self) -> Any: ...

    def call_later(self, seconds: float, callback: Callable[[], None]) -> Cancellable: ...

    def on_loop_thread(self) -> bool: ...

    def html_of(self, thing: Any) -> str | None: ...


class PortHost:
    """The owner of ports: a name, a share of uninterrupted turns, and the way to the kernel's loop and clock."""

    __slots__ = ("__dict__", "kernel", "name", "ports", "retired", "thread_id", "turns")

    # Attributes that few components ever set are defaults of the class: a host without them is smaller.
    alive: bool = True
    threaded: bool = False
    """Whether the component runs in a thread of its own."""
    locked: bool = False
    """Whether its ports have locks: the component's thread uses them, or is about to."""
    writing: bool = False
    """Whether the component's thread is in the middle of a write."""
    realtime: bool = False
    """Whether the component runs in a real-time thread, which never waits."""
    prepare: Callable[[Any], None] | None = None
    """A function that prepares an in-port for the component's real-time thread; None: there is no such thread."""
    trial: tuple[object, ...] = ()
    """Members whose ports take samples even in error: their new code failed, and the old code is not back yet."""
    was_active: bool = False
    """Whether the component, or the component that it replaced, was ever active."""
    stopping: bool = False
    """Whether the component's thread is to end: blocking calls in that thread give up."""
    blocking: Blocking | None = None
    """The way in which the component's thread waits at a port; None until the thread runs."""

    def __init__(self, name: str, turns: Turns) -> None:
        self.name = name
        self.turns = turns
        self.ports: dict[str, Port[Any]] = {}
        self.kernel: KernelSide | None = None
        self.retired = False
        """Whether the component has left its last context: plain code may read its ports, no writer waits for it."""
        self.thread_id: int | None = None
        """The thread of a ThreadContext that this component runs in; None means the kernel's loop."""

    def dropped_first(self, connector: Any) -> None:
        """Report that a connector to the component dropped its first sample, since the component was not active."""
        if self.kernel is not None:
            self.kernel.connections.early.dropped_first(connector)

    @property
    def debug(self) -> bool:
        """Whether every port call is checked (the test kit's debug mode)."""
        return self.kernel is not None and self.kernel.debug

    @property
    def loop(self) -> asyncio.AbstractEventLoop:
        """The kernel's loop."""
        return self._kernel().loop

    def on_loop_thread(self) -> bool:
        """Whether this is the thread of the kernel's loop."""
        return self.kernel is None or self.kernel.on_loop_thread()

    def time_ns(self) -> int:
        """The kernel clock's time, nanoseconds since the epoch."""
        return self._kernel().time_ns()

    def call_later(self, seconds: float, callback: Callable[[], None]) -> Cancellable:
        """Call `callback` after so many seconds of the kernel's clock."""
        return self._kernel().call_later(seconds, callback)

    def deadline_ns(self, seconds: float | None) -> int | None:
        """The kernel clock's time, in ns, when `seconds` from now have passed; None: never."""
        return None if seconds is None else self._kernel().clock.monotonic_ns() + to_ns(seconds)

    def wait_in_thread(self, lock: PortLock, ready: Callable[[], bool], deadline_ns: int | None) -> bool:
        """Block this thread, which is not the loop's, until `ready` returns true; False: the deadline passed first."""
        blocking = self.blocking
        if blocking is None:
            raise StateError(f"{self.name}: only a hook of a ThreadContext may block, in that context's thread")
        with lock:
            return blocking.until(lock, ready, deadline_ns)

    def check_loop_thread(self, what: str) -> None:
        """Raise ThreadError unless this is the thread of the kernel's loop."""
        if not self.on_loop_thread():
            raise ThreadError(
                f"{what} asked for in thread {threading.current_thread().name!r}; ask on the kernel's loop"
            )

    def check_port_thread(self, path: str) -> None:
        """Raise ThreadError unless this is the thread that the component runs in."""
        allowed = self.thread_id
        if allowed is None and self.on_loop_thread():
            return
        if allowed is not None and allowed == threading.get_ident():
            return
        raise ThreadError(
            f"{path}: used from thread {threading.current_thread().name!r}; "
            "a port is used in the thread of its component's context only"
        )

    def _kernel(self) -> KernelSide:
        if self.kernel is None:
            raise ClosedError(f"{self.name}: not added to a kernel yet; await kernel.add(...) first")
        return self.kernel
