"""A kernel's session with another kernel, whose control operations it calls."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, Self

from aiorts.sessions import AsyncClient, Entry

if TYPE_CHECKING:
    import socket

_LONGEST: Final = 8 << 20
"""The most bytes of an answer."""
_GREETS: Final = 4.0
"""Seconds for a kernel's hello: more than the deadline for the question what this kernel may do on another host."""
WITHIN: Final = 4.5
"""Seconds that a call waits: less than the caller of a transition waits for it."""


class KernelSession(AsyncClient):
    """A session with another kernel, with every right that it gives: parameters may name files."""

    @classmethod
    async def over(cls, connected: socket.socket, address: str, who: str) -> Self:
        """A session over a connected socket. AiortsError: the other kernel refuses it, or does not answer."""
        session = cls(Entry(address, 0, "", ""), who, longest=_LONGEST)
        return await session.begin(connected, _GREETS)

    async def call(self, operation: str, wait: float | None = WITHIN, /, **arguments: object) -> Any:
        return await super().call(operation, wait, **arguments)
