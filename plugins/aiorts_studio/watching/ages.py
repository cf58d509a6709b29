"""Follows the ages of samples when they are read, on connectors that measure them or that a page asks for."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from aiorts.errors import AiortsError, BusyError, NoAnswerError, WiringError
from aiorts_studio.watching.page import Page

if TYPE_CHECKING:
    from aiorts_studio.watching.view import View
    from aiorts_studio.watching.watch import Watch

Wire: TypeAlias = tuple[str, str]
"""The key of a kernel, and the name of a connector."""
MOST: Final = 16
"""Connectors that all pages may have measured: as many as a kernel measures for one stream."""
_TIMED: Final = 64
"""Connectors of a kernel, measured by their own option, whose ages are looked at."""
_RATE: Final = 1.0
"""Looks a second: the kernel sorts the ages for each."""
_PAUSE: Final = 0.5
"""Seconds between checks of which ages are wanted, while none are; such a check asks no kernel."""


class Ages:
    """Follows the ages of all kernels; connectors that pages ask for are measured for as long as one of them asks.

    Args:
        refused: called with the error of a kernel that measures no more.
    """

    kernel = ""

    def __init__(self, refused: Callable[[AiortsError], object]) -> None:
        self._refused = refused
        self._asked: dict[Page, frozenset[Wire]] = {}

    def ask(self, page: Page, wires: Iterable[Wire], *, on: bool) -> None:
        """Begin or end to measure connectors for a page.

        Raises:
            BusyError: all pages together would have more than `MOST` measured.
        """
        mine = self._asked.get(page, frozenset())
        wanted = mine | frozenset(wires) if on else mine - frozenset(wires)
        others = (one for there, one in self._asked.items() if there is not page)
        if on and len(wanted.union(*others)) > MOST:
            raise BusyError(f"measure: pages have at most {MOST} connectors measured; end another first")
        self._asked[page] = wanted

    def leave(self, page: Page) -> None:
        """Forget what a page asked for."""
        self._asked.pop(page, None)

    async def run(self, watch: Watch) -> None:
        """Look at the ages of one kernel until its session ends, with a new stream whenever others are wanted."""
        refused: tuple[list[str], list[str]] | None = None
        while watch.session.is_open:
            wanted = timed, measured = self._wanted(watch.view)
            if (timed or measured) and wanted != refused:
                try:
                    await self._follow(watch, timed, measured)
                except (NoAnswerError, WiringError):
                    pass  # it is stopped, or the connector has just gone
                except AiortsError as error:
                    refused = wanted
                    self._refused(error)
                finally:
                    watch.figures.ages.clear()
            await asyncio.sleep(_PAUSE)

    def _wanted(self, view: View) -> tuple[list[str], list[str]]:
        """The connectors that are measured by their own option, and those that pages ask for."""
        asked = frozenset[Wire]().union(*self._asked.values())
        measured = [name for name in view.connectors if (view.key, name) in asked]
        timed = [name for name, one in view.connectors.items() if one["options"]["measure"] and name not in measured]
        return timed[:_TIMED], measured

    async def _follow(self, watch: Watch, timed: list[str], measured: list[str]) -> None:
        nothing: dict[str, Any] = {"contexts": [], "components": []}
        names = {"connectors": [*timed, *measured], "timed": timed, "measured": measured}
        async with watch.session.stream("counters", rate=_RATE, **names, **nothing) as stream:
            async for item in stream:
                for name, spans in item["timed"].items():
                    if (age := _age_ms(spans)) is not None:
                        watch.figures.ages[name] = age
                if self._wanted(watch.view) != (timed, measured):
                    return


def _age_ms(spans: Mapping[str, Any]) -> float | None:
    """The median age; None: there is none yet, or it ends where a link takes the sample, not where it is read."""
    age = spans.get("age")
    return None if age is None or "link" in spans else round(age[1] / 1e6, 3)
