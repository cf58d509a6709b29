"""What other kernels are told: of components that they wait for, and of links that ended while they were away."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from aiorts.errors import LinkError, LinkTimeout, WiringError
from aiorts.kernel.loop.bus import StateChanged
from aiorts.kernel.ports import InPort
from aiorts.links.messages import Answer, fields, packed
from aiorts.model.lifecycle import LifecycleState

if TYPE_CHECKING:
    from aiorts.kernel.ports import Port
    from aiorts.links.kernels import Kernels
    from aiorts.links.reader_link import ReaderLink
    from aiorts.links.transport import Caller, Peer
    from aiorts.links.writer_link import WriterLink
    from aiorts.model.names import Path

Link: TypeAlias = "WriterLink | ReaderLink"
_AWAITED: Final = 10_000
"""Components that are not there whose coming other kernels are told of."""
_UNTOLD: Final = 1_000
"""Links that ended while the other kernel was away, of which it is told, at the most."""
_SECONDS: Final = 2.0


class Arrivals:
    """The components of one kernel that come, as far as other kernels wait for them.

    One that a system file or a plan makes has come when it is active, or when all that was made runs: what another
    kernel wrote to it before would be dropped.
    """

    def __init__(self, links: Kernels) -> None:
        self._links = links
        self._awaited: dict[str, set[Peer]] = {}
        """Components that are not there, and the kernels that want to connect to them."""
        self._making = False
        self._starting: set[str] = set()
        """Components that were made and do not run yet."""
        links.kernel.bus.subscribe(StateChanged, self._state_changed)

    def there(self, path: Path, caller: Caller, right: str) -> Port[Any] | Answer:
        """The port of this kernel that another one means; where it is not there, the other hears when it comes."""
        kernel, asked = self._links.kernel, str(replace(path, kernel="", host=""))
        try:
            port = kernel.registry.port(asked)
        except WiringError as error:
            caller.check(right, asked)  # before it is told what there is
            if path.component in kernel.components or caller.peer is None or len(self._awaited) >= _AWAITED:
                raise
            self._awaited.setdefault(path.component, set()).add(caller.peer)
            return Answer(absent=str(error))
        caller.check(right, port.path)  # that of a composite has the name that it has in its member
        # What is written to it would be dropped; what it writes must have a way; calls are answered in any state.
        if caller.peer is not None and isinstance(port, InPort) and self._is_coming(path.component):
            self._awaited.setdefault(path.component, set()).add(caller.peer)
            return Answer(absent=f"{path.component} is being started")
        return port

    def _is_coming(self, component: str) -> bool:
        """Whether it does not run yet. One that is being added is about to be connected by who adds it."""
        registry = self._links.kernel.registry
        return component in self._starting or registry.is_arriving(self._links.kernel.components[component])

    @contextmanager
    def making(self) -> Iterator[None]:
        """Round the time in which components are made that run later."""
        self._making = True
        try:
            yield
        finally:
            self._making = False

    def added(self, component: str) -> None:
        """A component is there."""
        if self._making:
            self._starting.add(component)
        self._wake(component)

    def started(self) -> None:
        """All that was made runs."""
        for name in tuple(self._starting):
            self._has_come(name)

    def gone(self, peer: Peer) -> None:
        """Another kernel waits no more."""
        for peers in self._awaited.values():
            peers.discard(peer)

    def _state_changed(self, event: StateChanged) -> None:
        if event.new is LifecycleState.ACTIVE and event.component in self._starting:
            self._has_come(event.component)

    def _has_come(self, component: str) -> None:
        self._starting.discard(component)
        self._wake(component)

    def _wake(self, component: str) -> None:
        """Have the kernels ask again that wait for it."""
        for peer in self._awaited.pop(component, ()):
            self._links.run(self._tell(peer, component), "aiorts link")

    async def _tell(self, peer: Peer, component: str) -> None:
        while True:
            try:
                await self._links.ask(peer, "come", component.encode(), _SECONDS)
            except LinkTimeout:
                continue
            except LinkError:
                return  # it has gone, and asks anew when it comes back
            return


class Departures:
    """The links that one kernel has connected, and disconnected while they were down: the other one hears of them, when
    it is back.

    Args:
        links: that there are now. own: those of them that this kernel has connected, and not the other one.
        ended: called with one whose other end was disconnected.
    """

    def __init__(
        self,
        kernels: Kernels,
        links: Callable[[], Iterable[Link]],
        own: Container[Link],
        ended: Callable[[Link], None],
    ) -> None:
        self._kernels, self._links, self._own, self._ended = kernels, links, own, ended
        self._untold: dict[Link, Path] = {}

    def add(self, link: Link, far: Path) -> None:
        """One is being disconnected here; `far`: the port at its other end."""
        is_known_there = link.end.peer_epoch and not link.end.peer_ended and not link.is_connected
        if link not in self._own or not is_known_there or self._kernels.kernel.closed:
            return
        if (peer := self._kernels.peer_of(far)) is not None:  # it is back, and the link was not offered again yet
            self._kernels.run(self._tell(peer, link, far), "aiorts link")
        elif len(self._untold) < _UNTOLD:
            self._untold[link] = far

    def back(self, peer: Peer) -> None:
        """Another kernel has come back. Of a link that was connected again meanwhile it hears nothing."""
        names = {one.connector.name for one in self._links()}
        for link, far in tuple(self._untold.items()):
            if self._kernels.peer_of(far) == peer:
                del self._untold[link]
                if link.connector.name not in names:
                    self._kernels.run(self._tell(peer, link, far), "aiorts link")

    async def _tell(self, peer: Peer, link: Link, far: Path) -> None:
        if not await self.tell(peer, link.end.peer_epoch):
            self._untold[link] = far

    async def tell(self, peer: Peer, epoch: int) -> bool:
        """Tell another kernel that its end of a link has no other one any more; False: it has not answered."""
        try:
            await self._kernels.ask(peer, "left", packed([epoch]), _SECONDS)
        except LinkTimeout:
            return False
        except LinkError:
            return True  # it has gone, or knows no such question
        return True

    async def left(self, body: bytes, caller: Caller) -> bytes:
        """The answer to a kernel in which the other end of a link was disconnected."""
        (epoch,) = fields(body, (int,), longer=True)
        for link in tuple(self._links()):
            is_meant = link.end.epoch == epoch and link not in self._own  # its own are connected again
            if is_meant and self._kernels.peer_of(self._kernels.far_of(link)) == caller.peer:
                self._ended(link)
        return b""
