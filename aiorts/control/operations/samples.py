"""Operations that move samples: out of a running system, and into it.

A tool reads or writes samples over a connector of its own, outside the system: the connector takes no place at a port,
and a run that ends does not wait for it. Its losses are not counted among those of the system.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, TypeAlias
from weakref import WeakKeyDictionary

from aiorts.clock import SimulatedClock
from aiorts.control.operation import Operation, Right
from aiorts.control.operations.tools import Tools
from aiorts.control.session import Session, Stream
from aiorts.errors import AbsentError, AiortsError, ClosedError, RecordError, WiringError, WriteTimeout
from aiorts.kernel.ports import InPort, OutPort
from aiorts.late import dataclass
from aiorts.observe import out_port_of, when_removed
from aiorts.sessions import WAITING, Made
from aiorts.types import full_name, has_tm, type_name, wire_name, wire_type
from aiorts.wire import LineReader, MsgpackCodec, schema_text, split_sample

if TYPE_CHECKING:
    from aiorts.kernel.ports.connector import Connector

_LINES: Final = 1_000
"""Lines that one call may inject."""
_LOOK: Final = 0.005
_ARRIVE: Final = 1.0
"""Seconds within which injected samples should reach another process."""
_REFUSED: Final = ("rejected", "timeout")
"""Reasons of drops that the write itself already reports to the writer."""


@dataclass(frozen=True, slots=True)
class Tapped:
    """An out-port whose samples are wanted."""

    port: str
    """ "component.port"."""
    frames: bool = False
    """Whether samples come encoded by the msgpack codec, for clients that have the type; else as plain data."""


@dataclass(frozen=True, slots=True)
class Tap:
    """The port and the type of the samples of a tap."""

    port: str
    type: str
    """The short name of the type."""
    full_type: str
    unit: str | None


@dataclass(frozen=True, slots=True)
class Tapping:
    """A sample of a tap: `data` or `frame`, as requested, or the error that keeps it from being sent."""

    time_ns: int
    """The time at which the tap took the sample: the kernel's clock, in nanoseconds since the epoch."""
    tm: int | None = None
    """The sample's time stamp in nanoseconds; None where its type has none."""
    data: Any = None
    frame: bytes | None = None
    error: str | None = None


@dataclass(frozen=True, slots=True)
class TypeNamed:
    """A type of samples."""

    type: str
    """The name in frames, or the full name."""


@dataclass(frozen=True, slots=True)
class TypeSchema:
    """The schema that explains the frames of a type to a client without the type."""

    type: str
    """The name in frames."""
    schema: str
    """A JSON Schema, as recordings have it."""


@dataclass(frozen=True, slots=True)
class Injected:
    """Samples for an in-port."""

    port: str
    lines: tuple[str, ...]
    """JSON lines, as filters read them: all are checked before the first is written; empty lines are skipped."""
    full: str = "reject"
    """The full policy of the connector: "reject", "overwrite" or "block"."""
    length: int = 8
    timeout: float | None = 1.0
    """Seconds that a write waits with full = "block"."""
    first: int = 1
    """The number of the first line, for errors."""
    check: bool = False
    """Whether the lines are only checked, and nothing is written."""
    wait: float = 0.0
    """Seconds to wait until all samples of this session to the port are delivered or dropped."""


@dataclass(frozen=True, slots=True)
class Written:
    """The outcome of injected samples."""

    written: int
    refused: int
    """Samples that were refused: the reader's buffer was full, also after `timeout`."""
    dropped: Mapping[str, int]
    """Samples dropped after the write, by reason; all samples of this session to the port are counted."""
    unread: int
    """Samples of this session that the reader has not read yet; they are lost when the session ends."""


class _Sample(Made):
    """A sample on its way to a client."""

    __slots__ = ("_frames", "_sample", "_time_ns")

    def __init__(self, sample: Any, time_ns: int, *, frames: bool) -> None:
        self._sample, self._time_ns, self._frames = sample, time_ns, frames

    def message(self) -> Any:
        try:
            if self._frames:
                frame = MsgpackCodec().encode(self._sample)
                return {"time_ns": self._time_ns, "tm": _stamp(self._sample), "frame": frame}
            tm, data = split_sample(self._sample)
        except (AiortsError, ValueError, TypeError) as error:
            return {"time_ns": self._time_ns, "error": str(error)}
        return {"time_ns": self._time_ns, "tm": tm, "data": data}


def _stamp(sample: Any) -> int | None:
    """The time stamp of a sample in nanoseconds; None where its type has none."""
    if not has_tm(type(sample)):
        return None
    return sample.tm if type(sample.tm) is int else int(sample.tm.ns)


def _tap(session: Session, given: Tapped, stream: Stream) -> Tap:
    """Send each sample from now on; a sample that a slow client has no room for is dropped and counted."""
    kernel, out = session.kernel, out_port_of(session.kernel, given.port)
    clock, loop = kernel.clock, kernel.loop
    simulated, due, lost = isinstance(clock, SimulatedClock), False, 0

    def drained() -> list[Any]:
        """The waiting samples. Samples dropped from the buffer are first counted as missed: they are older."""
        nonlocal lost
        samples, before = connector.in_.drain(), lost
        lost = sum(connector.statistics.dropped.values())
        stream.miss(lost - before)
        return samples

    def send() -> None:
        nonlocal due
        due = False
        now_ns = clock.time_ns()
        for sample in drained():
            stream.send(_Sample(sample, now_ns, frames=given.frames))

    def take(_: InPort[Any]) -> None:
        nonlocal due
        if simulated:
            send()  # a callback would be one more that is ready at this instant
        elif not due:
            due = True
            loop.call_soon(send)

    connector = kernel.service(Tools).tap(session.who, out, take, length=WAITING)

    def end(why: str) -> None:
        stream.finish(f"{given.port}: {why}")

    stream.on_close(connector.close)
    stream.on_finish(send)
    stream.on_close(when_removed(session.kernel.bus, given.port, end))
    return Tap(out.path, type_name(out.type), full_name(out.type), out.unit)


def _schema(_: Session, given: TypeNamed) -> TypeSchema:
    cls = wire_type(given.type)
    if cls is None:
        raise AbsentError(f"{given.type:.200}: no type of samples has this name here")
    return TypeSchema(wire_name(cls), schema_text(cls))


_Way: TypeAlias = tuple[str, int, str, float | None]
"""An in-port, and the options of a connector to it: length, full, timeout."""
_INJECTORS: Final[WeakKeyDictionary[Session, dict[_Way, Connector]]] = WeakKeyDictionary()
"""The connectors by which a session injects: one for each in-port and its options."""


async def _inject(session: Session, given: Injected) -> Written:
    """Write samples to an in-port over a connector that lasts as long as the session."""
    in_ = session.kernel.find(given.port)
    if isinstance(in_, OutPort):
        raise WiringError(f"{given.port}: is an out-port; samples are injected at an in-port")
    if not isinstance(in_, InPort):
        raise WiringError(f"{given.port}: is no in-port of samples")
    if len(given.lines) > _LINES:
        raise RecordError(f"inject: {len(given.lines)} lines; at most {_LINES} in a call")
    samples = _read(in_, given, session.kernel.time_ns())
    if given.check:
        return Written(0, 0, {}, 0)
    connector = _injector(session, in_, given)
    written = 0
    for sample in samples:
        if connector.closed:
            raise ClosedError(f"{given.port}: the port is gone; {written} of {len(samples)} samples were written")
        if given.full == "block":
            try:
                await connector.out.write(sample)
                written += 1
            except WriteTimeout:
                break
        else:
            written += connector.out.write_nowait(sample)
    ours = _injectors_at(session, given.port)
    await _taken(ours, given.wait or (_ARRIVE if connector.profile.far_end else 0.0))
    dropped: Counter[str] = Counter()
    for one in ours:
        dropped.update({why: n for why, n in one.statistics.dropped.items() if n and why not in _REFUSED})
    return Written(written, len(samples) - written, dict(dropped), sum(map(_unread, ours)))


def _unread(connector: Connector) -> int:
    """The number of written samples that are neither delivered nor dropped yet."""
    found = connector.statistics
    return 0 if connector.closed else found.buffered + found.in_flight


async def _taken(connectors: Sequence[Connector], within: float) -> None:
    """Wait until these connectors have delivered or dropped all samples, at most `within` seconds."""
    loop = asyncio.get_running_loop()
    until = loop.time() + within
    # The counts are polled: a notification of each read would cost every reader, and only `inject` needs it.
    while any(map(_unread, connectors)) and loop.time() < until:  # noqa: ASYNC110
        await asyncio.sleep(_LOOK)


def _read(in_: InPort[Any], given: Injected, now_ns: int) -> list[Any]:
    reader, samples = LineReader({in_.name: in_.type}), []
    for number, line in enumerate(given.lines, given.first):
        try:
            if line.strip():
                samples.append(reader.sample(line, now_ns)[1])
        except AiortsError as error:
            raise RecordError(f"{in_.path}: line {number}: {error}") from None
    return samples


def _injector(session: Session, in_: InPort[Any], given: Injected) -> Connector:
    """The connector of this session to an in-port with these options, made at the first use."""
    own, way = _INJECTORS.setdefault(session, {}), (given.port, given.length, given.full, given.timeout)
    connector = own.get(way)
    if connector is not None and not connector.closed and connector.in_ is in_:
        return connector
    options: Mapping[str, Any] = {"length": given.length, "full": given.full, "timeout": given.timeout}
    made = session.kernel.service(Tools).inject(session.who, in_, options)
    session.keep(when_removed(session.kernel.bus, given.port, lambda _: made.close()))
    session.keep(made.close)
    own[way] = made
    return made


def _injectors_at(session: Session, port: str) -> list[Connector]:
    return [connector for (at, *_), connector in _INJECTORS.get(session, {}).items() if at == port]


ROWS: Final = (
    Operation("inject", "Write samples to an in-port.", Injected, Written, Right.OPERATE, _inject),
    Operation(
        "schema", "What explains the frames of a type.", TypeNamed, TypeSchema, Right.VIEW, _schema, idempotent=True
    ),
    Operation("tap", "Stream the samples of an out-port.", Tapped, Tap, Right.VIEW, _tap, item=Tapping, end=str | None),
)
