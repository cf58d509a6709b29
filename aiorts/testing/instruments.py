"""The hidden component of a rig: its out-ports feed in-ports, its in-ports tap out-ports. It is in no context.

A tap takes each sample in the very call that writes it, so that its time is exact and no buffer can overflow.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from aiorts.kernel import Component, InPort, OutPort
from aiorts.kernel.ports.in_port import receiver_of
from aiorts.services import Provided, Required

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine

    from aiorts.services import ServiceEnd

_LENGTH: Final = 1_000_000
"""Samples that may be fed at once; a tap needs as many only where the writer is in another thread."""

_ENOUGH: Final = 60.0
"""Virtual seconds that a test waits for the answer to a call."""


class Tap:
    """The samples that one out-port has written, and their times (nanoseconds of the kernel clock's `monotonic_ns`)."""

    def __init__(self, out: OutPort[Any], now_ns: Callable[[], int], note: Callable[[Any], bytes] | None) -> None:
        self.out = out
        self.samples: list[Any] = []
        self.times: list[int] = []
        self.notes: list[bytes] = []
        """The result of `note` for each sample as it arrived."""
        self._now_ns = now_ns
        self._note = note

    def take(self, port: InPort[Any]) -> bool:
        """Take the samples that have arrived; called by the port itself."""
        for sample in port.drain():
            self.samples.append(sample)
            self.times.append(self._now_ns())
            if self._note is not None:
                self.notes.append(self._note(sample))
        return True

    def clear(self) -> None:
        """Forget what was taken."""
        self.samples.clear()
        self.times.clear()
        self.notes.clear()


class Instruments(Component):
    """The component that a rig adds to its kernel, besides the components under test."""

    def __init__(self, note: Callable[[Any], bytes] | None = None) -> None:
        super().__init__("rig_instruments")
        self.taps: dict[OutPort[Any], Tap] = {}
        self._note = note
        self._feeds: dict[InPort[Any], OutPort[Any]] = {}
        self._asks: dict[ServiceEnd[Any], Required[Any]] = {}
        self._made = 0

    def tap(self, out: OutPort[Any]) -> None:
        """Tap the samples that `out` writes from now on, if it can have one more connector."""
        if out in self.taps or (out.max_connectors is not None and len(out.connectors) >= out.max_connectors):
            return
        port = self.add_port(self._name("tap"), InPort(out.type, unit=out.unit, shape=out.shape))
        at_once(self.kernel.connect(out, port, length=_LENGTH))
        tap = self.taps[out] = Tap(out, self.clock.monotonic_ns, self._note)
        receiver_of(port).add_callback(tap.take)

    def make_room(self, out: OutPort[Any]) -> None:
        """Remove the tap of an out-port that can have no second connector."""
        tap = self.taps.get(out)
        if tap is None or out.max_connectors is None or len(out.connectors) < out.max_connectors:
            return
        for connector in out.connectors:
            if connector.in_.path.startswith(f"{self.name}."):
                at_once(self.kernel.disconnect(connector))
                del self.taps[out]
                return

    def feed(self, port: InPort[Any]) -> OutPort[Any]:
        """The out-port that feeds `port`."""
        if port not in self._feeds:
            out = self.add_port(self._name("feed"), OutPort(port.type, unit=port.unit, shape=port.shape))
            at_once(self.kernel.connect(out, port, length=_LENGTH))
            self._feeds[port] = out
        return self._feeds[port]

    def provide(self, end: ServiceEnd[Any], fake: object) -> None:
        """Connect `fake` as the provider of a required interface."""
        provided: Any = Provided[end.interface]  # type: ignore[name-defined] # known when it runs
        at_once(self.kernel.connect(end, self.add_port(self._name("fake"), provided(fake, concurrent=True))))

    def ask(self, end: ServiceEnd[Any]) -> Required[Any]:
        """The required interface that calls a provided one, made at the first call."""
        if end not in self._asks:
            required: Any = Required[end.interface]  # type: ignore[name-defined] # known when it runs
            self._asks[end] = self.add_port(self._name("ask"), required(timeout=_ENOUGH))
            at_once(self.kernel.connect(self._asks[end], end))
        return self._asks[end]

    def _name(self, stem: str) -> str:
        self._made += 1
        return f"{stem}{self._made}"


def at_once(work: Coroutine[Any, Any, Any]) -> Any:
    """Run a coroutine that does not wait, such as connecting within a process, and return its result."""
    try:
        work.send(None)
    except StopIteration as done:
        return done.value
    work.close()
    raise RuntimeError(f"{work!r}: waits, and cannot be run at once")
