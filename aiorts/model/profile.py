"""Frozen descriptions and counters of a kernel's parts: the kernel cannot be edited through a report.

Every class here is plain data (`dataclasses.asdict` gives something JSON can carry), and says what *is*, never what
to do.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Final

from aiorts.errors import WiringError
from aiorts.late import dataclass
from aiorts.model.blame import Blame
from aiorts.model.buffer import DEFAULT_LENGTH, MAX_LENGTH, EmptyPolicy, FullPolicy
from aiorts.model.declared import OptionError, option
from aiorts.model.policy import Dataflow, OnLinkLost, Push, Stamp, Subscription
from aiorts.model.timing import Counted, Spans

if TYPE_CHECKING:
    from aiorts.model.connect_options import Converter

_NOTHING: Mapping[str, Any] = MappingProxyType({})
_NO_CYCLES: Final[Mapping[int, int]] = MappingProxyType({})


def _converter(value: Converter | str) -> str:
    """The converter of a function, or the one that a text names. OptionError: the value is neither."""
    from aiorts.model import converter  # late: few connectors have one

    if isinstance(value, converter.Converter):
        return value
    if isinstance(value, str):
        if not value.strip():
            raise OptionError(f"{value!r}: expected a text that names a converter; {converter.REMEDY}")
        return converter.Converter(value.strip(), of_text=True)
    try:
        return converter.Converter.of_function(value)
    except WiringError as error:
        raise OptionError(str(error)) from None


@dataclass(frozen=True, slots=True)
class ConnectorProfile:
    """The options in force of a connector."""

    name: str = option("", "The name of the connector.")
    ports: tuple[str, ...] = ()
    dataflow: Dataflow = option(
        Dataflow.PUSH,
        "The end that begins a transfer: with push the writer delivers, with pull the reader fetches the writer's "
        "latest unread sample.",
        end="writer",
    )
    subscription: Subscription = option(
        Subscription.FLUSH,
        "The moment at which the out-port sends: before a write returns (flush), soon after it, so that the writer "
        "never waits (new), or at push_rate (periodic).",
        words={"block": "flush", "nonblock": "new"},
        end="writer",
        shown=True,
    )
    push: Push = option(
        Push.ALL,
        "The samples of a backlog that are sent, with new and periodic: all, one at a time (fifo), every (skip + "
        "1)-th or the newest (new).",
        end="writer",
    )
    push_rate: float | None = option(
        None, "The rate of a periodic connector.", unit="Hz", low=0.001, high=1e6, end="writer", changes=True
    )
    skip: int = option(
        0,
        "The number of samples left out between two that are sent, with push skip.",
        low=0,
        high=MAX_LENGTH,
        end="writer",
    )
    length: int = option(
        DEFAULT_LENGTH,
        "The number of samples that the reader's buffer holds; with 0 a write waits until the reader has taken the "
        "sample.",
        low=0,
        high=MAX_LENGTH,
        end="reader",
        changes=True,
    )
    out_length: int = option(
        DEFAULT_LENGTH,
        "The number of samples that the backlog of a periodic connector holds.",
        low=1,
        high=MAX_LENGTH,
        end="writer",
    )
    full: FullPolicy = option(
        FullPolicy.OVERWRITE,
        "The effect of a write when the reader's buffer is full: it overwrites the oldest sample, is rejected, or "
        "blocks.",
        words={"do_nothing": "reject"},
        end="reader",
        changes=True,
    )
    empty: EmptyPolicy | None = option(
        None,
        "The effect of a read when there is nothing to read, in generic components; OpenRTM's, kept for its tools.",
        end="reader",
    )
    timeout: float | None = option(
        1.0,
        "The longest that an awaited write waits with full block; None waits forever.",
        unit="s",
        low=0.0,
        high=1e9,
        end="reader",
        endless=True,
    )
    stamp: Stamp | None = option(
        None,
        "The moment at which the connector sets `tm` to the kernel's clock; by default `tm` is what the writer said.",
        words={"on_send": "send", "on_received": "received", "on_read": "read", "on_write": "send", "none": ""},
        end="writer",
    )
    convert: str | None = option(
        None,
        "The converter of samples of the out-port into those of the in-port: a plain function, FILE.py:function, "
        "package.module:function, or a converter's name and its text, such as map 0>1000>0.",
        low=1,
        end="writer",
        takes=_converter,
    )
    measure: int = option(
        0,
        "The number of the last sends (`Connector.timing`) and reads (`latency`, `age` of the statistics) that are "
        "timed; 0 times nothing and costs nothing.",
        low=0,
        high=MAX_LENGTH,
        end="reader",
    )
    keep_last: bool = option(
        False,
        "Whether a new connector is offered the sample that the writer wrote last, also before it was made.",
        end="reader",
    )
    lifespan: float | None = option(
        None,
        "The longest that a sample waits to be read before it is dropped as expired. Of a link both ends count what a "
        "sample waits there, without the time on the way: the clocks of two kernels are not compared.",
        unit="s",
        low=1e-6,
        high=1e9,
        end="reader",
    )
    max_gap: float | None = option(
        None,
        "The longest time between two writes; after it the writer counts as silent while both ends are active, which "
        "is an event and a line in the log.",
        unit="s",
        low=0.001,
        high=1e9,
        end="reader",
    )
    extra: Mapping[str, str] = field(default_factory=lambda: _NOTHING)
    """Options that aiorts keeps and reports but does not act on."""
    on_link_lost: OnLinkLost | None = option(
        None,
        "The reaction to a lost link to the other kernel: the connector waits (the default of a link), moves "
        "the component to error, or ends. None where both ends are in one kernel.",
    )
    far_end: str = ""
    """The end that is in another kernel, "writer" or "reader"; "" where both are in this one."""


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
    """The number of times that the writer was silent for longer than `max_gap`."""
    silent: bool = False
    """Whether the writer is silent now."""
    at_ns: int = field(default=0, compare=False, repr=False)
    """The time of the statistics, on the kernel's monotonic clock; it does not count when statistics are compared."""
    mean_rate: float | None = field(default=None, compare=False, repr=False)
    """Samples written a second since the connector was made, or began to be measured; None without `measure`."""
    latency: Spans | None = field(default=None, compare=False, repr=False)
    """The times from write to read, on the kernel's clock, of the last `measure` reads; None without `measure`."""
    age: Spans | None = field(default=None, compare=False, repr=False)
    """The ages of these samples at their read: the kernel's time less their stamp `tm`; a `tm` of 0 is none. None
    without `measure`, and for a type without `tm`."""
    age_within_ns: int | None = field(default=None, compare=False, repr=False)
    """The possible error of `age` where stamps are of another machine, whose clock offset is estimated; else None."""
    acknowledged: int | None = None
    """At the writer's end of a link: samples that are in the reader's buffer, or were read, as far as it knows. Losses
    there are reported soon after the next acknowledgement. None at other ends."""
    in_flight: int = 0
    """At the writer's end of a link: samples that were sent and are not acknowledged yet."""
    round_trip_ns: int | None = field(default=None, compare=False, repr=False)
    """At the writer's end of a link: from a sample's sending to its acknowledgement, smoothed over some ten; the
    reader's end may keep the acknowledgement back for up to 50 ms. None where no trip has ended yet."""
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
    """The counts of `write_from_thread` at one out-port: accepted = written + waiting + sum(dropped.values())."""

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
    """Samples that were not accepted, because 1,024 waited."""
    at_ns: int = field(default=0, compare=False, repr=False)
    """The time of the statistics, on the kernel's monotonic clock."""
    mean_rate: float = field(default=0.0, compare=False, repr=False)
    """Samples accepted a second since the first call."""
    counted: ClassVar[str] = "accepted"


NO_THREAD_WRITES: Final = ThreadWriteStatistics(0, 0, 0, MappingProxyType({}), 0)


@dataclass(frozen=True, slots=True)
class ParameterProfile:
    """One parameter of a method of a service."""

    name: str
    type: str = ""
    """The annotation as it is written; empty without one."""
    default: str | None = None
    """The default as it is written; None where a value has to be given."""
    kind: str = "either"
    """The way in which it is given: "position", "keyword" or "either"."""


@dataclass(frozen=True, slots=True)
class MethodProfile:
    """One method of a service."""

    name: str
    parameters: tuple[ParameterProfile, ...] = ()
    returns: str = ""
    doc: str = ""
    plain: bool = False
    """Whether the method is a plain `def`, which never waits."""

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
    """The name of the instance, unique in its port."""
    polarity: str
    """ "provided" or "required"."""
    type: str
    methods: tuple[MethodProfile, ...] = ()
    bound_to: tuple[str, ...] = ()
    """Paths of the interfaces at the other ends, in the order of connection."""
    doc: str = ""


@dataclass(frozen=True, slots=True)
class PortProfile:
    """A description of a port: direction "in", "out" or "service", type name, unit, shape, connectors by name."""

    name: str
    direction: str
    type: str
    unit: str | None = None
    shape: tuple[int, ...] | None = None
    doc: str = ""
    connectors: tuple[str, ...] = ()
    interfaces: tuple[InterfaceProfile, ...] = ()
    """The interfaces of a service port."""


@dataclass(frozen=True, slots=True)
class ComponentProfile:
    """A description of a component: its type, ports, parameters in force, and its state in each context."""

    name: str
    type: str
    ports: tuple[PortProfile, ...]
    params: Mapping[str, Any]
    """Values in force, by name."""
    states: Mapping[str, str]
    """Lifecycle state by context."""
    last_error: str | None = None
    members: tuple[str, ...] = ()
    """The members of a composite, in order of execution."""


@dataclass(frozen=True, slots=True)
class HookStatistics:
    """The number and the durations of a hook's runs; times in nanoseconds."""

    count: int
    """The number of runs."""
    total_ns: int
    """The sum of all runs."""
    max_ns: int
    """The longest run."""


@dataclass(frozen=True, slots=True)
class ContextStatistics(Counted):
    """The counts of an execution context so far; times in nanoseconds."""

    cycles: int
    """Cycles that were run."""
    skipped: int = 0
    """Ticks that were left out because an earlier cycle ran over."""
    overruns: int = 0
    """Cycles that were not done when the next was due."""
    lateness_max_ns: int = 0
    """The longest time from a due tick to the start of a cycle: that tick's own or, after a stall, a newer one's."""
    lateness_total_ns: int = 0
    """The sum, over the cycles that were run, of the time from a cycle's own tick to its start."""
    hooks: Mapping[str, HookStatistics] = field(default_factory=lambda: _NOTHING)
    """The statistics by "component.hook", where execution times are taken."""
    policy: str = ""
    """The policy for missed ticks, "skip" or "catch_up"; empty for a context without a rate."""
    missed: Mapping[str, int] = field(default_factory=lambda: _NOTHING)
    """Overruns by the place that is to blame (`Blame.place`), at most 32 and "others"."""
    last_blame: Blame | None = None
    """The cause of the newest overrun."""
    at_ns: int = field(default=0, compare=False, repr=False)
    """The time of the statistics, on the kernel's monotonic clock; it does not count when statistics are compared."""
    lateness_stdev_ns: float = 0.0
    """The standard deviation of all cycles' lateness, counted as in `lateness_max_ns`."""
    lateness_p50_ns: int = 0
    """The lateness that half of the last 1,000 cycles did not exceed."""
    lateness_p99_ns: int = 0
    """The lateness that 99 % of the last 1,000 cycles did not exceed."""
    lateness_histogram: Mapping[int, int] = field(default_factory=lambda: _NO_CYCLES)
    """All cycles by their lateness. Each key is a power of two in nanoseconds, its count the number of cycles that were
    less late and are not in a smaller key; key 1 has those in time. Keys without cycles are left out."""
    counted: ClassVar[str] = "cycles"


@dataclass(frozen=True, slots=True)
class ContextProfile:
    """A description of an execution context: its kind, rate in Hz if it has one, and members in order of execution."""

    name: str
    kind: str
    rate: float | None
    """The rate in Hz; None for a context without one."""
    running: bool
    members: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class LogLine:
    """One of the last lines that a component logged."""

    monotonic_ns: int
    """The time of the line, on the kernel's clock; compare with `ClockReport.monotonic_ns`."""
    level: str
    text: str
    """At most 500 characters."""
    hook: str = ""
