"""Frozen descriptions and counters of what exists: the kernel cannot be edited through a report.

Every class here is plain data (`dataclasses.asdict` gives something JSON can carry), and says what *is*, never what
to do.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from types import MappingProxyType
from typing import Any, ClassVar, Final

from aiorts.late import dataclass
from aiorts.model.blame import Blame
from aiorts.model.buffer import EmptyPolicy, FullPolicy
from aiorts.model.policy import Dataflow, OnLinkLost, Push, Stamp, Subscription
from aiorts.model.rates import Counted
from aiorts.model.timing import Spans

_NOTHING: Mapping[str, Any] = MappingProxyType({})
_NO_CYCLES: Final[Mapping[int, int]] = MappingProxyType({})


@dataclass(frozen=True, slots=True)
class ConnectorProfile:
    """The options in force of a connector."""

    name: str
    ports: tuple[str, ...] = ()
    dataflow: Dataflow = Dataflow.PUSH
    """Whether the writer delivers (push) or the reader fetches (pull)."""
    subscription: Subscription = Subscription.FLUSH
    """When samples are passed on."""
    push: Push = Push.ALL
    """Which samples of a backlog are passed on."""
    push_rate: float | None = None
    """Hz; only with subscription periodic."""
    skip: int = 0
    """With push skip: samples left out between two."""
    length: int = 8
    """Samples that the reader's buffer holds; 0: a write waits until the reader has taken the sample."""
    out_length: int = 8
    """Samples that the backlog of a periodic connector holds."""
    full: FullPolicy = FullPolicy.OVERWRITE
    """What a write does when the buffer is full."""
    empty: EmptyPolicy | None = None
    """OpenRTM's empty policy where one was given: kept, and used by generic components only."""
    timeout: float | None = 1.0
    """Seconds that an awaited write waits with full = block; None waits forever."""
    stamp: Stamp | None = None
    """When the connector stamps samples; None leaves the writer's stamp."""
    convert: str | None = None
    """What makes the reader's samples of the writer's: the text that finds it, or the qualified name of a function."""
    measure: int = 0
    """Sends (`Connector.timing`) and reads (`ConnectorStatistics.latency`, `age`) that are timed; 0 times nothing and
    costs nothing."""
    keep_last: bool = False
    """Whether a new connector is offered the sample that the writer wrote last, also before it was made."""
    lifespan: float | None = None
    """Seconds after which a sample that was not read is dropped; None keeps it. Of a link both ends count what a sample
    waits there; the time on the way is not counted, since the clocks of two kernels are not compared."""
    max_gap: float | None = None
    """Seconds without a write after which the writer counts as silent, while both ends are active; None never."""
    extra: Mapping[str, str] = field(default_factory=lambda: _NOTHING)
    """Options that aiorts keeps and reports but does not act on."""
    on_link_lost: OnLinkLost | None = None
    """What happens when the link to the reader's kernel is lost; None where both ends are in one kernel."""
    far_end: str = ""
    """Which end is in another kernel, "writer" or "reader"; "" where both are in this one."""


@dataclass(frozen=True, slots=True)
class ConnectorStatistics(Counted):
    """The ledger of a connector at one moment: written = delivered + sum(dropped.values()) + buffered.

    Where the reader is in another kernel, the writer's end cannot know what was read: there `delivered` is None and
    written = acknowledged + sum(dropped.values()) + buffered + in_flight.
    """

    written: int
    """Samples that the writer sent."""
    delivered: int | None
    """Samples that the reader read; None at the writer's end of a link."""
    buffered: int
    """Samples that wait to be read."""
    dropped: Mapping[str, int]
    """Samples that were lost, by reason."""
    missed_gaps: int = 0
    """How often the writer was silent for longer than `max_gap`."""
    silent: bool = False
    """Whether it is."""
    at_ns: int = field(default=0, compare=False, repr=False)
    """When, on the kernel's monotonic clock. Statistics with equal counts are equal, whenever they were taken."""
    mean_rate: float | None = field(default=None, compare=False, repr=False)
    """Samples written a second since the connector was made, or began to be measured; None without `measure`."""
    latency: Spans | None = field(default=None, compare=False, repr=False)
    """From the write to the read, on the kernel's clock, of the last `measure` samples read; None without `measure`."""
    age: Spans | None = field(default=None, compare=False, repr=False)
    """How old these were when they were read: the kernel's time less their stamp `tm`; a `tm` of 0 is none. None
    without `measure`, and for a type without `tm`."""
    age_within_ns: int | None = field(default=None, compare=False, repr=False)
    """How far `age` may be off, where the stamps are of another machine: its clock's offset is estimated; else None."""
    acknowledged: int | None = None
    """At the writer's end of a link: samples that are in the reader's buffer, or were read, as far as it knows: what is
    lost there is reported soon after the next acknowledgement. Else None."""
    in_flight: int = 0
    """At the writer's end of a link: samples that were sent and are not acknowledged yet."""
    round_trip_ns: int | None = field(default=None, compare=False, repr=False)
    """At the writer's end of a link: from a sample's sending to its acknowledgement, smoothed over some ten; the
    reader's end may keep that back for up to 50 ms. None where no trip has ended yet."""
    counted: ClassVar[str] = "written"

    @property
    def balanced(self) -> bool:
        """Whether the sum is right; it always is."""
        return self.written == self.arrived + sum(self.dropped.values()) + self.buffered + self.in_flight

    @property
    def arrived(self) -> int:
        """Samples that this end knows to have arrived: delivered, or at the writer's end of a link acknowledged."""
        return (self.acknowledged or 0) if self.delivered is None else self.delivered


@dataclass(frozen=True, slots=True)
class ThreadWriteStatistics(Counted):
    """What became of `write_from_thread` at one out-port: accepted = written + waiting + sum(dropped.values())."""

    accepted: int
    """Samples that were taken."""
    written: int
    """Samples that the loop has passed on to the connectors, whose ledgers count them."""
    waiting: int
    """Samples that wait for the loop, or for room at a reader."""
    dropped: Mapping[str, int]
    """Samples that were lost, by reason: "timeout" (a reader with full = block had no room in time; others have the
    sample), "closed" (the port or the kernel was closed first)."""
    refused: int
    """Samples that were not accepted, since 1,024 waited."""
    at_ns: int = field(default=0, compare=False, repr=False)
    """When, on the kernel's monotonic clock."""
    mean_rate: float = field(default=0.0, compare=False, repr=False)
    """Samples accepted a second since the first call."""
    counted: ClassVar[str] = "accepted"


NO_THREAD_WRITES: Final = ThreadWriteStatistics(0, 0, 0, MappingProxyType({}), 0)


@dataclass(frozen=True, slots=True)
class ParameterProfile:
    """One parameter of a method of a service."""

    name: str
    type: str = ""
    """As it is written; empty where it is not."""
    default: str | None = None
    """As it is written; None where a value has to be given."""
    kind: str = "either"
    """How it is given: "position", "keyword" or "either"."""


@dataclass(frozen=True, slots=True)
class MethodProfile:
    """One method of a service."""

    name: str
    parameters: tuple[ParameterProfile, ...] = ()
    returns: str = ""
    doc: str = ""
    plain: bool = False
    """Whether it is a plain `def`, which never waits."""

    def __str__(self) -> str:
        parts: list[str] = []
        for parameter in self.parameters:
            if parameter.kind == "keyword" and "*" not in parts:
                parts.append("*")
            default = "" if parameter.default is None else f" = {parameter.default}"
            parts.append(f"{parameter.name}{': ' if parameter.type else ''}{parameter.type}{default}")
        if by_position := sum(parameter.kind == "position" for parameter in self.parameters):
            parts.insert(by_position, "/")
        arrow = f" -> {self.returns}" if self.returns else ""
        return f"{'' if self.plain else 'async '}{self.name}({', '.join(parts)}){arrow}"


@dataclass(frozen=True, slots=True)
class InterfaceProfile:
    """One interface of a service port."""

    name: str
    """Of the instance: unique in its port."""
    polarity: str
    """ "provided" or "required"."""
    type: str
    methods: tuple[MethodProfile, ...] = ()
    bound_to: tuple[str, ...] = ()
    """Paths of the interfaces at the other ends, in the order of connection."""
    doc: str = ""


@dataclass(frozen=True, slots=True)
class PortProfile:
    """What a port is: direction "in", "out" or "service", type name, unit, shape, connectors by name."""

    name: str
    direction: str
    type: str
    unit: str | None = None
    shape: tuple[int, ...] | None = None
    doc: str = ""
    connectors: tuple[str, ...] = ()
    interfaces: tuple[InterfaceProfile, ...] = ()
    """Of a service port."""


@dataclass(frozen=True, slots=True)
class ComponentProfile:
    """What a component is: its type, ports, parameters in force, and its state in each context."""

    name: str
    type: str
    ports: tuple[PortProfile, ...]
    params: Mapping[str, Any]
    """Values in force, by name."""
    states: Mapping[str, str]
    """Lifecycle state by context."""
    last_error: str | None = None
    members: tuple[str, ...] = ()
    """Of a composite, in order of execution."""


@dataclass(frozen=True, slots=True)
class HookStatistics:
    """How often a hook ran and how long it took, in nanoseconds."""

    count: int
    """Runs."""
    total_ns: int
    """All runs together."""
    max_ns: int
    """The longest run."""


@dataclass(frozen=True, slots=True)
class ContextStatistics(Counted):
    """What an execution context has done so far; times in nanoseconds."""

    cycles: int
    """Cycles that were run."""
    skipped: int = 0
    """Ticks that were left out because an earlier cycle ran over."""
    overruns: int = 0
    """Cycles that were not done when the next was due."""
    lateness_max_ns: int = 0
    """The longest that a tick was due before a cycle began, be it that tick's own or, after a stall, a newer one's."""
    lateness_total_ns: int = 0
    """Sum over the cycles that were run of how long after its own tick each began."""
    hooks: Mapping[str, HookStatistics] = field(default_factory=lambda: _NOTHING)
    """By "component.hook", where execution times are taken."""
    policy: str = ""
    """What is done about missed ticks, "skip" or "catch_up"; empty for a context without a rate."""
    missed: Mapping[str, int] = field(default_factory=lambda: _NOTHING)
    """Overruns by who is to blame (`Blame.place`), at most 32 and "others"."""
    last_blame: Blame | None = None
    """Who made the newest overrun late."""
    at_ns: int = field(default=0, compare=False, repr=False)
    """When, on the kernel's monotonic clock. Statistics with equal counts are equal, whenever they were taken."""
    lateness_stdev_ns: float = 0.0
    """Standard deviation over all cycles of how late each began, counted as in `lateness_max_ns`."""
    lateness_p50_ns: int = 0
    """What half of the last 1,000 cycles were not later than."""
    lateness_p99_ns: int = 0
    """What 99 % of the last 1,000 cycles were not later than."""
    lateness_histogram: Mapping[int, int] = field(default_factory=lambda: _NO_CYCLES)
    """All cycles by how late each began: each key is a power of two in nanoseconds, its count that of the cycles that
    were less late and not in a smaller key; 1 is of those in time. Keys without cycles are left out."""
    counted: ClassVar[str] = "cycles"


@dataclass(frozen=True, slots=True)
class ContextProfile:
    """What an execution context is: its kind, rate in Hz if it has one, and the members in order of execution."""

    name: str
    kind: str
    rate: float | None
    """Hz; None for a context without a rate."""
    running: bool
    members: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class LogLine:
    """One of the last lines that a component logged."""

    monotonic_ns: int
    """When, on the kernel's clock; compare with `ClockReport.monotonic_ns`."""
    level: str
    text: str
    """At most 500 characters."""
    hook: str = ""
