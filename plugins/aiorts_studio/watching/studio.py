"""All that is watched, and the pages that see it."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Mapping, Sequence
from typing import Any, Final

from anyio import to_thread

from aiorts.errors import AiortsError
from aiorts.sessions import Entry, entries
from aiorts_studio.values import json_out
from aiorts_studio.watching.figures import Row, different
from aiorts_studio.watching.page import Page
from aiorts_studio.watching.scene import Scene, View
from aiorts_studio.watching.watch import Watch

PAGES: Final = 16
"""Pages at once."""
_LOOK: Final = 0.5
"""Seconds between looks for kernels that begin: a folder tells nobody what comes into it, and pages are open."""
_DRAW: Final = 0.05
"""Seconds in which changes are gathered before the scene is drawn: 1,000 components come one by one."""
_SETTLES: Final = 1.0
"""Seconds without a change after which a system that has just begun is laid out once more."""
_LATER: Final = 0.3
"""Seconds before a kernel whose session has ended is tried again."""


class Studio:
    """Watches kernels while pages are open; without one it asks nothing of them.

    Args:
        names: names or addresses of the kernels to watch; none is all of this user's, also those that begin later.
    """

    def __init__(self, names: Sequence[str] = ()) -> None:
        self.scene = Scene()
        self.pages: set[Page] = set()
        self.watches: dict[str, Watch] = {}
        self._names = names
        self._waiting = 0
        self._working: asyncio.Task[None] | None = None
        self._running: dict[str, asyncio.Task[None]] = {}
        self._entries: dict[str, Entry] = {}
        self._lasting: dict[str, str] = {}
        self._dirty = asyncio.Event()
        self._fresh = True
        self._quiet_since = time.monotonic()
        self._drawn = asyncio.Event()

    # -- pages -----------------------------------------------------------------------------------------------------

    async def join(self, page: Page) -> None:
        """Have a page told all that is there, and what changes from then on."""
        self._waiting += 1
        if self._working is None:
            self._working = asyncio.create_task(self._work(), name="studio")
            self._drawn.clear()
        try:
            async with asyncio.timeout(_LOOK):  # then it begins with what is there
                await self._drawn.wait()
        except TimeoutError:
            pass
        finally:
            self._waiting -= 1
        self.pages.add(page)
        page.put(self.scene.picture())
        page.look(self.scene.things)

    async def leave(self, page: Page) -> None:
        """Forget a page; with the last one the watching ends."""
        self.pages.discard(page)
        if not self.pages and not self._waiting:
            await self.close()

    async def close(self) -> None:
        """End the watching."""
        working, self._working = self._working, None
        if working is not None:
            working.cancel()
            await asyncio.wait((working,))
        running, self._running = self._running, {}
        for task in running.values():
            task.cancel()
        if running:
            await asyncio.wait(tuple(running.values()))
        self.watches.clear()

    def see(self, page: Page, rect: tuple[float, float, float, float], scale: float) -> None:
        """A page has this in view; it is told its figures at once."""
        if page.is_far != (scale < 0.6):
            page.told["e"].clear()
        page.rect, page.scale = rect, scale
        page.look(self.scene.things)
        for watch in self.watches.values():
            self._tell_figures(watch, (page,))

    def tidy(self) -> None:
        """Lay all out anew."""
        self.scene.tidy()
        self._dirty.set()

    # -- kernels ---------------------------------------------------------------------------------------------------

    async def _work(self) -> None:
        looking = asyncio.create_task(self._look(), name="studio kernels")
        try:
            while True:
                await self._dirty.wait()
                await asyncio.sleep(_DRAW)
                self._dirty.clear()
                change = await self.scene.draw()
                self._drawn.set()
                if change is not None:
                    self._tell(change)
                    for page in self.pages:
                        page.look(self.scene.things)
        finally:
            looking.cancel()

    async def _look(self) -> None:
        while True:
            try:
                found = await to_thread.run_sync(entries)
            except AiortsError:
                found = ()
            for entry in found:
                if not self._names or entry.name in self._names or entry.address in self._names:
                    self._begin(entry)
            if not found:
                self._drawn.set()
            await asyncio.sleep(_LOOK)

    def _begin(self, entry: Entry) -> None:
        """Watch a kernel that is not watched; one that was is known again by its lasting name."""
        key = self._lasting.get(entry.address, entry.address)
        running = self._running.get(key)
        if running is not None and not running.done():
            return
        view = self.scene.views.get(key)
        if view is not None and self.watches[key].entry.epoch == entry.epoch and view.about["state"] == "ended":
            return  # its file is still there, and its process is not
        if view is None:
            host, _, name = entry.address.partition("/")
            about = {
                "name": name, "host": host, "pid": entry.pid, "state": "silent", "why": "", "since_s": 0.0,
                "simulated": False, "round_trip_ms": None,
            }  # fmt: skip
            view = self.scene.views[key] = View(key, entry.address, about)
            self.scene.tidy()
        view.address = entry.address
        view.about["pid"] = entry.pid
        watch = Watch(entry, view, self._dirty.set, self._take_figures, self._take_change)
        self.watches[key] = watch
        self._running[key] = asyncio.create_task(watch.run(), name="studio watch")

    # -- what pages are told ---------------------------------------------------------------------------------------

    def _tell(self, message: Mapping[str, Any]) -> None:
        text = json_out(message).decode() if self.pages else ""
        for page in self.pages:
            page.put(text)

    def _take_change(self, watch: Watch, item: Mapping[str, Any]) -> None:
        """Tell pages of a change of the profile."""

    def _take_figures(self, watch: Watch) -> None:
        self._tell_figures(watch, tuple(self.pages))

    def _tell_figures(self, watch: Watch, pages: Sequence[Page]) -> None:
        """Tell each page the figures that it has in view and was not told."""
        if not pages or not watch.figures.at_ns:
            return
        figures, scene, key = watch.figures, self.scene, watch.view.key
        wanted = frozenset().union(*(page.seen["e"] for page in pages if not page.is_far))
        near: dict[int, Row] = {}
        far: dict[int, Row] = {}
        for name in figures.now["connectors"]:
            number = scene.connectors.get((key, name))
            if number is None:
                continue
            far[number] = [int(figures.is_lossy(name))]
            if number in wanted and (row := figures.edge(name)) is not None:
                near[number] = row
        boxes = self._rows("box", key, figures.now["components"], figures.box)
        frames = self._rows("frame", key, figures.now["contexts"], figures.frame)
        for page in pages:
            message = {
                "e": different(far, page.told["e"], far)
                if page.is_far
                else different(near, page.told["e"], page.seen["e"]),
                "b": different(boxes, page.told["b"], page.seen["b"]),
                "f": different(frames, page.told["f"], frames),
            }
            if any(message.values()):
                page.put({"t": "figures", "at": {watch.view.address: figures.at_ns}, **message})

    def _rows(self, kind: str, key: str, names: Mapping[str, Any], row: Any) -> dict[int, Row]:
        numbers = self.scene.numbers
        return {
            number: found
            for name in names
            if (number := numbers.get((kind, key, name))) is not None and (found := row(name)) is not None
        }
