"""The common part of the async iterators of this room: one task waits, `close()` ends them."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from aiorts.errors import BusyError

if TYPE_CHECKING:
    from types import TracebackType
    from typing import Self


class ClosableIterator:
    """An async iterator that `close()` ends, as the end of `async with` does."""

    def close(self) -> None:
        """End the iterator; idempotent."""
        raise NotImplementedError

    def __aiter__(self) -> Self:
        return self

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class Waiter:
    """Lets one task wait until it is woken."""

    def __init__(self) -> None:
        self._future: asyncio.Future[None] | None = None

    def check_free(self, what: str) -> None:
        """Refuse a second task.

        Raises:
            BusyError: another task waits.
        """
        if self._future is not None:
            raise BusyError(f"{what}; one at a time")

    async def wait(self) -> None:
        """Wait for `wake`."""
        self._future = asyncio.get_running_loop().create_future()
        try:
            await self._future
        finally:
            self._future = None

    def wake(self, *_: object) -> None:
        """Wake the task that waits, if one does."""
        if self._future is not None and not self._future.done():
            self._future.set_result(None)
