"""A thread that looks into one kernel for all viewers: which ports run, and the samples of those that are watched."""

from __future__ import annotations

import select
import socket
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Final, Protocol

from aiorts.errors import AiortsError, ClosedError
from aiorts.sessions import END, Client, Stream
from aiorts_foxglove.channels import Kind

_EVENTS: Final = ("ComponentAdded", "ComponentRemoved", "PortAdded", "PortRemoved")
_TICK: Final = 0.25
"""Seconds between looks at the kernel's clock."""
_SILENCE: Final = 2.0
"""Seconds without an answer after which the viewers are informed."""
_BATCHES: Final = 4
"""That may wait for the event loop; the kernel counts what then finds no place."""


@dataclass(slots=True)
class Batch:
    """What came at once."""

    samples: list[tuple[str, int, bytes]] = field(default_factory=list)
    """Port, the kernel's time, JSON."""
    missed: dict[str, int] = field(default_factory=dict)
    """By port, samples that were dropped before they came here, or that cannot be shown."""
    unfit: dict[str, str] = field(default_factory=dict)
    """By port, why the last one cannot be shown."""


class Audience(Protocol):
    """Who is called with what was seen; each call is made in the event loop."""

    def ports(self, found: Mapping[str, Kind]) -> None:
        """The out-ports that run now."""

    def samples(self, batch: Batch) -> None:
        """Samples of ports that are watched."""

    def time(self, time_ns: int) -> None:
        """The kernel's clock."""

    def trouble(self, about: str, text: str) -> None:
        """What is wrong with a port, or with the kernel (""); an empty text ends it."""

    def ended(self, why: str) -> None:
        """The session is over: nothing else is called any more."""


class Source(threading.Thread):
    """Looks into a kernel until it ends or is closed.

    Args:
        client: the session with it; it belongs to this thread from then on.
        audience: who is called.
        post: has a function called in the event loop, as `call_soon_threadsafe`.
    """

    def __init__(self, client: Client, audience: Audience, post: Callable[..., object]) -> None:
        super().__init__(name="aiorts foxglove", daemon=True)
        self._client = client
        self._audience = audience
        self._post = post
        self._closing = False
        self._watched: frozenset[str] = frozenset()
        self._room = threading.Semaphore(_BATCHES)
        self._ours, self._theirs = socket.socketpair()
        self._ours.setblocking(False)
        self._theirs.setblocking(False)
        self._kinds: dict[str, Kind] = {}
        """Of the ports that run."""
        self._taps: dict[str, tuple[Stream, Kind]] = {}
        self._refused: set[str] = set()
        """Ports that were watched in vain; tried again when it is known anew what runs."""
        self._asked: dict[str, tuple[int, float]] = {}
        """Calls that wait for their answer: number, and since when."""
        self._outdated = False
        """Whether what runs is to be asked for again after the answer that is under way."""
        self._silent = False
        self._ticked = 0.0

    # -- called from the event loop --------------------------------------------------------------------------------

    def watch(self, ports: frozenset[str]) -> None:
        """Take samples of these ports and no others."""
        if ports != self._watched:
            self._watched = ports
            self._wake()

    def close(self) -> None:
        """End it; `ended` is not called any more."""
        self._closing = True
        self._wake()

    def _wake(self) -> None:
        with suppress(OSError):  # it has been woken and not seen yet, or is over
            self._theirs.send(b"\0")

    # -- the thread ------------------------------------------------------------------------------------------------

    def run(self) -> None:
        """See the class."""
        why = "cannot be shown any more, by a mistake in aiorts foxglove"  # whose traceback the thread prints
        try:
            with self._client as client:
                events = client.stream("events", kinds=_EVENTS)
                self._ask("outline")
                while not self._closing:
                    self._follow()
                    if not self._taken(events):
                        self._wait()
                    self._tick()
        except AiortsError as error:
            why = str(error)
        finally:
            self._ours.close()
            self._theirs.close()
            self._tell(self._audience.ended, why)

    def _tell(self, call: Callable[..., None], *arguments: object) -> None:
        if not self._closing:
            try:
                self._post(self._call, call, arguments)
            except RuntimeError:
                self._closing = True  # the event loop is over

    def _call(self, call: Callable[..., None], arguments: tuple[object, ...]) -> None:
        if not self._closing:
            call(*arguments)

    def _follow(self) -> None:
        """Tap what is watched, and no more."""
        watched = self._watched
        for port in [port for port, (_, kind) in self._taps.items() if self._kinds.get(port) != kind]:
            self._taps.pop(port)[0].close()
        for port in self._taps.keys() - watched:
            self._taps.pop(port)[0].close()
        self._refused &= watched
        for port in sorted((watched & self._kinds.keys()) - self._taps.keys() - self._refused):
            kind = self._kinds[port]
            try:
                self._taps[port] = self._client.stream("tap", port=port, frames=kind.cls is not None), kind
            except ClosedError:
                raise
            except AiortsError as error:
                self._refused.add(port)
                self._tell(self._audience.trouble, port, str(error))

    def _wait(self) -> None:
        woken, kernel = self._ours.fileno(), self._client.fileno()
        ready, _, _ = select.select([woken, kernel], [], [], _TICK)
        if woken in ready:
            self._ours.recv(4096)
        if kernel in ready:
            self._client.read()

    def _taken(self, events: Stream) -> bool:
        """Whether anything had come; takes all of it."""
        happened = events.take(0.0)
        if happened:
            if happened[-1] is END:
                raise ClosedError(f"{self._client.entry.name}: has ended")
            self._look()
        batch = Batch()
        for port, (tap, kind) in tuple(self._taps.items()):
            self._take(port, tap, kind, batch)
        if batch.samples or batch.missed:
            self._hand_over(batch)
        return bool(happened or batch.samples or batch.missed)

    def _take(self, port: str, tap: Stream, kind: Kind, batch: Batch) -> None:
        try:
            items: list[Any] = tap.take(0.0)
        except ClosedError:
            raise
        except AiortsError as error:
            items = [END]
            self._tell(self._audience.trouble, port, str(error))
        if tap.missed:
            batch.missed[port], tap.missed = tap.missed, 0
        if items and items[-1] is END:  # its port has gone; one with its name may be there already
            items.pop()
            del self._taps[port]
            self._refused.add(port)
            self._look()
        for item in items:
            try:
                batch.samples.append((port, int(item["time_ns"]), kind.payload(item)))
            except (AiortsError, ValueError) as error:
                batch.missed[port] = batch.missed.get(port, 0) + 1
                batch.unfit[port] = str(error)

    def _hand_over(self, batch: Batch) -> None:
        while not self._room.acquire(timeout=_TICK):
            if self._closing:
                return
        self._tell(self._handed_over, batch)

    def _handed_over(self, batch: Batch) -> None:
        self._room.release()
        self._audience.samples(batch)

    # -- calls that nothing waits for ------------------------------------------------------------------------------

    def _look(self) -> None:
        """Ask what runs; where that is under way already, once more after it."""
        if "outline" in self._asked:
            self._outdated = True
        else:
            self._ask("outline")

    def _ask(self, operation: str, **arguments: object) -> None:
        self._asked[operation] = self._client.begin(operation, **arguments), time.monotonic()

    def _tick(self) -> None:
        """Take answers, ask for the time when it is due, and tell when the kernel is silent."""
        now = time.monotonic()
        for operation, (number, _) in tuple(self._asked.items()):
            if self._client.answered(number):
                del self._asked[operation]
                self._answer(operation, self._client.result(number, 0.0))
        if now - self._ticked >= _TICK and "statistics" not in self._asked:
            self._ticked = now
            self._ask("statistics", connectors=[], contexts=[], components=[])
        silent = any(now - since >= _SILENCE for _, since in self._asked.values())
        if silent != self._silent:
            self._silent = silent
            self._tell(self._audience.trouble, "", self._client.silence if silent else "")

    def _answer(self, operation: str, found: Any) -> None:
        if operation == "statistics":
            self._tell(self._audience.time, int(found["time_ns"]))
            return
        self._kinds = {
            f"{component}.{name}": self._known(f"{component}.{name}", port["full_type"])
            for component, outline in found.items()
            for name, port in outline["ports"].items()
            if port["direction"] == "out"
        }
        self._refused.clear()
        self._tell(self._audience.ports, dict(self._kinds))
        if self._outdated:
            self._outdated = False
            self._ask("outline")

    def _known(self, port: str, name: str) -> Kind:
        kind = self._kinds.get(port)
        return kind if kind is not None and kind.name == name else Kind.of(name)
