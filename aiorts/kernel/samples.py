"""Reading a port with `async for`: the samples as they come, until the port is closed."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import TYPE_CHECKING, TypeVar

from aiorts.errors import ClosedError

if TYPE_CHECKING:
    from aiorts.kernel.in_port import InPort

__all__ = ("Samples",)

T = TypeVar("T")


class Samples(AsyncIterator[T]):
    """The samples of a port as they come; it ends when the port is closed."""

    __slots__ = ("_port",)

    def __init__(self, port: InPort[T]) -> None:
        self._port = port

    async def __anext__(self) -> T:
        try:
            return await self._port.read()
        except ClosedError:
            raise StopAsyncIteration from None
