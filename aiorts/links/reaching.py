"""The kernels in reach, and the transports that carry questions and links to them: opened, and tried again."""

from __future__ import annotations

import asyncio
import os
import platform
from collections.abc import Awaitable, Callable, Coroutine, Mapping
from functools import partial
from itertools import chain, repeat
from typing import TYPE_CHECKING, Any, Final

from aiorts.clock import SimulatedClock
from aiorts.errors import LinkError, PluginError, format_error
from aiorts.kernel.loop.guarded import KernelLog
from aiorts.kernel.loop.tasks import kernel_task
from aiorts.links.transport import EVERYTHING
from aiorts.spelling import suggestion

if TYPE_CHECKING:
    import socket

    from aiorts.kernel.extensions.catalogue import Catalogue
    from aiorts.kernel.ports import InPort, OutPort
    from aiorts.links.kernels import Kernels
    from aiorts.links.transport import Caller, Peer, Transport
    from aiorts.model.links import Allowed
    from aiorts.model.names import Path

_LOG: Final = KernelLog()
_AGAIN: Final = (0.2, 0.4, 0.8, 1.6, 2.0)
"""Seconds until a transport that could not be opened is tried again."""
_NEEDED: Final = ("open", "close", "presence", "channel", "ask", "answer")


class Reach:
    """The transports of one kernel, and the other kernels that they have found.

    The general transport is opened when it is first needed; others, for certain kernels, are opened in addition to it.

    Args:
        handlers: gives the questions that other kernels may ask, and their handlers.
        present: called when another kernel has come or gone.
        late: called when the general transport is open after it could not be opened at first.
    """

    def __init__(
        self,
        links: Kernels,
        handlers: Callable[[], Mapping[str, Callable[[bytes, Caller], Awaitable[bytes]]]],
        present: Callable[[Peer, bool], None],
        late: Callable[[], None],
    ) -> None:
        self._links, self._handlers, self._tell, self._late = links, handlers, present, late
        self._name = "unix"
        self._transport: Transport | None = None
        self._opening: asyncio.Future[None] | None = None
        """Done when the general transport is open, or failed with the reason why it is not; then it is tried again."""
        self._carriers: list[Transport] = []
        """The transports to further kernels, such as those in processes of this program, or on other hosts."""
        self.carried: set[str] = set()
        """The names of the kernels in processes of this program; they connect what this kernel tells them to."""
        self.peers: dict[Peer, Transport] = {}
        """The kernels that are there besides this one, and the transport that carries links to each."""
        self._named: dict[str, dict[Peer, None]] = {}
        """The peers by their names, in the same order."""
        self._ways: dict[Peer, list[Transport]] = {}
        """All transports that reach each peer. The general one carries the peer's links once it has found the peer.
        Until then, the transport that found the peer first carries them, or another over which the peer has asked."""
        self._hosts: dict[Peer, str] = {}
        """The host of each peer for `host_of`: unchanged as long as the peer is there."""
        self._epoch = 0
        self.host = platform.node() or "host"
        """The name of this machine, as kernels of other hosts know it: a kernel that two transports find is one."""
        self._closing = False

    # -- transports ------------------------------------------------------------------------------------------------

    def use(self, transport: Transport) -> None:
        """Make this transport the general one; it is not open yet."""
        self._transport = transport

    async def carry(self, transport: Transport) -> None:
        """Open a transport in addition to the general one, such as for other hosts. LinkError: it cannot be opened.

        The general transport is not opened for the kernels named in `carried`: only this one reaches them.
        """
        self._carriers.append(transport)
        await self._use(transport)

    @property
    def is_opening(self) -> bool:
        """Whether it is not known yet which kernels are there."""
        return self._opening is not None and not self._opening.done()

    @property
    def is_open(self) -> bool:
        """Whether kernels can be reached in general."""
        opening = self._opening
        return opening is not None and opening.done() and not opening.cancelled() and opening.exception() is None

    def open_soon(self, name: str | None = None) -> asyncio.Future[None]:
        """Begin to open the general transport, unless that has begun; `name`: the name of the transport."""
        self._name = name or self._name
        if self._opening is None:
            loop = self._links.kernel.loop
            self._opening = task = kernel_task(loop, self._open(), f"aiorts links {self._links.kernel.name}")
            task.add_done_callback(self._report_opening)
        return self._opening

    def open_for(self, path: Path) -> None:
        """Open the transport that reaches the kernel of a path, if it is not open yet."""
        if path.kernel not in self.carried:
            self.open_soon()

    async def opened(self) -> None:
        """Wait until kernels can be reached in general. LinkError: they cannot; the transport is tried again."""
        await asyncio.shield(self.open_soon())

    async def opened_for(self, path: Path) -> None:
        """Wait until it is known whether the kernel of a path is there. LinkError: no open transport can tell."""
        if path.kernel in self.carried:
            return
        try:
            await self.opened()
        except LinkError:
            if self.peer_of(path) is None:
                raise

    async def _open(self) -> None:
        kernel = self._links.kernel
        if self._transport is None and isinstance(kernel.clock, SimulatedClock):
            # Simulated time waits for work under way: with a peer in real time it would stand still.
            _LOG.warning("W-LINK: on a simulated clock no kernel of another process is reached: its time is another")
            return
        self._transport = self._transport or find_transport(self._name, kernel.plugins)
        await self._use(self._transport)

    @property
    def epoch(self) -> int:
        """The number of this kernel for its peers, one for all transports."""
        self._epoch = self._epoch or self._links.kernel.epoch or new_epoch()
        return self._epoch

    async def _use(self, transport: Transport) -> None:
        for what, handler in self._handlers().items():
            transport.answer(what, partial(self._asked, transport, handler))
        await transport.open(_Face(self._links, self))
        transport.presence(partial(self._present, transport))

    def _report_opening(self, task: asyncio.Task[None]) -> None:
        if task.cancelled() or (error := task.exception()) is None:
            return
        again = isinstance(error, LinkError) and not self._closing
        also = "; it is tried again while this one runs" if again else ""
        _LOG.error("links: other kernels cannot be reached: %s%s", format_error(error), also)
        if again:
            self._links.run(self._open_again(), f"aiorts links {self._links.kernel.name}")

    async def _open_again(self) -> None:
        """Try until the transport is open: the kernel that had this one's name may have ended."""
        loop = self._links.kernel.loop
        for pause in chain(_AGAIN, repeat(_AGAIN[-1])):
            await asyncio.sleep(pause)
            try:
                await self._open()
            except LinkError as error:
                self._opening = loop.create_future()
                self._opening.set_exception(error)
                self._opening.exception()  # the first refusal was logged
                continue
            break
        self._opening = loop.create_future()
        self._opening.set_result(None)
        _LOG.warning("links: other kernels can be reached now")
        self._late()

    async def close(self) -> None:
        """Close all transports; a close that has begun goes on even where no caller waits for it any more."""
        self._closing = True
        if self._opening is not None:
            self._opening.cancel()
        closes = []
        for transport in (*self._carriers, *(() if self._transport is None else (self._transport,))):
            closing = kernel_task(self._links.kernel.loop, transport.close(), "aiorts links close")
            closing.add_done_callback(_observed)
            closes.append(closing)
        if closes:
            await asyncio.wait(closes)

    # -- other kernels ---------------------------------------------------------------------------------------------

    async def _asked(
        self, transport: Transport, handler: Callable[[bytes, Caller], Awaitable[bytes]], body: bytes, caller: Caller
    ) -> bytes:
        """Answer a question of another kernel; its transport then carries what follows from it, such as a channel."""
        if (peer := caller.peer) is not None and transport in self._ways.get(peer, ()):
            self.peers[peer] = transport
        return await handler(body, caller)

    def _present(self, transport: Transport, peer: Peer, up: bool) -> None:
        ways = self._ways.setdefault(peer, [])
        (ways.append if up else ways.remove)(transport)
        before = self.peers.get(peer)
        now = before if before in ways else next(iter(ways), None)
        if before is not None and now is not before:
            del self.peers[peer], self._named[peer.kernel][peer], self._hosts[peer]
            if not self._named[peer.kernel]:
                del self._named[peer.kernel]
            self._tell(peer, False)
        if not ways:
            self._ways.pop(peer, None)
        elif before is not None and up and transport is self._transport and peer.kernel not in self.carried:
            self.peers[peer] = transport  # a link that has a channel keeps it
        elif now is not None and now is not before:
            self.peers[peer], self._named.setdefault(peer.kernel, {})[peer] = now, None
            local = now is self._transport or peer.kernel in self.carried
            self._hosts[peer] = "" if local else peer.host
            self._tell(peer, True)

    def peer_of(self, path: Path) -> Peer | None:
        """The kernel of a path, if it is there."""
        here = platform.node().lower()
        found = [
            peer
            for peer in self._named.get(path.kernel, ())
            if path.host.lower() in ("", "localhost", peer.host.lower(), "" if self._hosts[peer] else here)
        ]
        return found[-1] if found else None

    async def session(self, path: Path) -> tuple[socket.socket, str] | None:
        """A connection for a session with the kernel of a path, and that kernel's address; None where no transport
        carries sessions: kernels of this host have sockets of their own."""
        peer = self.peer_of(path)
        carry = None if peer is None else getattr(self.peers[peer], "session", None)
        return None if peer is None or carry is None else (await carry(peer), f"{peer.host}/{peer.kernel}")

    def host_of(self, peer: Peer | None) -> str:
        """The host of a kernel that the general transport has not found, where another may have its name; else ""."""
        return "" if peer is None else self._hosts.get(peer, "")

    def refusal(self, peer: Peer, right: str, port: InPort[Any] | OutPort[Any]) -> str:
        """Why another kernel lacks this right to a port; "" if it has the right, or no component here has the port."""
        allowed: Allowed = getattr(self.peers.get(peer), "allowed", EVERYTHING)
        return "" if port.is_tap or port.is_far else allowed.refusal(peer.kernel, right, port.path)

    @property
    def known_as(self) -> str:
        """The different name by which some kernels know this one; "" where all know it by its own."""
        return next(filter(None, map(_name_in, self._carriers)), "")

    def name_for(self, peer: Peer | None) -> str:
        """The name by which a kernel knows this one."""
        return _name_in(None if peer is None else self.peers.get(peer)) or self._links.reached_as

    def absent(self, path: Path) -> str:
        """The reason why the kernel of a path is not there: no kernel has its name, or none can be reached."""
        far, opening = path.kernel, self._opening
        if far not in self.carried and opening is not None and opening.done() and (error := opening.exception()):
            return str(error)
        there = [peer.kernel for peer in self.peers]
        return f"there is no kernel {far!r} yet{f'; {suggestion(far, there)}' if there else ''}"

    def carrier(self, peer: Peer | None) -> Transport:
        """The transport that carries links to a kernel. LinkError: the kernel is gone."""
        carrier = None if peer is None else self.peers.get(peer)
        if carrier is None:
            raise LinkError(f"{'the other kernel' if peer is None else peer.kernel}: is gone")
        return carrier


def _name_in(transport: Transport | None) -> str:
    return str(getattr(transport, "known_as", ""))


class _Face:
    """The kernel as a transport sees it."""

    def __init__(self, links: Kernels, reach: Reach) -> None:
        self._links = links
        self.name = links.reached_as
        self.epoch, self.host = reach.epoch, reach.host

    def run_in_background(self, coroutine: Coroutine[Any, Any, Any], name: str) -> asyncio.Task[Any]:
        return self._links.run(coroutine, name)

    def report(self, text: str) -> None:
        _LOG.warning("W-LINK: %s", text)


def new_epoch() -> int:
    """A random number for a kernel, or for an end of a link, that no other has."""
    return int.from_bytes(os.urandom(8), "big")


def _observed(task: asyncio.Task[None]) -> None:
    if not task.cancelled() and (error := task.exception()) is not None:
        _LOG.error("links: the transport did not close: %s", format_error(error))


def find_transport(name: str, plugins: Catalogue) -> Transport:
    """A new transport of that name: "unix", or one that a plugin offers, which is imported now.

    Raises:
        PluginError: no plugin offers it, it cannot be loaded or made, or it is no transport.
    """
    if name == "unix":
        from aiorts.links.unix import UnixTransport  # late: it is chosen by its name

        return UnixTransport()
    offered = plugins.find("transports", name)
    kind = offered.load()
    try:
        made: Transport = kind()
    except Exception as error:  # a plugin's border: what its constructor does is reported as the plugin's
        raise PluginError(f"transport {name!r}: cannot be made: {type(error).__name__}: {error}") from error
    if missing := [method for method in _NEEDED if not callable(getattr(made, method, None))]:
        raise PluginError(f"transport {name!r}: {type(made).__name__} has no method {missing[0]}")
    return made
