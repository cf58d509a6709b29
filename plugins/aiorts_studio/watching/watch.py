"""One kernel that is watched: its session, its profile as it changes, and its counters while a page looks."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any, Final

from aiorts.errors import AiortsError, NoAnswerError
from aiorts.sessions import END, AsyncClient, AsyncStream, Entry
from aiorts_studio.watching.figures import Figures
from aiorts_studio.watching.scene import View

RATE: Final = 5.0
"""Looks a second at the counters of a kernel."""
_OPEN: Final = 3.0
_SILENT: Final = 2.5
"""Seconds without counters after which a kernel is said not to answer: the page says so within 3 s."""


class Watch:
    """Watches one kernel until it ends.

    Args:
        entry: the kernel.
        view: is kept up to date with what the kernel says.
        changed: called when the view is other than before.
        counted: called when there are new figures.
        happened: called with each change of the profile, as the kernel tells it.

    Attributes:
        figures: the counters, while the kernel answers.
        client: the session with the kernel; None: there is none.
    """

    def __init__(
        self,
        entry: Entry,
        view: View,
        changed: Callable[[], object],
        counted: Callable[[Watch], object],
        happened: Callable[[Watch, Mapping[str, Any]], object],
    ) -> None:
        self.entry, self.view = entry, view
        self.figures = Figures()
        self.client: AsyncClient | None = None
        self._changed, self._counted, self._happened = changed, counted, happened
        self._answered = time.monotonic()

    async def run(self) -> None:
        """Watch it until its session ends."""
        try:
            async with AsyncClient.connect(self.entry, timeout=_OPEN, who="aiorts studio", right="view") as client:
                self.client = client
                async with client.stream("changes") as changes:
                    self._take_snapshot(changes.began)
                    counting = asyncio.create_task(self._count(client), name="studio counters")
                    try:
                        async for item in changes:
                            self._take(item)
                    finally:
                        counting.cancel()
                        with suppress(asyncio.CancelledError):
                            await counting
            self._say("ended", "has ended")
        except AiortsError as error:
            self._say("ended" if not isinstance(error, NoAnswerError) else "silent", str(error))
        finally:
            self.client = None

    # -- its profile -----------------------------------------------------------------------------------------------

    def _take(self, item: Mapping[str, Any]) -> None:
        if item["kind"] == "ProfileSnapshot":
            self._take_snapshot(item)
            return
        for part in item["parts"]:
            section, name, now = part["section"], part["name"], part["now"]
            known = self.view.profile.get(section)
            if not isinstance(known, dict) or not name:
                self.view.profile[section] = now
            elif now is None:
                known.pop(name, None)
            else:
                known[name] = now
        self._happened(self, item)
        self._changed()

    def _take_snapshot(self, item: Mapping[str, Any]) -> None:
        profile = item["profile"]
        self.view.profile = profile
        self.view.about["simulated"] = profile["clock"]["kind"] == "SimulatedClock"
        self._say("live", "")

    # -- its counters ----------------------------------------------------------------------------------------------

    async def _count(self, client: AsyncClient) -> None:
        async with client.stream("counters", rate=RATE) as stream:
            while (item := await self._next(stream)) is not END:
                self.figures.take(item)
                self._counted(self)

    async def _next(self, stream: AsyncStream) -> Any:
        """The next item; while there is none the kernel is said not to answer."""
        while True:
            try:
                item = await stream.next(timeout=_SILENT)
            except NoAnswerError:
                self._say("silent", "does not answer")
            else:
                self._answered = time.monotonic()
                self._say("live", "")
                return item

    def _say(self, state: str, why: str) -> None:
        about = self.view.about
        since = 0.0 if state == "live" else round(time.monotonic() - self._answered, 1)
        if (about["state"], about["why"]) == (state, why) and state == "live" and about.get("known"):
            return
        about.update(state=state, why=why, since_s=since, known=True)
        self._changed()
