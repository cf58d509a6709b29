"""FlexiLogger: records the samples of its in-ports into a file, or replays a file from its out-ports.

    [components.log]
    type = "FlexiLogger"
    params.inputs = ["TimedPose2D", "TimedDouble"]
    params.names = ["pose", "speed"]
    params.logfile = "run.mcap"

    async with Kernel() as kernel:
        log = await kernel.create(FlexiLogger, inputs=("TimedDouble",), logfile="run.mcap")
        await kernel.connect(wheel.speed, log.ports["input0"], length=1000)
        await kernel.start(EventContext(), log, activate=True)
        await kernel.sleep(10.0)

The parameter `mode` chooses between recording and replaying, which are roles in `recording.py` and `replaying.py`. This
file has the user's side: parameters, options, ports and the service port.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar, Final, Protocol, cast

from aiorts import InPort, OutPort, Param, Provided
from aiorts.errors import ConfigurationError, StateError
from aiorts_flexi.common.base import FlexiComponent
from aiorts_flexi.common.options import TYPE_MODULES, VERBOSITY, Option
from aiorts_flexi.recordings.recording import Recording
from aiorts_flexi.recordings.replaying import REPLAY_OPTIONS, Playback, Replaying

_OF_THE_OTHER: Final = {
    "record": ("speed", "rate", "absolute", "begin", "end", "loop", "max_gap", "only", "skip", "remap", "strict"),
    "replay": ("encoding", "existing", "sync", "flush_age", "chunk", "queue", "rotate_size", "rotate_time", "min_free"),
}
"""Parameters without a meaning in a mode. A replay ignores types and names, as the original does."""


def _is_given(option: Option, value: object) -> bool:
    """Whether a parameter's option can have set this value."""
    return option.kind != "flag" or option.value == value


class BasicOperations(Protocol):
    """Starts and stops a logger while it is active."""

    async def start(self) -> bool:
        """Continue from now on; return whether it was stopped."""
        ...

    async def stop(self) -> bool:
        """Stop from now on; return whether it was running."""
        ...


class Role(Protocol):
    """The behaviour of a FlexiLogger in one of its modes. Plain methods never wait: they are hooks in any context.

    In a thread context all but `initialized` and `finalized` are called in that thread, else on the loop.
    """

    def ports_for(self, values: Mapping[str, Any]) -> Mapping[str, InPort[Any] | OutPort[Any]]:
        """The ports for these values, which are of this mode; nothing is changed."""
        ...

    def check_configuration(self, values: Mapping[str, Any]) -> Callable[[], None]:
        """Refuse values that contradict each other; return a function to call once values and ports are in force."""
        ...

    def initialized(self) -> None:
        """Called after the component was created."""
        ...

    def activated(self) -> None:
        """Called on the way to active."""
        ...

    def execute(self) -> None:
        """Called in each cycle while active."""
        ...

    def deactivated(self) -> None:
        """Called on the way out of active, also through a failure."""
        ...

    def start(self) -> bool:
        """Start between two cycles, as `BasicOperations.start` does."""
        ...

    def stop(self) -> bool:
        """Stop between two cycles, as `BasicOperations.stop` does."""
        ...

    async def wait_closed(self) -> None:
        """Wait until the files open at the deactivation are closed."""
        ...

    async def finalized(self) -> None:
        """Close everything: the component ends."""
        ...


class FlexiLogger(FlexiComponent):
    """Records the samples of its in-ports into a file, each once and in order, delaying no writer; or replays a file.

    The file is made when it is activated. Deactivated and activated again, it continues the same file.
    """

    mode = Param("record", choices=("record", "replay"), doc="what it does")
    inputs: tuple[str, ...] = Param((), type=tuple[str, ...], doc="record: types of the in-ports")
    names: tuple[str, ...] = Param(
        (), type=tuple[str, ...], doc='record: names of the in-ports; "" or missing: input0, input1, ...'
    )
    logfile = Param(Path("logger.mcap"), file="write", doc="the file; in a system file counted from the folder of that")
    paused = Param(False, doc="record: take samples and do not record them; replay: stand still")
    use_control = Param(False, doc="service port `Control`: stands still until `start()` is called")
    # Parameters of recording.
    text = Param(False, doc="record: a flat text file, a line for each sample")
    encoding = Param("msgpack", choices=("msgpack", "json"), doc="record: of the samples; json opens in Foxglove")
    existing = Param("refuse", choices=("refuse", "append", "overwrite"), doc="record: what if the file is there")
    sync = Param("never", choices=("never", "chunk", "record"), doc="record: when to wait for the disk")
    flush_age = Param(
        0.2, ge=0.001, le=3600.0, unit="s", doc="record: a chunk is written after that time at the latest"
    )
    chunk = Param(65_536, ge=1, le=2**26, unit="bytes", doc="record: a chunk is written when it is so large")
    queue = Param(100_000, ge=1, le=10_000_000, doc="record: samples that may wait for the disk; more are dropped")
    rotate_size = Param(0.0, ge=0.0, le=1e9, unit="MB", doc="record: begin the next file after so much; 0 is never")
    rotate_time = Param(0.0, ge=0.0, le=1e9, unit="s", doc="record: begin the next file after that time; 0 is never")
    min_free: float | None = Param(
        None, type=float | None, ge=0.0, le=1e12, unit="MB", doc="record: what stays free; None is 1 GiB, or 5 %"
    )
    # Parameters of replay.
    speed: float | None = Param(
        1.0, type=float | None, ge=0.1, le=1000.0, doc="replay: times as fast; None is as fast as the readers take it"
    )
    rate: float | None = Param(
        None, type=float | None, gt=0.0, le=1e6, unit="Hz", doc="replay: samples in a second, whatever their times are"
    )
    absolute = Param(False, doc="replay: time stamps as recorded; without, the first is the time now, and so on")
    begin = Param("", doc="replay: from there: +SECONDS after the first sample, or seconds since 1970")
    end = Param("", doc="replay: up to there, without it; as begin")
    loop = Param(1, ge=0, doc="replay: how often; 0 is without end")
    max_gap = Param(3600.0, gt=0.0, le=1e12, unit="s", doc="replay: of a gap in the recording no more is waited for")
    only: tuple[str, ...] = Param((), type=tuple[str, ...], doc="replay: names of the ports to replay; () is all")
    skip: tuple[str, ...] = Param((), type=tuple[str, ...], doc="replay: names of the ports that are left out")
    remap: tuple[str, ...] = Param((), type=tuple[str, ...], doc="replay: OLD=NEW, other names for ports")
    position = Param("", doc="replay: play from there, also while it runs; as begin")
    step = Param(0, ge=0, doc="replay: so many samples are sent although it is paused; raised by N, N more")
    strict = Param(False, doc="replay: a recording that was not closed is an error, as a damaged one is")

    help_text: ClassVar[str] = """
    \b
    Examples:
      aiorts flexiconst -p TimedDouble -c 1.5 -r 1000 --count 5000 | aiorts flexilogger -p TimedDouble -l run.mcap
      aiorts flexilogger -o -l run.mcap | aiorts flexidump -p TimedDouble
      aiorts log info run.mcap
    """
    interface: ClassVar[str] = "in: `input0`, `input1`, ..., or `names`; with -o out: the ports of the file"
    options: ClassVar[tuple[Option, ...]] = (
        Option(("-i", "--input"), "mode", "flag", "record (default)", value="record"),
        Option(("-o", "--output"), "mode", "flag", "replay the file", value="replay"),
        Option(("-p", "--port"), "inputs", "repeat", "record: type of an in-port; repeat for more", unless="-o"),
        Option(("-n", "--port-names"), "names", "text", "record: names of the in-ports, separated by commas"),
        Option(("-l", "--logfile"), "logfile", "text", "the file (default logger.mcap)"),
        Option(("-t", "--text"), "text", "flag", "record: a flat text file, a line for each sample"),
        Option(
            ("-c", "--use_control", "--use-control"), "use_control", "flag", "service port Control: start() and stop()"
        ),
        Option(("--paused",), "paused", "flag", "begin paused"),
        Option(("--json",), "encoding", "flag", "record: JSON messages, as Foxglove takes them", value="json"),
        Option(("--append",), "existing", "flag", "record: continue a file that is there", value="append"),
        Option(("--overwrite",), "existing", "flag", "record: replace a file that is there", value="overwrite"),
        Option(("--sync",), "sync", "text", "record: wait for the disk: never (default), chunk or record"),
        Option(("--flush-age",), "flush_age", "number", "record: seconds after which a chunk is written (default 0.2)"),
        Option(("--chunk",), "chunk", "number", "record: bytes after which it is (default 65536)"),
        Option(("--queue",), "queue", "number", "record: samples that may wait for the disk (default 100000)"),
        Option(("--rotate-size",), "rotate_size", "number", "record: MB after which the next file is begun"),
        Option(("--rotate-time",), "rotate_time", "number", "record: seconds after which it is"),
        Option(("--min-free",), "min_free", "number", "record: MB of the disk that stay free (default 1 GiB, or 5 %)"),
        *REPLAY_OPTIONS,
        TYPE_MODULES,
        replace(VERBOSITY, help="how much is logged: 0, 1 ports, 2 segments and pauses, 3 samples of each cycle"),
    )

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        self._recording: Final = Recording(self)
        self._replaying: Final = Replaying(self)
        self._roles: Final[dict[str, Role]] = {"record": self._recording, "replay": self._replaying}

    @property
    def role(self) -> Role:
        """The role of the mode in force."""
        return self._roles[self.mode]

    def ports_for(self, values: Mapping[str, Any]) -> Mapping[str, InPort[Any] | OutPort[Any]]:
        return self._roles[values["mode"]].ports_for(values)

    def check_configuration(self, values: Mapping[str, Any]) -> Callable[[], None]:
        if self._runs:
            for fixed in ("mode", "use_control"):
                if values[fixed] != getattr(self, fixed):
                    raise ConfigurationError(f"{self.name}.{fixed}: is said when it is created; create another one")
        for name in _OF_THE_OTHER[values["mode"]]:
            if values[name] != self.params[name].spec.default:
                flag = next(o.flags[-1] for o in self.options if o.param == name and _is_given(o, values[name]))
                other = "replay" if values["mode"] == "record" else "record"
                raise ConfigurationError(f"{self.name}.{name} ({flag}): does nothing unless mode = {other!r}")
        return self.taking(self._roles[values["mode"]].check_configuration(values))

    def on_initialize(self) -> None:
        self._add_services()
        self.role.initialized()
        super().on_initialize()

    def make_ports(self) -> None:
        super().make_ports()
        self._add_services()

    def _add_services(self) -> None:
        if self.use_control:
            self.add_port("Control", Provided[BasicOperations](instance="BasicOperations"))
            if self.mode == "replay":
                self.add_port("Playback", Provided[Playback](self._replaying, instance="Playback"))

    def on_activated(self) -> None:
        if self.use_control and not cast("Any", self.ports["Control"]).connectors:
            self.log.warning("stands still until Control.start() is called, and nothing is connected to Control yet")
        self.role.activated()

    def on_execute(self) -> None:
        self.role.execute()

    def on_deactivated(self) -> None:
        self.role.deactivated()

    async def on_finalize(self) -> None:
        await self.role.finalized()

    def on_reload(self, old: Any) -> None:
        if self.mode != "record":
            raise StateError(f"{self.name}: a replay is not reloaded; deactivate it, and create another one")
        self._recording.take_over(old._recording)

    async def wait_closed(self) -> None:
        """Wait until the file of a deactivated recorder is complete, which happens in the background."""
        await self.role.wait_closed()

    def start(self) -> bool:
        """Record, or replay, from now on; returns whether it was stopped."""
        return self.role.start()

    def stop(self) -> bool:
        """Stop from now on; returns whether it was running."""
        return self.role.stop()
