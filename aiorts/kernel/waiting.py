"""A sample that waits for room at a connector, on behalf of its writer."""

from __future__ import annotations

import asyncio
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from aiorts.model.policy import admits

if TYPE_CHECKING:
    from aiorts.kernel.connector import Connector

__all__ = ("Waiting", "admit_each", "set_done")


@dataclass(eq=False, slots=True)
class Waiting:
    """A sample whose writer waits for room: the reader that makes room moves it. A writer in a thread has no future
    and waits on the in-port's lock."""

    connector: Connector
    sample: Any
    future: asyncio.Future[None] | None
    done: bool = False


def admit_each(connector: Connector, waiting: deque[Waiting]) -> None:
    """Move in who waits, as far as there is room; those that the push policy leaves out need none."""
    while waiting:
        sent = admits(connector._push, connector._skip, connector._written + 1)
        if sent and len(connector._queue) >= connector._length:
            break
        entry = waiting.popleft()
        connector._written += 1
        if sent:
            connector._push_in(connector._stamp_in(entry.sample))
        else:
            connector._drop("skipped")
        connector._resolve(entry)


def set_done(future: asyncio.Future[None]) -> None:
    """Wake the writer, unless it has given up."""
    if not future.done():
        future.set_result(None)
