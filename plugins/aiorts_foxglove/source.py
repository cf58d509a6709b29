"""The view of one kernel for all viewers: the ports that run, and the samples of those that are watched."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine, Mapping
from typing import Any, Final, Protocol

from aiorts.errors import AiortsError, ClosedError
from aiorts.sessions import END, AsyncClient
from aiorts_foxglove.channels import Kind

_EVENTS: Final = ("ComponentAdded", "ComponentRemoved", "PortAdded", "PortRemoved")
_TICK: Final = 0.25
"""Seconds between looks at the kernel's clock."""
_SILENCE: Final = 2.0
"""Seconds without an answer after which the viewers are informed."""


class Audience(Protocol):
    """The receiver of everything that a `Source` sees."""

    def ports(self, found: Mapping[str, Kind]) -> None:
        """The out-ports that run now."""

    def sample(self, port: str, time_ns: int, payload: bytes) -> None:
        """A sample of a port that is watched: the kernel's time, and JSON."""

    def lost(self, port: str, count: int) -> None:
        """Samples of a port that were dropped before they came here, or that cannot be shown."""

    def time(self, time_ns: int) -> None:
        """The kernel's clock."""

    def trouble(self, about: str, text: str) -> None:
        """The trouble with a port, or with the kernel (""); an empty text ends it."""


class Source:
    """Looks into a kernel until it ends.

    Args:
        client: the session with it.
        audience: called with all that is seen.
    """

    def __init__(self, client: AsyncClient, audience: Audience) -> None:
        self._client = client
        self._audience = audience
        self._tasks = asyncio.TaskGroup()
        self._running = False
        self._watched: frozenset[str] = frozenset()
        self._kinds: dict[str, Kind] = {}
        """The kinds of the ports that run, by path."""
        self._taps: dict[str, tuple[asyncio.Task[None], Kind]] = {}
        self._refused: set[str] = set()
        """Watched ports that cannot be tapped; tried again after the next look at what runs."""
        self._outdated = asyncio.Event()
        """Set when the ports that run have to be asked for again."""

    async def run(self) -> str:
        """Follow the kernel until it ends; return the reason for its end."""
        why: list[str] = []
        try:
            async with self._tasks:
                self._running = True
                for look in (self._look(), self._follow_events(), self._follow_time()):
                    self._begin(look)
        except* AiortsError as group:
            why = [str(one) for one in group.exceptions]
        finally:
            self._running = False
        return why[0]

    def watch(self, ports: frozenset[str]) -> None:
        """Take samples of these ports and no others."""
        self._watched = ports
        self._tap_watched()

    def _begin(self, what: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
        return self._tasks.create_task(what, name="aiorts foxglove")

    def _tap_watched(self) -> None:
        """Tap the watched ports, and no others."""
        if not self._running:
            return
        for port, (task, kind) in tuple(self._taps.items()):
            if port not in self._watched or self._kinds.get(port) != kind:
                del self._taps[port]
                task.cancel()
        self._refused &= self._watched
        for port in sorted((self._watched & self._kinds.keys()) - self._taps.keys() - self._refused):
            kind = self._kinds[port]
            self._taps[port] = self._begin(self._tap(port, kind)), kind

    async def _tap(self, port: str, kind: Kind) -> None:
        try:
            async with self._client.stream("tap", port=port, frames=kind.cls is not None) as tap:
                while (item := await tap.next()) is not END:
                    missed, tap.missed = tap.missed, 0
                    try:
                        self._audience.sample(port, int(item["time_ns"]), kind.payload(item))
                    except (AiortsError, ValueError) as error:
                        missed += 1
                        self._audience.trouble(port, f"samples that cannot be shown: {error}")
                    if missed:
                        self._audience.lost(port, missed)
                    await asyncio.sleep(0)  # between items: many that have come at once would hold viewers up
        except ClosedError:
            raise
        except AiortsError as error:
            self._audience.trouble(port, str(error))
        else:
            self._outdated.set()  # its port has gone; one with its name may be there already
        self._refused.add(port)
        del self._taps[port]

    async def _follow_events(self) -> None:
        async with self._client.stream("events", kinds=_EVENTS) as events:
            self._outdated.set()  # ports that ran before are asked for once no event can be missed
            async for _ in events:
                self._outdated.set()
        raise ClosedError(f"{self._client.entry.name}: has ended")

    async def _follow_time(self) -> None:
        while True:
            now = await self._asked("statistics", connectors=[], contexts=[], components=[])
            self._audience.time(int(now["time_ns"]))
            await asyncio.sleep(_TICK)

    async def _look(self) -> None:
        """Ask for the ports that run, now and each time that the answer is outdated."""
        while True:
            await self._outdated.wait()
            self._outdated.clear()
            found = await self._asked("outline")
            self._kinds = {
                f"{component}.{name}": self._known(f"{component}.{name}", port["full_type"])
                for component, outline in found.items()
                for name, port in outline["ports"].items()
                if port["direction"] == "out"
            }
            self._refused.clear()
            self._audience.ports(dict(self._kinds))
            self._tap_watched()

    async def _asked(self, operation: str, **arguments: object) -> Any:
        """The kernel's answer, however long it takes; viewers are informed when it takes long."""
        loop = asyncio.get_running_loop()
        silent = loop.call_later(_SILENCE, lambda: self._audience.trouble("", self._client.silence))
        try:
            return await self._client.call(operation, None, **arguments)
        finally:
            silent.cancel()
            self._audience.trouble("", "")

    def _known(self, port: str, name: str) -> Kind:
        kind = self._kinds.get(port)
        return kind if kind is not None and kind.name == name else Kind.of(name)
