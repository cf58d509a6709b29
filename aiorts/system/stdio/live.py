"""Feeds a component with the samples of an out-port in another process, as `pipes.py` does with standard input."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

from aiorts.errors import AiortsError, ClosedError, WireError
from aiorts.sessions import END
from aiorts.system.stdio.pipes import Incoming, Notify
from aiorts.wire import MsgpackCodec

if TYPE_CHECKING:
    from aiorts.sessions import Stream

_LOOK_AGAIN: Final = 0.2
"""Seconds after which the thread that waits for samples checks whether it has to stop."""


class LiveInput(Incoming):
    """A source that takes the samples of an out-port of a running kernel; for an event context.

    Args: see `Incoming`; there is one port.
        stream: the stream of the operation `tap`, with frames. It counts the samples that it drops as `missed`.
    """

    def __init__(
        self, name: str, ports: Mapping[str, type], stream: Stream, notify: Notify, *args: Any, **options: Any
    ) -> None:
        super().__init__(name, ports, notify, *args, **options)
        self._stream = stream

    async def _read(self, descriptor: int | None) -> None:
        codec, number = MsgpackCodec(), 0
        ((port, cls),) = self._types.items()
        while True:
            try:
                items = await asyncio.to_thread(self._stream.take, _LOOK_AGAIN)
            except ClosedError as error:
                self._complain(number, str(error))
                return
            for item in items:
                if item is END or (self._count is not None and number - self.bad >= self._count):
                    return
                number += 1
                try:
                    if "error" in item:
                        raise WireError(item["error"])
                    sample = codec.decode(item["frame"], cls)
                except AiortsError as error:
                    self._complain(number, str(error))
                else:
                    await self._feed.write(port, number, sample)
