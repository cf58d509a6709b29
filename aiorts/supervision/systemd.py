"""Notifies systemd of the state of the process where the environment requests it: ready, alive, stopping, status.

Keep-alive messages are sent only while every execution context makes progress: the event loop itself sends them, so
that a blocked loop sends none, and none is sent while a hook has run for half of the watchdog's interval. Each
notification is a datagram to the socket in NOTIFY_SOCKET; one that cannot be sent is dropped, without waiting.
"""

from __future__ import annotations

import asyncio
import os
import socket
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Final

from aiorts.errors import AiortsError, format_error
from aiorts.kernel.loop.guarded import KernelLog
from aiorts.kernel.loop.tasks import kernel_task
from aiorts.model.lifecycle import LifecycleState
from aiorts.supervision import readiness

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.execution.context import Context
    from aiorts.kernel.microkernel import Microkernel

_LOG = KernelLog()
_TICK: Final = 1.0
"""Seconds between two status updates where there is no watchdog."""
_SHARE: Final = 4
"""Keep-alive messages in one watchdog interval; systemd advises two."""
_LONGEST: Final = 300
"""Characters of a status."""


class Notifier:
    """The socket to systemd."""

    def __init__(self, address: str) -> None:
        # "@" stands for the zero byte that names of the abstract name space begin with.
        self._address = f"\0{address[1:]}" if address.startswith("@") else address

    @classmethod
    def from_environment(cls, environ: Mapping[str, str]) -> Notifier | None:
        """The notifier for this process; None without a request in the environment, or for an unknown address."""
        address = environ.get("NOTIFY_SOCKET", "")
        if not address:
            return None
        if address[0] not in "/@" or len(address) < 2 or not hasattr(socket, "AF_UNIX"):
            _LOG.warning(
                "NOTIFY_SOCKET = %r: expected a path or an abstract socket; systemd gets no notification", address
            )
            return None
        return cls(address)

    def send(self, *states: str) -> bool:
        """Send states such as "READY=1"; False when they could not be sent."""
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as out:
                out.setblocking(False)
                out.sendto("\n".join(states).encode(), self._address)
        except OSError as error:
            _LOG.debug("systemd did not get %r: %s", states, error)
            return False
        return True


def watchdog_interval(environ: Mapping[str, str]) -> float | None:
    """Seconds within which systemd expects a keep-alive of this process; None when it expects none."""
    if environ.get("WATCHDOG_PID", "") not in ("", str(os.getpid())):
        return None  # for another process, whose environment was inherited
    text = environ.get("WATCHDOG_USEC", "")
    if not text:
        return None
    if not (text.isascii() and text.isdigit()) or int(text) == 0:
        _LOG.warning("WATCHDOG_USEC = %r: expected microseconds above 0; there is no watchdog", text)
        return None
    return int(text) / 1e6


class SystemdLink:
    """Notifies systemd about one kernel, until it closes."""

    def __init__(
        self, kernel: Microkernel, notifier: Notifier, interval: float | None, components: Sequence[Component | str]
    ) -> None:
        self._kernel = kernel
        self._notifier = notifier
        self._interval = interval
        self._tick = _TICK if interval is None else min(_TICK, interval / _SHARE)
        self._names = readiness.names_of(components)
        self._seen: dict[str, tuple[int, float]] = {}
        """By context: its last progress, and the time of that."""
        self._reported: set[str] = set()
        """Contexts that were reported as making no progress."""
        self._status = ""
        self._is_ready = False
        self._handle: asyncio.TimerHandle | None = None
        self._ready = kernel_task(kernel.loop, self._notify_ready(), f"aiorts ready {kernel.name}")
        self._look()

    async def close(self) -> None:
        """Notify systemd that the kernel stops."""
        if self._handle is not None:
            self._handle.cancel()
            self._handle = None
        self._notifier.send("STOPPING=1", f"STATUS={self._kernel.name} stops")
        self._ready.cancel()
        await asyncio.wait([self._ready])

    async def _notify_ready(self) -> None:
        try:
            await readiness.wait_ready(self._kernel, self._names, None)
        except AiortsError:
            return  # it closes
        self._is_ready = True
        self._status = self._make_status()
        self._notifier.send("READY=1", f"STATUS={self._status}")

    def _look(self) -> None:
        self._handle = self._kernel.loop.call_later(self._tick, self._look)
        if self._interval is not None and self._all_get_on(self._interval / 2):
            self._notifier.send("WATCHDOG=1")
        status = self._make_status()
        if status != self._status and self._notifier.send(f"STATUS={status}"):
            self._status = status

    def _all_get_on(self, limit: float) -> bool:
        now = self._kernel.loop.time()
        stuck: dict[str, Context] = {}
        seen: dict[str, tuple[int, float]] = {}
        for name, context in self._kernel.contexts.items():
            if context.runner.current is None:
                continue  # it waits for its next cycle
            did = context.runner.activity()
            before = self._seen.get(name)
            since = before[1] if before is not None and before[0] == did else now
            seen[name] = did, since
            if now - since >= limit:
                stuck[name] = context
        self._seen = seen
        for name in stuck.keys() - self._reported:
            member = stuck[name].runner.current
            who = "a hook" if member is None else f"{member.component.name}.{member.hook}"
            _LOG.warning("%s: %s has run for %.3g s; systemd's watchdog gets no keep-alive", name, who, limit)
        self._reported = set(stuck)
        return not stuck

    def _make_status(self) -> str:
        components = self._kernel.components
        states = [state for component in components.values() for state in component.states.values()]
        active = states.count(LifecycleState.ACTIVE)
        text = f"{active} of {len(states)} active"
        failed = [name for name, component in components.items() if LifecycleState.ERROR in component.states.values()]
        if failed:
            error = components[failed[0]].last_error
            why = "" if error is None else f" ({format_error(error)})"
            text = f"{text}; in error: {', '.join(failed)}{why}"
        elif not self._is_ready:
            text = f"{text}; starting"
        return " ".join(text.split())[:_LONGEST]
