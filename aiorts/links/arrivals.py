"""What other kernels are told: of components that they wait for, and of links that ended while they were away."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Container, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

from aiorts.errors import WiringError
from aiorts.kernel.loop.bus import StateChanged
from aiorts.kernel.ports import InPort
from aiorts.late import dataclass
from aiorts.links.kernels import told
from aiorts.links.messages import Answer, packed
from aiorts.model.lifecycle import LifecycleState
from aiorts.model.names import Path

if TYPE_CHECKING:
    from aiorts.kernel.ports import Port
    from aiorts.links.kernels import Kernels
    from aiorts.links.transport import Caller, Peer

_AWAITED: Final = 1_000
"""Components that are not there whose coming one other kernel is told of."""
_UNTOLD: Final = 1_000
"""Links that ended while the other kernel was away, of which it is told, at most."""
_STARTED: Final = "{} is being started"


class Arrivals:
    """The components of one kernel that come, as far as other kernels wait for them.

    One that a system file or a plan makes has come when it is active, or when all that was made runs: what another
    kernel wrote to it before would be dropped.
    """

    def __init__(self, links: Kernels) -> None:
        self._links = links
        self._awaited: dict[str, set[Peer]] = {}
        """Components that are not there, and the kernels that want to connect to them."""
        self._waits: dict[Peer, set[str]] = {}
        """The kernels that wait, and the components that each waits for."""
        self._making = False
        self._starting: set[str] = set()
        """Components that were made and do not run yet."""
        self._expected: set[str] = set()
        """Components that are about to be made."""
        links.kernel.bus.subscribe(StateChanged, self._state_changed)

    def there(self, path: Path, caller: Caller, right: str) -> Port[Any] | Answer:
        """The port of this kernel that another one means; where it is not there, the other hears when it comes."""
        kernel, asked = self._links.kernel, str(replace(path, kernel="", host=""))
        try:
            port = kernel.registry.port(asked)
        except WiringError as error:
            caller.check(right, asked)  # before it is told what there is
            if path.component in kernel.components or not self._await(path.component, caller.peer):
                raise
            return Answer(absent=_STARTED.format(path.component) if self._is_expected(path.component) else str(error))
        caller.check(right, port.path)  # that of a composite has the name that it has in its member
        # What is written to it would be dropped; what it writes must have a way; calls are answered in any state.
        is_coming = isinstance(port, InPort) and self._is_coming(path.component)
        if is_coming and self._await(path.component, caller.peer):
            return Answer(absent=_STARTED.format(path.component))
        return port

    def _is_expected(self, component: str) -> bool:
        """Whether one that is not there is about to be, a restarted one included."""
        from aiorts.supervision import Supervising  # late: few kernels supervise

        supervising = self._links.kernel.attached(Supervising)
        one = None if supervising is None else supervising.supervised.get(component)
        return component in self._expected or (one is not None and one.helping)

    def _await(self, component: str, peer: Peer | None) -> bool:
        """Tell this kernel when the component comes; False: none asks, or it waits for too many."""
        waits = () if peer is None else self._waits.setdefault(peer, set())
        if peer is None or (len(waits) >= _AWAITED and component not in waits):
            return False
        self._waits[peer].add(component)
        self._awaited.setdefault(component, set()).add(peer)
        return True

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

    def expect(self, component: str) -> None:
        """A component is about to be made: who asks for it meanwhile is not told that there is none."""
        self._expected.add(component)

    def added(self, component: str) -> None:
        """A component is there."""
        self._expected.discard(component)
        if self._making:
            self._starting.add(component)
        self._wake(component)

    def started(self) -> None:
        """All that was made runs."""
        for name in tuple(self._starting):
            self._has_come(name)

    def gone(self, peer: Peer) -> None:
        """Another kernel waits no more."""
        for component in self._waits.pop(peer, ()):
            peers = self._awaited[component]
            peers.remove(peer)
            if not peers:
                del self._awaited[component]

    def _state_changed(self, event: StateChanged) -> None:
        if event.new is LifecycleState.ACTIVE and event.component in self._starting:
            self._has_come(event.component)

    def _has_come(self, component: str) -> None:
        self._starting.discard(component)
        self._wake(component)

    def _wake(self, component: str) -> None:
        """Have the kernels ask again that wait for it."""
        for peer in self._awaited.pop(component, ()):
            waits = self._waits[peer]
            waits.remove(component)
            if not waits:
                del self._waits[peer]
            self._links.run(told(self._links, peer, "come", component.encode()), "aiorts link")


@dataclass(frozen=True, slots=True)
class Departure:
    """The end of a link of this kernel is no more, and its other end does not know it."""

    far: Path
    """The port at the other end."""
    connector: str
    """The name that the connector had."""
    epoch: int
    """The epoch of the other end; 0: it has not answered, and may be there or not."""
    own: int
    """The epoch of the end that is no more."""


class Departures:
    """The links that were disconnected while they were down, until the other kernel knows of it: now, or when it is
    back.

    Args:
        connectors: the names of the connectors that there are now: of one that was made again nothing is told.
    """

    def __init__(self, kernels: Kernels, connectors: Callable[[], Container[str]]) -> None:
        self._kernels, self._connectors = kernels, connectors
        self._untold: deque[Departure] = deque(maxlen=_UNTOLD)

    def add(self, departure: Departure) -> None:
        """One is being disconnected."""
        if (peer := self._kernels.peer_of(departure.far)) is not None:
            self._kernels.run(self._tell(peer, departure), "aiorts link")
        else:
            self._untold.append(departure)

    def back(self, peer: Peer) -> None:
        """Another kernel has come back."""
        found = [one for one in self._untold if self._kernels.peer_of(one.far) == peer]
        if not found:
            return
        connectors = self._connectors()
        for departure in found:
            self._untold.remove(departure)
            if departure.connector not in connectors:
                self._kernels.run(self._tell(peer, departure), "aiorts link")

    async def _tell(self, peer: Peer, departure: Departure) -> None:
        body = packed([departure.epoch, departure.connector, departure.own])
        if not await told(self._kernels, peer, "left", body):
            self.add(departure)
