"""The interface of one kernel's links, for the ends of links and for questions and calls between kernels."""

from __future__ import annotations

import asyncio
from collections.abc import Collection, Coroutine, Iterator
from contextlib import AbstractAsyncContextManager
from typing import TYPE_CHECKING, Any, Final, Protocol

from aiorts.errors import LinkError, LinkTimeout
from aiorts.links.messages import Answer
from aiorts.model.links.negotiation import PAUSES

if TYPE_CHECKING:
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.kernel.ports import InPort, OutPort, Port
    from aiorts.links.transport import Caller, Peer, Transport
    from aiorts.model.names import Path


_SECONDS: Final = 2.0
"""Seconds for an answer."""
_LONGEST_PAUSE: Final = 10.0
"""The most seconds between two attempts while the other kernel stands still."""


class Reached(Protocol):
    """The kernels that are there, and the transports that carry links to them."""

    @property
    def carried(self) -> Collection[str]:
        """The names of kernels that connect what this kernel tells them to."""
        ...

    @property
    def is_opening(self) -> bool:
        """Whether it is not known yet which kernels are there."""
        ...

    def open_for(self, path: Path) -> None:
        """Open the transport that reaches the kernel of a path, if it is not open yet."""
        ...

    async def opened_for(self, path: Path) -> None:
        """Wait until it is known whether the kernel of a path is there. LinkError: it cannot be reached."""
        ...

    def peer_of(self, path: Path) -> Peer | None:
        """The kernel of a path, if it is there."""
        ...

    def host_of(self, peer: Peer | None) -> str:
        """The host of a kernel that only other transports reach, as a kernel here may have the same name; else ""."""
        ...

    def name_for(self, peer: Peer | None) -> str:
        """The name by which a kernel knows this one."""
        ...

    def absent(self, path: Path) -> str:
        """The reason why the kernel of a path is not there: no kernel has its name, or none can be reached."""
        ...

    def refusal(self, peer: Peer, right: str, port: InPort[Any] | OutPort[Any]) -> str:
        """Why another kernel lacks this right to a port; "" if it has the right, or no component here has the port."""
        ...

    def carrier(self, peer: Peer | None) -> Transport:
        """The transport that carries links to a kernel. LinkError: the kernel is gone."""
        ...


class Kernels(Protocol):
    """The links of one kernel, and through them the other kernels."""

    kernel: Microkernel
    numbers: Iterator[int]
    """The numbers of this kernel's offers: they tell an offer that was overtaken on the way."""

    @property
    def reach(self) -> Reached:
        """The kernels that can be reached, and the transports that reach them."""
        ...

    @property
    def reached_as(self) -> str:
        """The name by which other kernels reach this one."""
        ...

    def peer_of(self, path: Path) -> Peer | None:
        """The kernel of a path, if it is there."""
        ...

    def is_there(self, peer: Peer) -> bool:
        """Whether another kernel is there."""
        ...

    async def ask(self, peer: Peer, what: str, body: bytes, within: float) -> bytes:
        """The answer of another kernel; LinkError, LinkTimeout: there is none."""
        ...

    def turn(self, peer: Peer) -> AbstractAsyncContextManager[None]:
        """A turn to offer links to another kernel: a bounded number of links have a turn at the same time."""
        ...

    def run(self, coroutine: Coroutine[Any, Any, Any], name: str) -> asyncio.Task[Any]:
        """Run a coroutine as a task of the links."""
        ...

    def path_of(self, port: Port[Any], peer: Peer | None = None) -> Path:
        """The path of a port here; it names this kernel as `peer` does, or, without `peer`, as others do."""
        ...

    def there(self, path: Path, caller: Caller, right: str) -> Port[Any] | Answer:
        """The port here that another kernel asks for, or the answer that the port is not there yet.

        WiringError: there is no such port, or the caller lacks this right to the port.
        """
        ...

    def come(self, component: str, peer: Peer | None) -> None:
        """Handle the arrival of a component in another kernel."""
        ...


async def told(kernels: Kernels, peer: Peer, what: str, body: bytes) -> bool:
    """Send a message to another kernel until that has answered, or refused five times; it may come twice.

    False: the kernel has gone.
    """
    refusals, pause = iter(PAUSES), PAUSES[0]
    while True:
        try:
            await kernels.ask(peer, what, body, _SECONDS)
        except LinkTimeout:
            # The messages may lie unread until the kernel goes on: they are sent less and less often.
            rest, pause = pause, min(2 * pause, _LONGEST_PAUSE)
        except LinkError:
            if not kernels.is_there(peer):
                return False
            # The kernel has too many questions now, or does not know this one.
            if (again := next(refusals, None)) is None:
                return True
            rest = again
        else:
            return True
        await asyncio.sleep(rest)
