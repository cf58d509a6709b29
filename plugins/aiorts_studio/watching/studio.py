"""All that is watched, and the pages that see it."""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import AsyncIterator, Callable, Collection, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any, Final

from anyio import to_thread

from aiorts.errors import AiortsError, NoAnswerError
from aiorts.layout import Places
from aiorts.sessions import AsyncClient, Entry, entries
from aiorts_studio.plain.problems import problem_of
from aiorts_studio.plain.values import json_out
from aiorts_studio.watching.ages import Ages
from aiorts_studio.watching.feeds import EventFeed, happening
from aiorts_studio.watching.figures import Row, different
from aiorts_studio.watching.page import FAR, Page
from aiorts_studio.watching.places import PlaceFiles
from aiorts_studio.watching.plots import Shown, Tap
from aiorts_studio.watching.recording import Recorder
from aiorts_studio.watching.scene import Scene
from aiorts_studio.watching.totals import folded_row, total_of
from aiorts_studio.watching.view import View, about
from aiorts_studio.watching.watch import ENDED, Follower, Watch, begun

_LOOK: Final = 0.5
"""Seconds between looks for kernels that begin: a folder does not tell what comes into it, and a page is open."""
_DRAW: Final = 0.05
"""Seconds in which changes are gathered before the scene is drawn: 1,000 components come one by one."""
_SAID: Final = {"live": "KernelAnswers", "silent": "KernelSilent", "ended": "KernelEnded"}
"""The kinds of events that the page makes of the states of kernels."""
_SETTLES: Final = 0.5
"""Seconds without a change after which a kernel that has just begun is laid out again."""
_SETTLING: Final = 10
"""The most looks whether a kernel that has just begun is assembled."""
_KEEP: Final = 1.0
"""Seconds after a change until places are written: many come one after the other."""
_MANY: Final = 100
"""Components of a kernel from which on its sums are not made at each look."""
_SUM_UP: Final = 900_000_000
"""Nanoseconds of a kernel's clock for which its sums are good."""
_OPEN: Final = 3.0
_AGAIN: Final = 1.0
"""Seconds until a kernel that refuses is asked again."""
_MINUTE: Final = 60 * 10**9
_KEPT: Final = 500
"""Changes of the last minute that are kept."""
_NO_FILES: Final = "recordings need a server beside this one: `aiorts studio --files FOLDER`, while the system runs"
_FORGOTTEN: Final = 60.0
"""Seconds for which a kernel that has ended is shown."""


class Studio:
    """Watches kernels while pages are open; without one it asks nothing of them.

    Args:
        names: names or addresses of the kernels to watch; none is all of this user, also those that begin later.
        files: the folder where recordings go; None: nothing is recorded, and pages are told why.
        places: files with the places of boxes; None: places last as long as this object.

    Attributes:
        scene: the scene that pages show.
        pages: the pages that are open.
        recorder: makes the recordings that pages ask for.
    """

    def __init__(
        self,
        names: Sequence[str] = (),
        files: Path | None = None,
        why_no_files: str = _NO_FILES,
        places: PlaceFiles | None = None,
    ) -> None:
        self.scene = Scene()
        self.pages: set[Page] = set()
        self.recorder = Recorder(files, why_no_files, self._tell)
        self._coming = 0
        self._names = names
        self._working: asyncio.Task[None] | None = None
        self._sessions: dict[str, asyncio.Task[None]] = {}
        """The watching task of each kernel, by its epoch; done where it has ended, and its file is still there."""
        self._watches: dict[str, Watch] = {}
        """The watches, by the key of the view; for a kernel that has ended, its last one."""
        self._ages = Ages(self._refused)
        self._followers: dict[Follower, None] = {self._ages: None}
        self._taps: dict[tuple[str, str], Tap] = {}
        self._history: deque[dict[str, Any]] = deque(maxlen=_KEPT)
        self._keeps = False
        self._totals: dict[str, tuple[int, dict[int, Row]]] = {}
        """By the key of the view: the time of the last sums, and the sums."""
        self._dirty, self._drawn = asyncio.Event(), asyncio.Event()
        self._unwritten = asyncio.Event()
        self._places = places
        self._written: dict[str, Places] = {}
        """By the key of the view: the places that were read, or written last."""
        self._placed: set[str] = set()
        """The keys of the views whose boxes a user has placed."""
        self._attended, self._deserted = asyncio.Event(), asyncio.Event()
        self._deserted.set()

    # -- pages -----------------------------------------------------------------------------------------------------

    async def join(self, page: Page) -> None:
        """Tell a page all that is there, and each change from then on."""
        self._coming += 1
        self._begin()
        try:
            with suppress(TimeoutError):  # then it begins with the scene as it is
                async with asyncio.timeout(_LOOK):
                    await self._drawn.wait()
        finally:
            self._coming -= 1
        self.pages.add(page)
        self._attended.set()
        self._deserted.clear()
        page.put(self.scene.picture())
        page.put(self.recorder.state())
        page.look(self.scene.things)

    async def leave(self, page: Page) -> None:
        """Forget a page; with the last one the watching ends."""
        self.pages.discard(page)
        self._ages.leave(page)
        if not self.pages:
            self._attended.clear()
            self._deserted.set()
        if not self.pages and not self._coming:
            await self.close()

    def _begin(self) -> None:
        if self._working is None:
            self._drawn.clear()
            self._working = begun(self._work(), "studio")

    @asynccontextmanager
    async def watching(self) -> AsyncIterator[None]:
        """Watch without a page, too, and forget nothing, for as long as the block takes."""
        self._coming += 1
        self._keeps = True
        self._begin()
        try:
            yield
        finally:
            self._coming -= 1
            self._keeps = False

    async def unattended(self, first: float, again: float) -> None:
        """Wait until no page has been open for so many seconds.

        Args:
            first: the seconds while none has been open.
            again: the seconds after the last was closed.
        """
        patience = again if self.pages else first
        while True:
            await self._deserted.wait()
            try:
                async with asyncio.timeout(patience):
                    await self._attended.wait()
            except TimeoutError:
                return
            patience = again

    def say_ended(self, why: str) -> None:
        """Tell that the watched kernels have ended, and how."""
        for view in self.scene.views.values():
            if view.say("ended", why):
                self.state_changed(view)
                self.changed()

    async def close(self) -> None:
        """End the watching."""
        tasks = [*self._sessions.values(), *([self._working] if self._working is not None else [])]
        self._working = None
        self._sessions = {}
        for task in tasks:
            task.cancel()
        self._watches = {}
        if tasks:
            await asyncio.wait(tasks)
        await self._write_places()
        await self.recorder.close()  # takes its time: a page that comes meanwhile begins a new watching

    def see(self, page: Page, rect: tuple[float, float, float, float], scale: float) -> None:
        """Note the part that a page has in view, and send it the figures of that part at once."""
        if page.is_far != (scale < FAR):
            page.told["e"].clear()
        page.rect, page.scale = rect, scale
        page.look(self.scene.things)
        for watch in self._watches.values():
            self._tell_figures(watch, (page,))

    # -- what pages ask for ----------------------------------------------------------------------------------------

    def follow(self, one: Follower) -> None:
        """Start a follower at the kernels that it is about, now and when they begin."""
        self._followers[one] = None
        for watch in self._watches.values():
            watch.start(one)

    def unfollow(self, one: Follower) -> None:
        """End a follower."""
        if one in self._followers:
            del self._followers[one]
            for watch in self._watches.values():
                watch.stop(one)

    def measure(self, page: Page, edges: Collection[int], *, on: bool) -> None:
        """Begin or end to measure the ages of samples on edges for a page; BusyError: there are too many."""
        connectors = self.scene.connectors.items()
        wires = [(key, name) for key, names in connectors for name, number in names.items() if number in edges]
        self._ages.ask(page, wires, on=on)

    def _refused(self, error: AiortsError) -> None:
        self._tell({"t": "problem", "problem": problem_of(error)})

    def show(self, kernel: str, path: str, shown: Shown) -> None:
        """Show a page the values of a port; AbsentError: there is no such port."""
        tap = self._taps.get((kernel, path))
        if tap is not None:
            tap.shown.append(shown)
            if tap.failed is not None:
                shown.fail(tap.failed)
            return
        self.scene.check_port(kernel, path)
        tap = self._taps[kernel, path] = Tap(kernel, path)
        tap.shown.append(shown)
        self.follow(tap)

    def hide(self, kernel: str, path: str, shown: Shown) -> None:
        """Show a page the values of a port no longer."""
        shown.close()
        tap = self._taps.get((kernel, path))
        if tap is not None and shown in tap.shown:
            tap.shown.remove(shown)
            if not tap.shown:
                del self._taps[kernel, path]
                self.unfollow(tap)

    # -- kernels ---------------------------------------------------------------------------------------------------

    async def _work(self) -> None:
        looking = begun(self._look(), "studio kernels")
        keeping = begun(self._keep_places(), "studio places")
        try:
            while True:
                await self._dirty.wait()
                await asyncio.sleep(_DRAW)
                self._dirty.clear()
                drawing = begun(self._draw(), "studio scene")
                try:
                    await asyncio.wait((drawing,))
                finally:
                    drawing.cancel()
                if drawing.exception() is not None:
                    self.scene.lay_out()  # with the next change
        finally:
            looking.cancel()
            keeping.cancel()

    async def _draw(self) -> None:
        change = await self.scene.draw()
        self._totals.clear()  # they name boxes
        self._drawn.set()
        self._unwritten.set()
        if change is not None:
            self._tell(change)
            for page in self.pages:
                for box in change.get("boxes", ()):
                    page.told["b"].pop(box["id"], None)  # the box that is new has no row
                page.look(self.scene.things)

    async def _look(self) -> None:
        while True:
            found: Sequence[Entry] = ()
            with suppress(AiortsError):  # the folder is not safe: nothing in it is watched
                found = await to_thread.run_sync(entries)
            wanted = [one for one in found if not self._names or one.name in self._names or one.address in self._names]
            for entry in wanted:
                if entry.epoch not in self._sessions:
                    self._sessions[entry.epoch] = begun(self._watch(entry), "studio watch")
            self._sessions = {epoch: one for epoch, one in self._sessions.items() if not one.done()}
            self._end({one.address for one in wanted})
            self._forget()
            if not wanted:
                self._drawn.set()
            await asyncio.sleep(_LOOK)

    async def _watch(self, entry: Entry) -> None:
        """Watch one kernel until it ends; one that does not answer is tried again and again."""
        while True:
            try:
                client = await AsyncClient.open(entry, timeout=_OPEN, who="aiorts studio", right="view")
            except NoAnswerError as error:
                self._view(entry, "").say("silent", str(error))
                self.changed()
                continue
            except AiortsError:
                await asyncio.sleep(_AGAIN)
                return  # it has just ended, or has too many clients: if it is still there, it is tried again
            view = self._view(entry, client.hello["lasting"])
            await self._read_places(view)
            watch = self._watches[view.key] = Watch(client, view, self, self._followers)
            settling = asyncio.create_task(self._settle(client, view), name="studio layout")
            try:
                await _take_links(client, view)
                await watch.run()
            finally:
                settling.cancel()
                await client.aclose()
            return

    def _view(self, entry: Entry, lasting: str) -> View:
        """The view of a kernel; the view from before a restart, where it is the same kernel again."""
        views = self.scene.views
        view = views.get(entry.address)
        for one in views.values():
            if view is None and lasting and one.lasting == lasting and one.about["state"] == "ended":
                view = one
        if view is None:
            view = views[entry.address] = View(entry.address, entry.address, about(entry))
        view.address, view.lasting = entry.address, lasting or view.lasting
        view.about.update(name=entry.name, pid=entry.pid)
        return view

    async def _settle(self, client: AsyncClient, view: View) -> None:
        """Lay out a kernel that has just begun again when it is assembled: boxes that came one by one stand in a row.

        Only the boxes, their contexts and the number of edges count, and only for a while: later nothing moves without
        a request.
        """
        for _ in range(_SETTLING):
            if view.settled:
                return
            count = view.shape
            await asyncio.sleep(_SETTLES)
            if view.shape == count and view.components and "" not in view.shape[1]:
                break
        view.settled = True
        await _take_links(client, view)
        if self.scene.laid_out.get(view.key) != view.shape:
            self.scene.lay_out()
        self.changed()

    def _end(self, there: Collection[str]) -> None:
        """Tell pages of the kernels that ended while no page was open."""
        for view in self.scene.views.values():
            watch = self._watches.get(view.key)
            is_watched = watch is not None and watch.session.is_open
            is_known = view.about["state"] == "ended" or view.address in there or is_watched
            if not is_known and view.say("ended", ENDED):
                self.state_changed(view)
                self.changed()

    def _forget(self) -> None:
        """Forget kernels that ended long ago."""
        now = time.monotonic()
        for key, view in list(self.scene.views.items()):
            if not self._keeps and view.about["state"] == "ended" and now > view.answered + _FORGOTTEN:
                del self.scene.views[key]
                self._written.pop(key, None)
                self._placed.discard(key)
                self._watches.pop(key, None)
                self.changed()

    # -- places ----------------------------------------------------------------------------------------------------

    async def _read_places(self, view: View) -> None:
        """Give a kernel that is new here the places that it had when it was shown before."""
        if self._places is not None and view.lasting and view.key not in self._written:
            self._written[view.key] = places = await to_thread.run_sync(self._places.read, view.lasting)
            self.scene.restore(view.key, places)

    async def _keep_places(self) -> None:
        while True:
            await self._unwritten.wait()
            await asyncio.sleep(_KEEP)
            self._unwritten.clear()
            await self._write_places()

    async def _write_places(self) -> None:
        """Write places that have changed: of kernels that are assembled, or whose boxes a user has placed."""
        for view in list(self.scene.views.values()):
            placed = view.key in self._placed
            if self._places is None or view.key not in self._written or not (placed or view.settled):
                continue
            places = self.scene.places(view.key)
            if places.boxes and places != self._written[view.key]:
                self._written[view.key] = places
                write = partial(self._places.write, view.lasting, places, is_of_user=placed)
                await to_thread.run_sync(write)

    # -- what pages are told ---------------------------------------------------------------------------------------

    def move(self, number: int, x: float, y: float) -> None:
        """Put a box elsewhere."""
        if (kernel := self.scene.move(number, x, y)) is not None:
            self._placed.add(kernel)
        self.changed()

    def fold(self, number: int, *, on: bool) -> None:
        """Fold a frame into one box, or unfold it."""
        self.scene.fold(number, on=on)
        self.changed()

    def tidy(self) -> None:
        """Lay out everything again."""
        self.scene.tidy()
        self._placed.update(self.scene.views)
        self.changed()

    def changed(self) -> None:
        """Draw the scene again, soon."""
        self._dirty.set()

    def state_changed(self, view: View) -> None:
        """Tell pages, also those that come within a minute, that a kernel does not answer, or answers again."""
        if view.about["simulated"]:
            return  # its events have times of its own
        said = {"at_ns": time.time_ns(), "kind": _SAID[view.about["state"]], "text": view.about["why"]}
        item = {"kernel": view.address, "component": "", "context": "", **said}
        self._history.append(item)
        for one in self._followers:
            if isinstance(one, EventFeed):
                one.page.put({"t": "event", "items": [item], "missed": 0})

    def happened(self, watch: Watch, item: Mapping[str, Any]) -> None:
        """Keep a change of a profile for the pages that come within a minute."""
        now = time.time_ns()
        self._history.append(happening(watch.view.address, item["kind"], item["event"], now))

    def changes_since(self, time_ns: int) -> list[dict[str, Any]]:
        """The changes of profiles since a time, and within the last minute."""
        since = max(time_ns, time.time_ns() - _MINUTE)
        return [one for one in self._history if one["at_ns"] >= since]

    def counted(self, watch: Watch) -> None:
        """Tell pages the figures of a kernel."""
        self._tell_figures(watch, tuple(self.pages))

    def _tell(self, message: Mapping[str, Any]) -> None:
        text = json_out(message).decode() if self.pages else ""
        for page in self.pages:
            page.put(text)

    def _tell_figures(self, watch: Watch, pages: Sequence[Page]) -> None:
        """Tell each page the figures that it has in view and was not told."""
        if not pages or not watch.figures.at_ns:
            return
        figures, key = watch.figures, watch.view.key
        wires = self.scene.wires.get(key, {})
        wanted = frozenset[int]().union(*(page.seen["e"] for page in pages if not page.is_far))
        told = ((number, figures.edge(wires[number])) for number in wanted & wires.keys())
        near: dict[int, Row] = {number: row for number, row in told if row is not None}
        far: dict[int, Row] = {}
        if any(page.is_far for page in pages):
            far = {number: [int(not figures.lossy.isdisjoint(names))] for number, names in wires.items()}
        seen = frozenset[int]().union(*(page.seen["b"] for page in pages))
        boxes = self._rows("box", key, figures.now["components"], figures.box, seen) | self._folded(watch)
        totals = self._total(watch)
        frames = self._rows("frame", key, figures.now["contexts"], figures.frame)
        for page in pages:
            rows, shown = (far, frozenset(far)) if page.is_far else (near, page.seen["e"])
            message = {
                "e": different(rows, page.told["e"], shown),
                "b": different(boxes, page.told["b"], page.seen["b"]),
                "f": different(frames, page.told["f"], frames),
                "k": different(totals, page.told["k"], totals),
            }
            if any(message.values()):
                page.put({"t": "figures", "at": {watch.view.address: figures.at_ns}, **message})

    def _total(self, watch: Watch) -> dict[int, Row]:
        """The totals of a kernel, by the number of its frame; those of many components are summed up once a second."""
        key, numbers, figures = watch.view.key, self.scene.numbers, watch.figures
        at_ns, known = self._totals.get(key, (0, {}))
        many = len(watch.view.components) > _MANY
        if many and known and not figures.are_old and 0 <= figures.at_ns - at_ns < _SUM_UP:
            return known
        boxes: dict[str, int | None] = {name: numbers.get(("box", key, name)) for name in watch.view.components}
        for number, members in self.scene.folds.get(key, {}).items():
            boxes |= dict.fromkeys(members, number)
        connectors: dict[str, int | None] = dict.fromkeys(self.scene.inside.get(key, ()))
        total = total_of(watch.view, figures, connectors | self.scene.connectors.get(key, {}), boxes)
        known = {self.scene.number("frame", key): total}
        self._totals[key] = figures.at_ns, known
        return known

    def _folded(self, watch: Watch) -> dict[int, Row]:
        """The states of folded boxes, by the number of the box."""
        key, found = watch.view.key, dict[int, Row]()
        names = [*self.scene.connectors.get(key, ()), *self.scene.inside.get(key, ())]
        for number, members in self.scene.folds.get(key, {}).items():
            known = set(members)
            ends = [name for name in names if known.intersection(watch.view.ends_of(name))]
            found[number] = folded_row(watch.figures, members, ends)
        return found

    def _rows(
        self,
        kind: str,
        key: str,
        names: Mapping[str, Any],
        row: Callable[[str], Row | None],
        wanted: Collection[int] | None = None,
    ) -> dict[int, Row]:
        """Rows by the numbers of things; only of those in `wanted`, where it is given."""
        numbers = self.scene.numbers
        return {
            number: found
            for name in names
            if (number := numbers.get((kind, key, name))) is not None
            and (wanted is None or number in wanted)
            and (found := row(name)) is not None
        }


async def _take_links(client: AsyncClient, view: View) -> None:
    """Note the name by which links reach a kernel; a kernel that has just begun may have none yet."""
    with suppress(AiortsError):  # its session has ended, which is said where it is watched
        view.links = str((await client.call("names"))["links"])
