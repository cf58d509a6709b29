"""Writes one sample to each of several out-ports at the same time, so that a slow reader delays no other port.

Ports whose readers have room get their sample at once; the others are waited for together, each up to its time-out.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import Any, Final, TypeAlias

from aiorts import OutPort, WouldBlock
from aiorts.errors import WriteTimeout

Parcel: TypeAlias = tuple[OutPort[Any], Any]
"""A port, and the sample to write to it."""
_UNSUSPENDED: Final = 256
"""Samples after which the loop gets a turn, as with awaited writes."""


class Sender:
    """Sends the samples of one component's out-ports together."""

    __slots__ = ("_left",)

    def __init__(self) -> None:
        self._left = _UNSUSPENDED

    async def send(self, parcels: Sequence[Parcel]) -> bool:
        """Write each sample to its port; False when a reader had to be waited for.

        Raises:
            WriteTimeout: some connectors had no room in time; all are named. The other readers have their sample.
        """
        full = []
        for port, sample in parcels:
            try:
                port.write_nowait(sample)
            except WouldBlock:
                full.append((port, sample))
        if full:
            await _wait_for(full)
            return False
        self._left -= len(parcels)
        if self._left < 0:
            self._left = _UNSUSPENDED
            await asyncio.sleep(0)
        return True


async def _wait_for(parcels: Sequence[Parcel]) -> None:
    if len(parcels) == 1:
        await parcels[0][0].write(parcels[0][1])
        return
    writes = (port.write(sample) for port, sample in parcels)
    failures = [
        each for each in await asyncio.gather(*writes, return_exceptions=True) if isinstance(each, BaseException)
    ]
    if len(failures) > 1 and all(isinstance(failure, WriteTimeout) for failure in failures):
        raise WriteTimeout("; ".join(map(str, failures)))
    if failures:
        raise failures[0]
