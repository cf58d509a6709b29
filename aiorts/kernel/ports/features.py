"""The table of transports, which carry samples, and the features that options of a connector add to them.

A feature is a mixin of `Transport` and a row that says which connectors have it. Other connectors and ports run code
that never asks for features. The rows are in a room above (`kernel/quality/`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final, TypeVar

from anyio import WouldBlock

from aiorts.kernel.ports.connector import Connector
from aiorts.kernel.ports.current import at_current
from aiorts.kernel.ports.periodic_transport import PeriodicTransport
from aiorts.kernel.ports.receiver import Receiver
from aiorts.kernel.ports.transport import Transport
from aiorts.late import dataclass
from aiorts.model.policy import Dataflow, Subscription

if TYPE_CHECKING:
    from aiorts.kernel.ports.host import KernelSide
    from aiorts.kernel.ports.in_port import InPort
    from aiorts.model.profile import ConnectorProfile

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Feature:
    """A row of the table of features: which connectors have the feature, and what it adds to their transports."""

    key: str
    """The option that asks for the feature; also named when a real-time thread's port refuses the feature."""
    wanted: Callable[[ConnectorProfile], bool]
    """Whether a connector with these options has the feature."""
    mixins: Callable[[], tuple[type[FeaturedTransport], type[FeaturedTransport]]]
    """Returns the mixins for connectors that carry samples at once, and for periodic ones; called only when needed."""
    settles: bool = False
    """Whether each read first settles the reader's queue (`Transport.settle`) and then takes the sample by `take`."""
    asks: bool = False
    """Whether an empty queue is settled, too: settling may ask the writer for a sample."""
    lock_free: bool = False
    """Whether a real-time thread may use such a connector: while one does, the connector is without the feature."""


ORDER: Final = ("convert", "lifespan", "length = 0", "measure", "on_link_lost", "stamp = send", "dataflow = pull")
"""The keys of all features, outermost first: at a connector with several, the first sees a sample before the others."""
_FEATURES: Final[list[Feature]] = []


def offer(*features: Feature) -> None:
    """Add these features to the table, sorted by `ORDER`; features with the same key keep their order."""
    _FEATURES[:] = sorted(dict.fromkeys((*_FEATURES, *features)), key=lambda feature: ORDER.index(feature.key))


def features_of(profile: ConnectorProfile) -> list[Feature]:
    """The features of a connector with these options."""
    return [feature for feature in _FEATURES if feature.wanted(profile)]


class TransportKind:
    """A row of the table of transports: the classes that carry samples in one way.

    An option that changes how samples are carried has no class here: `of` puts the mixins of its `Feature` before the
    class. A mixin derives from `FeaturedTransport`, has empty `__slots__`, keeps its state in `extra` under its key,
    and calls `super()` in each method that it overrides, so that it goes with listeners, periods and other features.

    Args:
        receiver: the class of the in-port's receiver.
        at_once: the transport of a connector whose samples can be read as soon as they are written.
        periodic: the transport of a connector whose samples move at each period of its `push_rate`.
        featured: whether features are added.
    """

    def __init__(
        self,
        receiver: type[Receiver],
        at_once: type[Transport],
        periodic: type[Transport],
        *,
        featured: bool = True,
    ) -> None:
        self.receiver, self.at_once, self.periodic, self.featured = receiver, at_once, periodic, featured
        receiver.kind = at_once.kind = periodic.kind = self

    def of(self, profile: ConnectorProfile) -> type[Transport]:
        """The transport class for connectors with these options."""
        periodic = profile.subscription is Subscription.PERIODIC and profile.dataflow is Dataflow.PUSH
        periodic = periodic and profile.far_end != "writer"  # over a link, the writer's end has the period
        plain = self.periodic if periodic else self.at_once
        found = features_of(profile) if self.featured else ()
        return _composed(plain, tuple(feature.mixins()[periodic] for feature in found))

    def receiver_of(self, connectors: Iterable[Connector]) -> type[Receiver]:
        """The receiver class for an in-port with these connectors."""
        return _composed(self.receiver, _receiver_mixins(connectors) if self.featured else ())


class FeaturedTransport(Transport):
    """A transport with a feature: each write goes through `offer`, never straight into the queue. See `Transport`."""

    __slots__ = ()
    admits_plainly = False
    extra: dict[str, Any]

    def __init__(self, connector: Connector, receiver: Receiver, kernel: KernelSide) -> None:
        super().__init__(connector, receiver, kernel)
        self.extra = {}

    def take_over(self, old: Transport, receiver: Receiver) -> None:
        super().take_over(old, receiver)
        self.extra = old.extra if isinstance(old, FeaturedTransport) else {}

    @property
    def direct(self) -> bool:
        return False

    def must_wait(self) -> bool:
        self.settle()
        return super().must_wait()

    def offer(self, sample: Any) -> bool:
        self.settle()
        return super().offer(sample)

    def take_out(self, place: int) -> None:
        """Remove the sample at index `place` from the reader's queue: its writer gave up."""
        del self.queue[place]


class SettlingReceiver(Receiver):
    """The receiver of an in-port whose queues are settled before they are read. See `Receiver`."""

    __slots__ = ()
    has_fast_path = False

    def unread(self) -> bool:
        with self.guard():
            return self.next() is not None

    def next(self) -> Transport | None:
        if self.tokens is None:
            if self.sole is not None:
                self.sole.settle()
            return super().next()
        # If settling removed the oldest sample, the connector with the next oldest is searched.
        while (found := super().next()) is not None:
            found.settle()
            if found is super().next():
                return found
        return None

    def newest(self) -> Transport | None:
        for transport in self.transports:
            transport.settle()
        return super().newest()

    @at_current
    def drain(self) -> list[Any]:
        samples: list[Any] = []
        with suppress(WouldBlock):  # the last sample was there, and expired just now
            while self.unread():
                samples.append(self.port.read_nowait())
        return samples

    @at_current
    def drain_sources(self) -> list[tuple[Connector, Any]]:
        pairs: list[tuple[Connector, Any]] = []
        with suppress(WouldBlock):  # as above
            while self.unread():
                sample, source = self.port.read_nowait(), self.last_source
                assert source is not None  # noqa: S101 - it was read
                pairs.append((source, sample))
        return pairs


class AskingReceiver(SettlingReceiver):
    """The receiver of an in-port that may ask writers for a sample whenever it is read. See `Receiver`."""

    __slots__ = ()

    def next(self) -> Transport | None:
        for transport in self.transports:
            transport.settle()
        return super().next()


def fit_receiver(port: InPort[Any]) -> Receiver:
    """Give the in-port the receiver that its connectors need; the caller holds the lock and refreshes the port."""
    receiver = port._receiver
    kind = type(receiver).kind
    if type(receiver) is not kind.receiver_of(port._connectors):
        receiver.settle_tokens()
        receiver = receiver.replace(kind, all_transports=False)
        receiver.refresh_writers()
    return receiver


def _receiver_mixins(connectors: Iterable[Connector]) -> tuple[type[Receiver], ...]:
    found = [feature for connector in connectors for feature in features_of(connector.profile)]
    if any(feature.asks for feature in found):
        return (AskingReceiver,)
    return (SettlingReceiver,) if any(feature.settles for feature in found) else ()


def settles(profile: ConnectorProfile) -> bool:
    """Whether the reader's queue of a connector with these options is settled before it is read."""
    return any(feature.settles for feature in features_of(profile))


_COMPOSED: Final[dict[tuple[type[Any], ...], Any]] = {}


def _composed(plain: type[T], mixins: tuple[type[Any], ...]) -> type[T]:
    """A class derived from these mixins and `plain`, made once for each combination."""
    bases = (*mixins, plain)
    if not mixins:
        return plain
    if bases not in _COMPOSED:
        _COMPOSED[bases] = type("".join(base.__name__ for base in bases), bases, {"__slots__": ()})
    made: type[T] = _COMPOSED[bases]
    return made


PLAIN = TransportKind(Receiver, Transport, PeriodicTransport)
"""The transports of connectors without a real-time thread and without a listener."""
