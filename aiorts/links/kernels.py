"""What questions and calls between kernels need of the links of one kernel."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from typing import TYPE_CHECKING, Any, Protocol

from aiorts.links.messages import Answer

if TYPE_CHECKING:
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.kernel.ports import Port
    from aiorts.links.reaching import Reach
    from aiorts.links.reader_link import ReaderLink
    from aiorts.links.transport import Caller, Peer
    from aiorts.links.writer_link import WriterLink
    from aiorts.model.names import Path


class Kernels(Protocol):
    """The links of one kernel, and through them the other kernels."""

    kernel: Microkernel
    reach: Reach
    """The other kernels, and the transports that reach them."""

    @property
    def reached_as(self) -> str:
        """The name by which other kernels reach this one."""
        ...

    def peer_of(self, path: Path) -> Peer | None:
        """The kernel of a path, if it is there."""
        ...

    def absent(self, path: Path) -> str:
        """Why the kernel of a path is not there: nobody has its name, or no kernel can be reached."""
        ...

    def far_of(self, link: WriterLink | ReaderLink) -> Path:
        """The port at the other end of a link."""
        ...

    async def ask(self, peer: Peer, what: str, body: bytes, within: float) -> bytes:
        """The answer of another kernel; LinkError, LinkTimeout: there is none."""
        ...

    def run(self, coroutine: Coroutine[Any, Any, Any], name: str) -> asyncio.Task[Any]:
        """Run a coroutine as a task of the links."""
        ...

    def path_of(self, port: Port[Any], peer: Peer | None = None) -> Path:
        """Of a port of this kernel, as others know it; this one, where it has another name there."""
        ...

    def there(self, path: Path, caller: Caller, right: str) -> Port[Any] | Answer:
        """The port of this kernel that another one means, or the answer that it is not there yet.

        WiringError: there is none, or who asks has not this right to it.
        """
        ...
