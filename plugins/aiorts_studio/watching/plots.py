"""Values of ports for plots: one tap for each port, shared by all pages, and the smallest and the largest of a column.

Pure but for `Tap.follow`: samples come in, columns come out.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from aiorts.errors import AbsentError, AiortsError
from aiorts.sessions import END
from aiorts_studio.watching.page import Page

if TYPE_CHECKING:
    from aiorts_studio.watching.watch import Watch

FASTEST: Final = 60.0
"""Messages a second of one plot."""
_TEXTS: Final = 10.0
"""Whole values a second, of a watch without fields."""
_DIGITS: Final = 10
"""A place in a sequence has fewer digits than this."""
Column: TypeAlias = tuple[float, float, float]
"""The time in s, the smallest and the largest value since the column before."""


def field_of(data: Any, path: str) -> float | None:
    """The number at a path in a sample's data, such as "position.x" or "ranges.3"; None: there is none."""
    for word in path.split(".") if path else ():
        if isinstance(data, Mapping):
            data = data.get(word)
        elif isinstance(data, list | tuple) and len(word) < _DIGITS and word.isdecimal() and int(word) < len(data):
            data = data[int(word)]
        else:
            return None
    if isinstance(data, bool):
        return float(data)
    return float(data) if isinstance(data, int | float) else None


class Columns:
    """The smallest and the largest number of each field since they were taken last."""

    def __init__(self, fields: Sequence[str]) -> None:
        self._fields = fields
        self._now: dict[str, Column] = {}

    def add(self, seconds: float, data: Any) -> None:
        """Take a sample."""
        for name in self._fields:
            value = field_of(data, name)
            if value is not None:
                _, low, high = self._now.get(name, (seconds, value, value))
                self._now[name] = seconds, min(low, value), max(high, value)

    def take(self) -> dict[str, list[Column]]:
        """The columns by field; they are empty from then on."""
        found, self._now = self._now, {}
        return {name: [column] for name, column in found.items()}


class Shown:
    """A watch of one page: fields of a port, or the whole value.

    Args:
        number: the page's number of the watch.
        fields: paths of numbers; none is the whole value, up to ten times a second.
        rate: columns a second.
    """

    def __init__(self, page: Page, number: int, fields: Sequence[str], rate: float) -> None:
        self.page, self.number, self._fields = page, number, fields
        self._columns = Columns(fields) if fields else None
        self._whole: Any = None
        self._pause = 1.0 / min(rate, FASTEST if fields else _TEXTS)
        self._timer: asyncio.TimerHandle | None = None
        self._last = 0.0
        self._began: float | None = None
        self.unit = ""

    def add(self, seconds: float, data: Any) -> None:
        """Take a sample; it is sent with those of the same column."""
        if self._began is None:
            self._began = seconds
            if absent := [name for name in self._fields if field_of(data, name) is None]:
                self.fail(AbsentError(f"no number in what came first: {', '.join(absent):.200}"))
        if self._columns is None:
            self._whole = data
        else:
            self._columns.add(seconds - self._began, data)
        if self._timer is None:
            loop = asyncio.get_running_loop()
            self._timer = loop.call_at(max(loop.time(), self._last + self._pause), self._send)

    def _send(self) -> None:
        self._timer, self._last = None, asyncio.get_running_loop().time()
        if self._columns is None:
            self.page.put({"t": "text", "id": self.number, "value": self._whole})
            return
        fields = self._columns.take()
        if fields:
            first = next(iter(fields.values()))
            head = {"t": "values", "id": self.number, "t0": self._began, "columns": first}
            self.page.put({**head, "fields": fields, "unit": self.unit})

    def fail(self, error: AiortsError) -> None:
        """Tell the page why nothing comes."""
        self.page.put({"t": "answer", "id": self.number, "problem": {"code": error.code, "text": str(error)}})

    def close(self) -> None:
        """Send nothing more."""
        if self._timer is not None:
            self._timer.cancel()


class Tap:
    """The samples of one port, for all watches of it.

    Attributes:
        shown: the watches.
        failed: the error because of which nothing comes.
    """

    def __init__(self, kernel: str, path: str) -> None:
        self.kernel, self.path = kernel, path
        self.shown: list[Shown] = []
        self.failed: AiortsError | None = None

    async def run(self, watch: Watch) -> None:
        """Follow the port until its kernel's session ends."""
        self.failed = None
        try:
            component, _, port = self.path.partition(".")
            ports = watch.view.components.get(component, {}).get("ports", {})
            if ports.get(port, {}).get("direction") == "in":
                await self._look(watch)
            else:
                await self._tap(watch)
        except AiortsError as error:
            self.failed = error
            for one in self.shown:
                one.fail(error)

    async def _tap(self, watch: Watch) -> None:
        async with watch.session.stream("tap", port=self.path) as stream:
            unit = stream.began["unit"] or ""
            while (item := await stream.next()) is not END:
                if item.get("error") is None:
                    self._add(item["time_ns"] / 1e9, item["data"], unit)

    async def _look(self, watch: Watch) -> None:
        """Look at an in-port again and again: a tap takes what is written, and an in-port has writers of its own."""
        async with watch.session.stream("monitor", paths=[self.path], rate=_TEXTS) as stream:
            while (item := await stream.next()) is not END:
                value = item["values"].get(self.path)
                if value is not None:
                    data = value.get("data", value) if isinstance(value, Mapping) else value
                    self._add(item["time_ns"] / 1e9, data, "")

    def _add(self, seconds: float, data: Any, unit: str) -> None:
        for one in self.shown:
            one.unit = unit
            one.add(seconds, data)
