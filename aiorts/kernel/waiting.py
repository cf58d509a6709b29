"""A sample that waits for room at a connector, on behalf of its writer."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from aiorts.kernel.connector import Connector

__all__ = ("Waiting", "set_done")


@dataclass(eq=False, slots=True)
class Waiting:
    """A sample whose writer waits for room: the reader that makes room moves it. A writer in a thread has no future
    and waits on the in-port's lock."""

    connector: Connector
    sample: Any
    future: asyncio.Future[None] | None
    done: bool = False


def set_done(future: asyncio.Future[None]) -> None:
    """Wake the writer, unless it has given up."""
    if not future.done():
        future.set_result(None)
