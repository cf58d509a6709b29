"""The clients of a kernel: the number of connections and calls of each, and the recent time of its calls.

A client is a process of this host, or the name of a client of another host, with its right. Some connections are
reserved for clients that may do more than look: clients that only look never have all of them.
"""

from __future__ import annotations

import threading
import time
from typing import Final

from aiorts.control.operation import Right
from aiorts.errors import BusyError

CONNECTIONS: Final = 256
"""The most connections of all clients together."""
LOOKING: Final = 192
"""The most connections of all clients together that may only look."""
OF_ONE: Final = {Right.VIEW: 16, Right.OPERATE: 128, Right.CODE: 128}
"""The most connections of one client, by its right."""
CALLS: Final = {Right.VIEW: 256, Right.OPERATE: 1_024, Right.CODE: 1_024}
"""The most calls of one client that lack their last answer, by the right that the kernel allows the client."""
_KNOWN: Final = 1_024
"""The most clients that are remembered, connected or not."""


class FullError(BusyError):
    """One client has all the connections that it may have."""


class Client:
    """One client of a kernel."""

    def __init__(self, name: str, right: Right) -> None:
        self.name = name
        self.right = right
        self.connections = 0
        self.calls = 0
        """Calls without their last answer."""
        self._used = 0.0
        self._used_at = time.monotonic()

    def used(self, now: float) -> float:
        """Recent seconds of loop and thread that the client's calls took; the value halves each second."""
        return float(self._used * 0.5 ** (now - self._used_at))

    def use(self, seconds: float) -> None:
        """Add the seconds that calls of the client took."""
        now = time.monotonic()
        self._used, self._used_at = self.used(now) + seconds, now

    def check_calls(self, what: str, allowed: Right) -> None:
        """Raise BusyError unless the client may have another call; `allowed` is the right that the kernel allows it."""
        # The allowed right counts, not the wanted one: a recording wants only "view", but taps 450 ports.
        most = CALLS[allowed]
        if self.calls >= most:
            raise BusyError(f"{what}: {most} calls of {self.name} wait already; wait for their answers")


class Clients:
    """The clients of one kernel; called from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._known: dict[tuple[str, Right], Client] = {}
        self._connections = self._looking = 0

    def connect(self, name: str, right: Right) -> Client:
        """Count a new connection; returns its client.

        Raises:
            FullError: the client has all its connections. BusyError: all clients together have all of theirs.
        """
        with self._lock:
            return self._connect(name, right)

    def lower(self, client: Client, right: Right) -> Client:
        """Count a connection for the client's name with the lower right that hello wants; errors as `connect`."""
        with self._lock:
            self._count(client, -1)
            try:
                return self._connect(client.name, right)
            except BusyError:
                self._count(client, 1)
                raise

    def disconnect(self, client: Client) -> None:
        """Count a connection that has ended."""
        with self._lock:
            self._count(client, -1)

    def _connect(self, name: str, right: Right) -> Client:
        client = self._known.get((name, right)) or Client(name, right)
        if client.connections >= OF_ONE[right]:
            raise FullError(f"{name} has {OF_ONE[right]} connections with this kernel already; end one of them")
        if right is Right.VIEW and self._looking >= LOOKING:
            raise BusyError(f"{LOOKING} clients look into this kernel already; the rest is for those who operate it")
        if self._connections >= CONNECTIONS:
            raise BusyError(f"{CONNECTIONS} clients are connected with this kernel already; end one of them")
        self._count(client, 1)
        self._keep(client)
        return client

    def _count(self, client: Client, connections: int) -> None:
        client.connections += connections
        self._connections += connections
        self._looking += connections * (client.right is Right.VIEW)

    def _keep(self, client: Client) -> None:
        """Keep a client and the recent time of its calls, also after its end, as long as there is room."""
        key = client.name, client.right
        if key not in self._known and len(self._known) >= _KNOWN:
            self._known = {key: one for key, one in self._known.items() if one.connections}
        self._known[key] = client
