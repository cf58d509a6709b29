"""One kernel that is watched: its session, its profile as it changes, and its counters while a page looks."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Coroutine, Iterable, Mapping
from typing import Any, Final, Protocol

from aiorts.errors import AiortsError, NoAnswerError
from aiorts.sessions import END, AsyncClient, AsyncStream
from aiorts_studio.watching.figures import Figures
from aiorts_studio.watching.view import NOT_YET, View

RATE: Final = 5.0
"""Looks a second at the counters of a kernel."""
_SILENT: Final = 2.5
"""Seconds without counters after which a kernel is said not to answer: the page says so within 3 s."""

ENDED: Final = "has ended"
KILLED: Final = "was killed, or has crashed"
"""The reasons why a session has ended: an orderly end closes its streams."""
_PAUSE: Final = 1.0
"""Seconds between looks at states that no stream tells."""
_LINKS: Final = 64
"""Links, and components, that are looked at in one second."""


def begun(work: Coroutine[Any, Any, None], name: str) -> asyncio.Task[None]:
    """Start a task whose error goes to the loop's handler when it ends, and ends nothing else."""
    task = asyncio.create_task(work, name=name)
    task.add_done_callback(_report)
    return task


def _report(task: asyncio.Task[None]) -> None:
    error = None if task.cancelled() else task.exception()
    if error is not None and not isinstance(error, AiortsError):
        report = {"message": f"{task.get_name()} has failed", "exception": error, "task": task}
        task.get_loop().call_exception_handler(report)


class Told(Protocol):
    """The receiver of the news of a kernel."""

    def changed(self) -> object:
        """Handle a change of the view."""

    def counted(self, watch: Watch) -> object:
        """Handle new figures."""

    def state_changed(self, view: View) -> object:
        """Handle that a kernel which has answered does not any more, or does again."""

    def happened(self, watch: Watch, item: Mapping[str, Any]) -> object:
        """Handle a change of the profile, as the kernel tells it."""


class Follower(Protocol):
    """Follows a kernel for as long as its session lasts."""

    kernel: str
    """The address of the kernel that it is about; "" is any."""

    async def run(self, watch: Watch) -> None:
        """Follow the kernel; the session's end ends this call, too."""


class Watch:
    """Watches one kernel until its session ends.

    Args:
        session: the session with the kernel.
        view: kept up to date by what the kernel tells.
        told: called with the news.
        followers: the present followers of kernels.

    Attributes:
        figures: the counters, and those of the second before.
        closes: whether the kernel has begun to close: changes by its closing are not taken.
    """

    def __init__(self, session: AsyncClient, view: View, told: Told, followers: Iterable[Follower]) -> None:
        self.session, self.view = session, view
        self.figures = Figures()
        self.closes = False
        self._told, self._followers = told, followers
        self._following: dict[Follower, asyncio.Task[None]] = {}
        self._touched: dict[str, None] = {}
        """Components that have changed since the last look: each may have a process of its own, and another one now."""

    async def run(self) -> None:
        """Watch the kernel until its session ends."""
        try:
            async with self.session.stream("changes") as changes:
                self._take_snapshot(changes.began)
                await self._follow(changes)
        except AiortsError:
            self._say("ended", KILLED)
        else:
            if self.view.about["state"] != "ended":  # the run has not said how
                self._say("ended", ENDED)

    async def _follow(self, changes: AsyncStream) -> None:
        for one in self._followers:
            self.start(one)
        own = [begun(one(), "studio watch") for one in (self._count, self._look)]
        try:
            async for item in changes:
                self._take(item)
        finally:
            tasks = [*own, *self._following.values()]
            self._following = {}
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    def start(self, one: Follower) -> None:
        """Start a follower here, if it is about this kernel."""
        if self.session.is_open and one.kernel in ("", self.view.address):
            self._following[one] = begun(one.run(self), "studio follower")

    def stop(self, one: Follower) -> None:
        """End a follower here."""
        if (task := self._following.pop(one, None)) is not None:
            task.cancel()

    # -- its profile -----------------------------------------------------------------------------------------------

    def _take(self, item: Mapping[str, Any]) -> None:
        if item["kind"] == "ProfileSnapshot":
            self._take_snapshot(item)
            return
        self.closes = self.closes or item["kind"] == "Closing"
        if self.closes:
            return  # the last view shows the whole kernel
        for part in item["parts"]:
            known, name, now = self.view.profile[part["section"]], part["name"], part["now"]
            if part["section"] == "components":
                self._touched[name] = None
            if now is None:
                known.pop(name, None)
            else:
                known[name] = now
        self._told.happened(self, item)
        self._told.changed()

    def _take_snapshot(self, item: Mapping[str, Any]) -> None:
        profile = item["profile"]
        self.closes = profile["state"] != "open"
        if self.closes and self.view.profile:
            return
        self.view.profile = profile
        self.view.about["simulated"] = profile["clock"]["kind"] == "SimulatedClock"
        self._told.changed()
        self._say("live", "")

    # -- its figures -----------------------------------------------------------------------------------------------

    async def _count(self) -> None:
        async with self.session.stream("counters", rate=RATE) as stream:
            while (item := await self._next(stream)) is not END:
                if not self.closes:
                    self.figures.take(item)
                    self._told.counted(self)

    async def _next(self, stream: AsyncStream) -> Any:
        """The next item; while no item comes, the kernel counts as silent."""
        while True:
            try:
                item = await stream.next(timeout=_SILENT)
            except NoAnswerError:
                self._say("silent", "does not answer")
            else:
                self.view.answered = time.monotonic()
                self._say("live", "")
                return item

    async def _look(self) -> None:
        """Look at states that no stream tells: of links, their round trips, and the causes of late contexts."""
        overruns: dict[str, int] = {}
        while True:
            links = [name for name, one in self.view.connectors.items() if one["options"]["on_link_lost"] is not None]
            counted = {name: one["overruns"] for name, one in self.figures.now["contexts"].items()}
            late = [name for name, count in counted.items() if count > overruns.get(name, 0)]
            overruns = counted
            there = [name for name in self._touched if name in self.view.components]
            touched, self._touched = there[:_LINKS], dict.fromkeys(there[_LINKS:])
            if links or late or touched:
                asked = {"connectors": links[:_LINKS], "contexts": late, "components": touched}
                try:
                    self._take_part(await self.session.call("part", **asked), touched)
                except AiortsError:  # no answer, or one of them has just gone: the next look is another
                    self._touched |= dict.fromkeys(touched)
            await asyncio.sleep(_PAUSE)

    def _take_part(self, part: Mapping[str, Any], touched: Iterable[str]) -> None:
        self.figures.take_part(part)
        services = self.view.profile.setdefault("services", {})
        processes = services.get("isolation", {})
        now = {name: one for name, one in processes.items() if name not in touched} | part["processes"]
        if now != processes:
            services["isolation"] = now
            self._told.changed()
        if services.get("links", {}) != part["links"]:
            services["links"] = part["links"]
            self._told.changed()

    def _say(self, state: str, why: str) -> None:
        is_new = self.view.about["why"] == NOT_YET
        if self.view.say(state, why):
            self.figures.are_old = state != "live"
            if not is_new:
                self._told.state_changed(self.view)
            self._told.changed()
            self._told.counted(self)
