"""Tells systemd how the process is, when the environment asks for it: ready, alive, stopping, and one line of status.

Alive is said only while every execution context gets on: the message is sent by the event loop itself, so a loop that
is blocked says nothing, and it is not sent while a hook has run for half of the watchdog's time. Everything is a
datagram to the socket in NOTIFY_SOCKET; a message that cannot be sent is given up, nobody waits for systemd.
"""

from __future__ import annotations

import asyncio
import logging
import os
import socket
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Final

from aiorts.errors import AiortsError, said
from aiorts.kernel import readiness
from aiorts.kernel.tasks import kernel_task
from aiorts.model.lifecycle import LifeCycleState

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.context import Context
    from aiorts.kernel.kernel import Kernel

__all__ = ("Notifier", "SystemdLink", "watchdog_interval")

_LOG = logging.getLogger("aiorts.kernel")
_TICK: Final = 1.0
"""Seconds between two looks at the status where there is no watchdog."""
_SHARE: Final = 4
"""Looks in one time of the watchdog: systemd's own advice is two."""
_LONGEST: Final = 300
"""Characters of a status."""


class Notifier:
    """The way to systemd."""

    def __init__(self, address: str) -> None:
        # "@" stands for the zero octet that names of the abstract name space begin with.
        self._address = f"\0{address[1:]}" if address.startswith("@") else address

    @classmethod
    def from_environment(cls, environ: Mapping[str, str]) -> Notifier | None:
        """None when nobody asks to be told, or in a way that is not known here."""
        address = environ.get("NOTIFY_SOCKET", "")
        if not address:
            return None
        if address[0] not in "/@" or len(address) < 2 or not hasattr(socket, "AF_UNIX"):
            _LOG.warning("NOTIFY_SOCKET = %r: expected a path or an abstract socket; systemd is told nothing", address)
            return None
        return cls(address)

    def send(self, *states: str) -> bool:
        """Send states such as "READY=1"; False when they could not be sent."""
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as out:
                out.setblocking(False)
                out.sendto("\n".join(states).encode(), self._address)
        except OSError as error:
            _LOG.debug("systemd was not told %r: %s", states, error)
            return False
        return True


def watchdog_interval(environ: Mapping[str, str]) -> float | None:
    """Seconds within which systemd wants a sign of life of this process; None when it wants none."""
    if environ.get("WATCHDOG_PID", "") not in ("", str(os.getpid())):
        return None  # asked of another process, from which the environment was inherited
    text = environ.get("WATCHDOG_USEC", "")
    if not text:
        return None
    if not (text.isascii() and text.isdigit()) or int(text) == 0:
        _LOG.warning("WATCHDOG_USEC = %r: expected microseconds above 0; there is no watchdog", text)
        return None
    return int(text) / 1e6


class SystemdLink:
    """Tells systemd about one kernel, until it closes."""

    def __init__(
        self, kernel: Kernel, notifier: Notifier, interval: float | None, components: Sequence[Component | str]
    ) -> None:
        self._kernel = kernel
        self._notifier = notifier
        self._interval = interval
        self._tick = _TICK if interval is None else min(_TICK, interval / _SHARE)
        self._names = readiness.names_of(components)
        self._seen: dict[str, tuple[int, float]] = {}
        """By context: what it did last, and since when."""
        self._told: set[str] = set()
        """Contexts that do not get on."""
        self._status = ""
        self._is_ready = False
        self._handle: asyncio.TimerHandle | None = None
        self._ready = kernel_task(kernel.loop, self._tell_ready(), f"aiorts ready {kernel.name}")
        self._look()

    async def close(self) -> None:
        """The kernel stops."""
        if self._handle is not None:
            self._handle.cancel()
            self._handle = None
        self._notifier.send("STOPPING=1", f"STATUS={self._kernel.name} stops")
        self._ready.cancel()
        await asyncio.wait([self._ready])

    async def _tell_ready(self) -> None:
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
        for name, context in self._kernel._contexts.items():
            driver = context._driver
            if driver is None or driver.current is None:
                continue  # it waits for its next cycle
            did = context._activity()
            before = self._seen.get(name)
            since = before[1] if before is not None and before[0] == did else now
            seen[name] = did, since
            if now - since >= limit:
                stuck[name] = context
        self._seen = seen
        for name in stuck.keys() - self._told:
            driver = stuck[name]._driver
            member = None if driver is None else driver.current
            who = "a hook" if member is None else f"{member.component.name}.{member.hook}"
            _LOG.warning("%s: %s has run for %.3g s; systemd's watchdog is not answered", name, who, limit)
        self._told = set(stuck)
        return not stuck

    def _make_status(self) -> str:
        components = self._kernel.components
        states = [state for component in components.values() for state in component.states.values()]
        active = states.count(LifeCycleState.ACTIVE)
        text = f"{active} of {len(states)} active"
        failed = [name for name, component in components.items() if LifeCycleState.ERROR in component.states.values()]
        if failed:
            error = components[failed[0]].last_error
            why = "" if error is None else f" ({said(error)})"
            text = f"{text}; in error: {', '.join(failed)}{why}"
        elif not self._is_ready:
            text = f"{text}; starting"
        return " ".join(text.split())[:_LONGEST]
