"""Feeds of a page: lines of the log and events of kernels.

A feed runs in each session with a kernel that it is about, and again after a restart. It never sends more than a page
can show: items beyond that are counted.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from aiorts.errors import AiortsError
from aiorts.sessions import END, AsyncStream
from aiorts_studio.watching.page import Page
from aiorts_studio.watching.words import event_said

if TYPE_CHECKING:
    from aiorts_studio.watching.watch import Watch

GATHER: Final = 0.1
"""Seconds over which lines and events are gathered into one message."""
MOST: Final = 200
"""Lines, or events, of one message: 2,000 a second are more than a user reads."""


class Feed:
    """A feed of one page.

    Args:
        page: the page that gets the items.
        kernel: the address of the kernel; "" is all.
    """

    def __init__(self, page: Page, kernel: str = "") -> None:
        self.page = page
        self.kernel = kernel

    async def run(self, watch: Watch) -> None:
        """Follow one kernel until its session ends, or the feed does."""
        try:
            await self.follow(watch)
        except AiortsError as error:
            self.failed(error)

    async def follow(self, watch: Watch) -> None:
        """Follow one kernel; AiortsError: it refuses, or has ended."""
        raise NotImplementedError

    def failed(self, error: AiortsError) -> None:
        """Tell the page that the kernel refuses; the end of a kernel is told elsewhere."""


class LogFeed(Feed):
    """Lines of the log.

    Args:
        level: the lowest level.
        component: its name; "" is all, and the kernel's own lines.
    """

    def __init__(self, page: Page, kernel: str, level: str, component: str) -> None:
        super().__init__(page, kernel)
        self._level, self._component = level.lower() or "info", component

    async def follow(self, watch: Watch) -> None:
        """Send the last lines, then those that come."""
        if self._component and self._component not in watch.view.components:
            return
        address = watch.view.address
        components = [self._component] if self._component else []
        async with watch.session.stream("log", level=self._level, components=components, follow=True) as stream:
            self._tell(address, stream.began[-MOST:], 0)
            async for lines, missed in gathered(stream):
                self._tell(address, lines, missed)

    def _tell(self, address: str, lines: Sequence[Mapping[str, Any]], missed: int) -> None:
        told = [
            {
                "kernel": address,
                "at_ns": line["time_ns"],
                "level": line["level"].upper(),
                "component": line["component"],
                "text": line["text"],
                "hook": line["hook"],
            }
            for line in lines
        ]
        self.page.put({"t": "log", "lines": told, "missed": missed})


class EventFeed(Feed):
    """Events of the bus."""

    async def follow(self, watch: Watch) -> None:
        """Send the events that come."""
        address = watch.view.address
        async with watch.session.stream("events") as stream:
            async for events, missed in gathered(stream):
                items = [happening(address, one["kind"], one["event"], one["time_ns"]) for one in events]
                self.page.put({"t": "event", "items": items, "missed": missed})


async def gathered(stream: AsyncStream) -> AsyncIterator[tuple[list[Any], int]]:
    """The items of a stream as lists of a tenth of a second, and how many are missing before each list."""
    counted = 0
    while (first := await stream.next()) is not END:
        items, beyond = [first], 0
        until = asyncio.get_running_loop().time() + GATHER
        while (left := until - asyncio.get_running_loop().time()) > 0:
            try:
                async with asyncio.timeout(left):
                    item = await stream.next()
            except TimeoutError:
                break
            if item is END:
                break
            if len(items) < MOST:
                items.append(item)
            else:
                beyond += 1
        missed, counted = stream.missed - counted + beyond, stream.missed
        yield items, missed


def happening(address: str, kind: str, event: Mapping[str, Any], time_ns: int) -> dict[str, Any]:
    """An event as the page has it."""
    component = event.get("component") or str(event.get("path") or event.get("port") or "").partition(".")[0]
    where = {"kernel": address, "component": component, "context": event.get("context") or ""}
    return {**where, "at_ns": time_ns, "kind": kind, "text": event_said(event)[:300]}
