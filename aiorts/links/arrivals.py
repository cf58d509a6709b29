"""News for other kernels: of components that they wait for, and of links that ended while they were away."""

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
"""The most absent components that one other kernel may wait for."""
_UNTOLD: Final = 1_000
"""The most links that are remembered because they ended while their other kernel was away."""
_STARTED: Final = "{} is being started"


class Arrivals:
    """The arrivals of components of one kernel, as far as other kernels wait for them.

    A component that a system file or a plan makes counts as arrived when it is active, or when all components
    made with it run: earlier samples from other kernels would be dropped.
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
        """The port that another kernel asks for, or the answer that the port is absent; its arrival is told later."""
        kernel, asked = self._links.kernel, str(replace(path, kernel="", host=""))
        try:
            port = kernel.registry.port(asked)
        except WiringError as error:
            caller.check(right, asked)  # before the error names the ports that there are
            if path.component in kernel.components or not self._await(path.component, caller.peer):
                raise
            return Answer(absent=_STARTED.format(path.component) if self._is_expected(path.component) else str(error))
        caller.check(right, port.path)  # a composite's port has the path of its member's port
        # Only for in-ports the kernel waits: samples would be dropped. Out-ports need links first; calls are answered.
        is_coming = isinstance(port, InPort) and self._is_coming(path.component)
        if is_coming and self._await(path.component, caller.peer):
            return Answer(absent=_STARTED.format(path.component))
        return port

    def _is_expected(self, component: str) -> bool:
        """Whether an absent component is about to be made, or is being restarted by the supervision."""
        from aiorts.supervision import Supervising  # late: few kernels supervise

        supervising = self._links.kernel.attached(Supervising)
        one = None if supervising is None else supervising.supervised.get(component)
        return component in self._expected or (one is not None and one.helping)

    def _await(self, component: str, peer: Peer | None) -> bool:
        """Note that a kernel waits for the component; False: no kernel asks, or the kernel waits for too many."""
        waits = () if peer is None else self._waits.setdefault(peer, set())
        if peer is None or (len(waits) >= _AWAITED and component not in waits):
            return False
        self._waits[peer].add(component)
        self._awaited.setdefault(component, set()).add(peer)
        return True

    def _is_coming(self, component: str) -> bool:
        """Whether a component does not run yet: it is starting, or is being added and will be connected next."""
        registry = self._links.kernel.registry
        return component in self._starting or registry.is_arriving(self._links.kernel.components[component])

    @contextmanager
    def making(self) -> Iterator[None]:
        """A context manager around the time in which components are made that run later."""
        self._making = True
        try:
            yield
        finally:
            self._making = False

    def expect(self, component: str) -> None:
        """Expect a component that is about to be made: kernels that ask for it meanwhile hear that it is starting."""
        self._expected.add(component)

    def added(self, component: str) -> None:
        """Tell the kernels that wait for a component that it was added."""
        self._expected.discard(component)
        if self._making:
            self._starting.add(component)
        self._wake(component)

    def started(self) -> None:
        """Tell the waiting kernels of all components that were made: they run now."""
        for name in tuple(self._starting):
            self._has_come(name)

    def gone(self, peer: Peer) -> None:
        """Forget the components for which a kernel waited; the kernel is gone."""
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
        """Tell the kernels that wait for a component to ask again."""
        for peer in self._awaited.pop(component, ()):
            waits = self._waits[peer]
            waits.remove(component)
            if not waits:
                del self._waits[peer]
            self._links.run(told(self._links, peer, "come", component.encode()), "aiorts link")


@dataclass(frozen=True, slots=True)
class Departure:
    """An end of a link that was disconnected in this kernel; the other end does not know that yet."""

    far: Path
    """The port at the other end."""
    connector: str
    """The name that the connector had."""
    epoch: int
    """The epoch of the other end; 0: the other end has not answered, and may not exist."""
    own: int
    """The epoch of the end that was disconnected."""


class Departures:
    """Links that were disconnected while they were down: the other kernels hear that at once, or on their return.

    Args:
        connectors: gives the names of the present connectors; a connector made again is not reported as disconnected.
    """

    def __init__(self, kernels: Kernels, connectors: Callable[[], Container[str]]) -> None:
        self._kernels, self._connectors = kernels, connectors
        self._untold: deque[Departure] = deque(maxlen=_UNTOLD)

    def add(self, departure: Departure) -> None:
        """Report a link's disconnection to the other kernel: now, or when that kernel is back."""
        if (peer := self._kernels.peer_of(departure.far)) is not None:
            self._kernels.run(self._tell(peer, departure), "aiorts link")
        else:
            self._untold.append(departure)

    def back(self, peer: Peer) -> None:
        """Tell a kernel that has come back of the links that were disconnected meanwhile."""
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
