"""A page in a browser: its view, the rows sent to it, and its waiting messages."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Mapping
from typing import Any, Final

from aiorts_studio.plain.values import json_out
from aiorts_studio.watching.figures import Row

MESSAGES: Final = 256
"""Messages that may wait for a page."""
BYTES: Final = 4 << 20
"""Bytes of messages that may wait for a page."""
FAR: Final = 0.6
"""The scale below which a page shows of edges only whether they lose samples."""


class Page:
    """The messages to one page. A page that does not keep up misses messages, and gets a whole new picture.

    Attributes:
        rect: what it has in view, in the scene's coordinates: left, top, right, bottom; None: not known yet.
        scale: pixels of a unit of the scene.
        told: the rows that it was sent, by kind.
        missed: messages that it was too slow for, since the last picture.
    """

    def __init__(self) -> None:
        self.rect: tuple[float, float, float, float] | None = None
        self.scale = 1.0
        self.told: dict[str, dict[int, Row]] = {"e": {}, "b": {}, "f": {}, "k": {}}
        self.seen: dict[str, frozenset[int]] = {"e": frozenset(), "b": frozenset()}
        self.missed = 0
        self._waiting: deque[str] = deque()
        self._bytes = 0
        self._news = asyncio.Event()

    @property
    def is_far(self) -> bool:
        """Whether the page shows so much that figures have no room."""
        return self.scale < FAR

    def put(self, message: Mapping[str, Any] | str) -> None:
        """Queue a message, or count it as missed."""
        text = message if isinstance(message, str) else json_out(message).decode()
        full = len(self._waiting) >= MESSAGES or self._bytes + len(text) > BYTES
        if self._waiting and (self.missed or full):
            self.missed += 1
        else:
            self._waiting.append(text)
            self._bytes += len(text)
        self._news.set()

    async def next(self) -> str | None:
        """The next message; None: it has missed messages, and all that waited is sent: a picture is due."""
        while not self._waiting and not self.missed:
            self._news.clear()
            await self._news.wait()
        if not self._waiting:
            return None
        text = self._waiting.popleft()
        self._bytes -= len(text)
        return text

    def renew(self) -> int:
        """Forget the rows that it was told, since a picture comes; returns the number of messages that it missed."""
        missed, self.missed = self.missed, 0
        for rows in self.told.values():
            rows.clear()
        return missed

    def look(self, things: Mapping[str, Mapping[int, Mapping[str, Any]]]) -> None:
        """Work out which boxes and edges are in view."""
        if self.rect is None:
            self.seen = {"e": frozenset(), "b": frozenset()}
            return
        left, top, right, bottom = self.rect
        boxes = frozenset(
            number
            for number, box in things["boxes"].items()
            if box["x"] < right and box["x"] + box["w"] > left and box["y"] < bottom and box["y"] + box["h"] > top
        )
        edges = frozenset(number for number, edge in things["edges"].items() if _in_view(edge["points"], self.rect))
        self.seen = {"e": edges, "b": boxes}


def _in_view(points: list[list[float]], rect: tuple[float, float, float, float]) -> bool:
    left, top, right, bottom = rect
    xs, ys = [point[0] for point in points], [point[1] for point in points]
    return min(xs) < right and max(xs) > left and min(ys) < bottom and max(ys) > top
