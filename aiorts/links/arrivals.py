"""Components that other kernels wait for: who is told when one has come, and is ready for what waited for it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

from aiorts.errors import LinkError, WiringError
from aiorts.kernel.loop.bus import StateChanged
from aiorts.kernel.ports import InPort
from aiorts.links.messages import Answer
from aiorts.model.lifecycle import LifecycleState

if TYPE_CHECKING:
    from aiorts.kernel.ports import Port
    from aiorts.links.kernels import Kernels
    from aiorts.links.transport import Caller, Peer
    from aiorts.model.names import Path

_AWAITED: Final = 10_000
"""Components that are not there whose coming other kernels are told of."""
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

    def there(self, path: Path, caller: Caller) -> Port[Any] | Answer:
        """The port of this kernel that another one means; where it is not there, the other hears when it comes."""
        kernel = self._links.kernel
        try:
            port = kernel.registry.port(str(replace(path, kernel="", host="")))
            # What is written to it would be dropped; what it writes must have a way; calls are answered in any state.
            if path.component in self._starting and caller.peer is not None and isinstance(port, InPort):
                self._awaited.setdefault(path.component, set()).add(caller.peer)
                return Answer(absent=f"{path.component} is being started")
            return port
        except WiringError as error:
            if path.component in kernel.components or caller.peer is None or len(self._awaited) >= _AWAITED:
                raise
            self._awaited.setdefault(path.component, set()).add(caller.peer)
            return Answer(absent=str(error))

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
        try:
            await self._links.ask(peer, "come", component.encode(), _SECONDS)
        except LinkError:
            return  # it has gone, and asks anew when it comes back
