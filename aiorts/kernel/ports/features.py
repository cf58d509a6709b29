"""What carries samples: the table of transports, and the features that options of a connector add to them.

A feature is a mixin of `Transport` and a row that says which connectors have it. Every other connector and port runs
the code it ran before: nothing there asks for features. The rows are in a room above (`kernel/quality/`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final, TypeVar

from anyio import WouldBlock

from aiorts.kernel.ports.connector import Connector
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
    """A row of the table of features: which connectors have it, and what their transports do besides."""

    key: str
    """The option that asks for it, for messages: no real-time thread has features at its ports."""
    wanted: Callable[[ConnectorProfile], bool]
    """Whether a connector with these options has it."""
    mixins: Callable[[], tuple[type[FeaturedTransport], type[FeaturedTransport]]]
    """The classes for connectors that carry samples at once, and at each period; asked for where it is wanted first."""
    settles: bool = False
    """Whether the reader's queue is settled (`Transport.settle`) before anybody looks at it, and `take` called."""
    asks: bool = False
    """Whether it is settled also while it holds nothing: a look at it may ask for a sample."""
    lock_free: bool = False
    """Whether a real-time thread may be at such a connector: as long as it is, the connector is without the feature."""


_FEATURES: Final[list[Feature]] = []


def offer(*features: Feature) -> None:
    """From now on there are these features; of several at one connector the first is the outermost."""
    _FEATURES.extend(feature for feature in features if feature not in _FEATURES)


def features_of(profile: ConnectorProfile) -> list[Feature]:
    """Those that a connector with these options has."""
    return [feature for feature in _FEATURES if feature.wanted(profile)]


class TransportKind:
    """A row of the table of transports: the classes that carry samples in one way.

    An option that changes how samples are carried has no class here: `of` puts the mixins of its `Feature` before the
    class. A mixin derives from `FeaturedTransport`, has empty `__slots__`, keeps its state in `extra` under its key,
    and calls `super()` in whatever it overrides, so that it goes with listeners, periods and other features.

    Args:
        receiver: of the in-port.
        at_once: of a connector whose samples can be read as soon as they are written.
        periodic: of one whose samples move at each period of its `push_rate`.
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
        """The class for connectors with these options."""
        periodic = profile.subscription is Subscription.PERIODIC and profile.dataflow is Dataflow.PUSH
        periodic = periodic and profile.far_end != "writer"  # else it is the writer's end that has the period
        plain = self.periodic if periodic else self.at_once
        found = features_of(profile) if self.featured else ()
        return _composed(plain, tuple(feature.mixins()[periodic] for feature in found))

    def receiver_of(self, connectors: Iterable[Connector]) -> type[Receiver]:
        """The class for an in-port with these connectors."""
        return _composed(self.receiver, _receiver_mixins(connectors) if self.featured else ())


class FeaturedTransport(Transport):
    """A transport with a feature: a write asks it first, and never goes straight into the queue. See `Transport`."""

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
        """Take a sample out of the middle of the reader's queue: its writer gave up."""
        del self.queue[place]


class SettlingReceiver(Receiver):
    """The receiver of an in-port where a queue is settled before anybody looks at it. See `Receiver`."""

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
        # Of several connectors the one whose sample is the oldest, again while settling took that away.
        while (found := super().next()) is not None:
            found.settle()
            if found is super().next():
                return found
        return None

    def newest(self) -> Transport | None:
        for transport in self.transports:
            transport.settle()
        return super().newest()

    def drain(self) -> list[Any]:
        samples: list[Any] = []
        with self.guard(), suppress(WouldBlock):  # the last one was there, and has expired in this moment
            if (now := self.port._receiver) is not self:
                return now.drain()
            while self.unread():
                samples.append(self.port.read_nowait())
        return samples

    def drain_sources(self) -> list[tuple[Connector, Any]]:
        pairs: list[tuple[Connector, Any]] = []
        with self.guard(), suppress(WouldBlock):  # as above
            if (now := self.port._receiver) is not self:
                return now.drain_sources()
            while self.unread():
                sample, source = self.port.read_nowait(), self.last_source
                assert source is not None  # noqa: S101 - it was read
                pairs.append((source, sample))
        return pairs


class AskingReceiver(SettlingReceiver):
    """The receiver of an in-port where each look may ask a writer for a sample. See `Receiver`."""

    __slots__ = ()

    def next(self) -> Transport | None:
        for transport in self.transports:
            transport.settle()
        return super().next()


def fit_receiver(port: InPort[Any]) -> Receiver:
    """Have the in-port's queues settled while one of its connectors needs it; the caller holds the lock, refreshes."""
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
    """Whether the reader of such a connector has its queue settled first."""
    return any(feature.settles for feature in features_of(profile))


_COMPOSED: Final[dict[tuple[type[Any], ...], Any]] = {}


def _composed(plain: type[T], mixins: tuple[type[Any], ...]) -> type[T]:
    """The class with these mixins before it; one for each choice."""
    bases = (*mixins, plain)
    if not mixins:
        return plain
    if bases not in _COMPOSED:
        _COMPOSED[bases] = type("".join(base.__name__ for base in bases), bases, {"__slots__": ()})
    made: type[T] = _COMPOSED[bases]
    return made


PLAIN = TransportKind(Receiver, Transport, PeriodicTransport)
"""What carries samples where no real-time thread and no listener is."""
