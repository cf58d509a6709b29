"""The recording role of FlexiLogger: reads its in-ports and hands the samples to a background recording, never waiting.

The log time of a sample is the time of its read: the kernel's clock at the activation, and from there on its monotonic
time. Its publish time is its own `tm`.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from aiorts import EventContext, InPort, SimulatedClock
from aiorts.errors import ConfigurationError
from aiorts.types import type_name
from aiorts_flexi.common.ports import named_types
from aiorts_log import (
    MISSED,
    BackgroundRecording,
    MakeWriter,
    Notice,
    RecordingError,
    RecordingOptions,
    RecordingWriter,
    TextWriter,
    about_system,
    check_parts,
    check_target,
)

if TYPE_CHECKING:
    from aiorts_flexi.recordings.logger import FlexiLogger

_AT_ONCE: Final = 1000
"""The most samples read from a port in one cycle when its writer can wait."""
_PERIOD: Final = 1000
"""Default length of a connector: the samples of a 1 kHz source in one cycle of a 1 Hz context."""
_FULL: Final = 0.75
"""The load of the queue from which on writers that can wait have to wait."""
_LOOK_AGAIN: Final = 0.005
_SOON: Final = 0.005
"""Seconds that an activation waits on the loop for the file, which is normally open at once."""
_LATE: Final = 0.5
"""Seconds after which a failure to close is logged, unless the file is closed because the component ends."""
_MB: Final = 1_000_000


class Recording:
    """Records for one FlexiLogger; `make_writer` opens the file."""

    make_writer: MakeWriter = RecordingWriter
    make_text_writer: MakeWriter = TextWriter

    def __init__(self, logger: FlexiLogger) -> None:
        self._logger = logger
        self._session: BackgroundRecording | None = None
        self._options = RecordingOptions()
        self._active_in = self._segment = 0
        self._inputs: dict[str, tuple[InPort[Any], int]] = {}
        """Each in-port, and its number in the recording."""
        self._looking = False
        self._enabled = True
        self._paused = False
        self._base = self._last = 0
        self._lost_before: Counter[tuple[str, str]] = Counter()
        self._missed = 0
        """Samples that connectors had no room for, in all segments that have ended."""
        self._closed = asyncio.Event()
        self._closing = self._is_reported = True

    # -- parameters ------------------------------------------------------------------------------------------------

    def ports_for(self, values: Mapping[str, Any]) -> Mapping[str, InPort[Any]]:
        return {name: InPort(cls, length=_PERIOD) for name, cls in self._types(values).items()}

    def _types(self, values: Mapping[str, Any]) -> dict[str, type]:
        if not values["inputs"]:
            raise ConfigurationError(
                f"{self._logger.name}.inputs: expected the type of at least one in-port (-p); "
                "mode = replay (-o) has the ports of a file"
            )
        return named_types(self._logger.name, values["inputs"], values["names"])

    def check_configuration(self, values: Mapping[str, Any]) -> Callable[[], None]:
        for name, cls in self._types(values).items():
            known = self._session.type_of(name) if self._inputs and self._session is not None else None
            if known is not None and known is not cls:
                raise ConfigurationError(
                    f"{self._logger.name}.{name}: is recorded as {type_name(known)}; "
                    "deactivate it first, or take another name"
                )
        return partial(self._use, self._checked(values), bool(values["paused"]))

    def _checked(self, values: Mapping[str, Any]) -> RecordingOptions:
        for name, least in (("rotate_size", 0.01), ("rotate_time", 0.001)):
            if 0.0 < values[name] < least:
                raise ConfigurationError(
                    f"{self._logger.name}.{name} = {values[name]!r}: expected 0, which is never, or {least} and more"
                )
        return options_of(values)

    def _use(self, options: RecordingOptions, paused: bool) -> None:
        self._options = options
        if self._session is not None and not self._closing:
            self._number_ports(self._session)
        self._switch(self._enabled, paused)

    def _switch(self, enabled: bool, paused: bool) -> bool:
        """Start or stop recording; earlier samples are treated as before. Return whether anything has changed."""
        before, now = self._enabled and not self._paused, enabled and not paused
        if before is not now and self._session is not None:
            self._take(record=before)
            if self._logger.verbosity >= 2:
                self._logger.log.info("%s", "goes on" if now else "stands still")
        self._enabled, self._paused = enabled, paused
        return before is not now

    def start(self) -> bool:
        return self._switch(True, self._paused)

    def stop(self) -> bool:
        return self._switch(False, self._paused)

    # -- hooks -----------------------------------------------------------------------------------------------------

    def initialized(self) -> None:
        """Refuse a file that cannot be written, before anything runs; the file is made at the activation."""
        if self._logger.kernel.components.get(self._logger.name, self._logger) is not self._logger:
            return  # it replaces another instance, whose file it takes over (`take_over`)
        try:
            self._check_target()
        except RecordingError as error:
            raise ConfigurationError(f"{self._logger.name}.logfile: {error}") from None

    def _check_target(self) -> None:
        check_target(self._logger.logfile, self._options.existing)
        check_parts(self._logger.logfile, self._options)

    def activated(self) -> None:
        self._active_in += 1
        session = self._session
        if self._active_in == 1 or session is None or session.failure is not None:  # else in another context already
            self._begin()

    def _begin(self) -> None:
        """Begin the next segment."""
        logger, path, before = self._logger, self._logger.logfile, self._session
        if before is None or before.path != path:
            self._check_target()
        self._enabled, self._paused = not logger.use_control, logger.paused
        self._segment += 1
        self._closed.clear()
        self._closing = self._is_reported = False
        session = self._session = BackgroundRecording(
            path,
            self._options,
            metadata=about_system(logger.kernel, logger.name, self._segment),
            attachments={"system.toml": logger.kernel.origin.encode()} if logger.kernel.origin else None,
            owner=self,
            notify=self._teller(self._segment),
            after=before,
            make=self.make_text_writer if logger.text else self.make_writer,
        )
        self._base = max(logger.clock.time_ns(), self._last) - logger.clock.monotonic_ns()
        self._number_ports(session)
        self._lost_before = self._lost()
        if logger.verbosity >= 2:
            logger.log.info("records into %s, segment %d", path, self._segment)
        try:
            session.wait_open(None if self._may_block else _SOON)
        except RecordingError:
            self._is_reported = True
            raise

    def execute(self) -> None:
        if self._session is not None and self._session.is_ordered and not self._closing:
            self._begin()  # a replacement took over, went and closed the file: go on in another segment
        if self._session is not None and self._session.failure is not None:
            self._is_reported = True
            raise self._session.failure
        self._take(record=self._enabled and not self._paused)

    def deactivated(self) -> None:
        session = self._session
        self._active_in -= 1
        if session is None or self._active_in > 0:
            return
        self._closing = True
        lost = self._lost() - self._lost_before
        self._missed += sum(n for (_, why), n in lost.items() if why in MISSED and why != "inactive")
        session.close({"dropped_before": _by_connector(lost)} if lost else None)
        self._report_lost(lost)
        self._inputs = {}
        if self._may_block:
            session.wait_closed()
            self._raise_unreported(session)

    async def wait_closed(self) -> None:
        session = self._session
        if session is None:
            return
        if self._is_simulated:
            session.wait_closed()  # no time passes meanwhile
        elif not session.is_closed:
            await self._closed.wait()

    async def finalized(self) -> None:
        session = self._session
        if session is None or session.owner is not self:
            return
        self._closing = True
        session.close()
        try:
            await self.wait_closed()
        except asyncio.CancelledError:
            why = "was not closed in time; what is in it is whole, what still waited is lost"
            self._logger.log.error("%s", f"{session.path}: {why}")
            raise
        self._raise_unreported(session)
        if session.failure is None and (missed := self._missed + session.lost):
            raise RecordingError(f"{session.path}: is not complete: {missed} samples that were sent are not in it")

    def _raise_unreported(self, session: BackgroundRecording) -> None:
        """Raise, once, the reason why a recording has ended."""
        if session.failure is not None and not self._is_reported:
            self._is_reported = True
            raise session.failure

    def take_over(self, old: Recording) -> None:
        """Continue the recording of an instance whose code was replaced; its ports belong to the new one by now."""
        options = self._options
        vars(self).update({name: value for name, value in vars(old).items() if name != "_logger"})
        self._options, self._looking = options, False
        if self._session is not None:
            self._session.belong(self, self._teller(self._segment))
            self._number_ports(self._session)

    # -- samples ---------------------------------------------------------------------------------------------------

    @property
    def _may_block(self) -> bool:
        """Whether blocking delays nothing else: in a thread context, and where time is simulated."""
        return self._is_simulated or not self._logger.kernel.on_loop_thread()

    @property
    def _is_simulated(self) -> bool:
        return isinstance(self._logger.clock, SimulatedClock)

    def _take(self, *, record: bool) -> None:
        """Read the in-ports. Writers that wait for room are left waiting while the disk is behind."""
        session = self._session
        if session is None:
            return
        if not record:
            for port, _ in self._inputs.values():
                port.drain()
            return
        now = self._last = self._base + self._logger.clock.monotonic_ns()
        held = False
        for port, number in self._inputs.values():
            if self._is_simulated:
                self._record_all(session, number, port.drain(), now)
            elif any(connector.profile.full == "block" for connector in port.connectors):
                held = self._record_some(session, number, port, now) or held
            elif samples := port.drain():
                session.write(number, samples, now)
                self._report_taken(port.name, len(samples))
        if held:
            self._look_again()

    def _record_all(self, session: BackgroundRecording, number: int, samples: Sequence[Any], now: int) -> None:
        """Record all samples, in virtual time: it waits for the disk, else simulated time would run ahead of it."""
        for sample in samples:
            if session.load >= _FULL:
                session.flush()
            session.write(number, (sample,), now)

    def _record_some(self, session: BackgroundRecording, number: int, port: InPort[Any], now: int) -> bool:
        """Record as many samples as there is room for; return whether samples were left in a port."""
        taken = 0
        while taken < _AT_ONCE and session.load < _FULL and port.is_new:
            session.write(number, (port.read_nowait(),), now)
            taken += 1
        self._report_taken(port.name, taken)
        return port.is_new

    def _look_again(self) -> None:
        """Request another cycle: a writer waits at a port that has samples left."""
        if not self._may_block and not self._looking:  # in a thread's context the next cycle does
            self._looking = True
            self._logger.kernel.loop.call_later(_LOOK_AGAIN, self._look)

    def _look(self) -> None:
        self._looking = False
        if self._session is not None and not self._closing:
            self._take(record=self._enabled and not self._paused)

    def _report_taken(self, name: str, count: int) -> None:
        if count and self._logger.verbosity >= 3:
            self._logger.log.info("%s: %d samples", name, count)

    def _lost(self) -> Counter[tuple[str, str]]:
        """Drops of the in-ports' connectors so far, by connector and reason."""
        found: Counter[tuple[str, str]] = Counter()
        for port, _ in self._inputs.values():
            for connector in port.connectors:
                found.update({(connector.name, why): n for why, n in connector.statistics.dropped.items() if n})
        return found

    def _report_lost(self, lost: Counter[tuple[str, str]]) -> None:
        missed = {name: n for (name, why), n in lost.items() if why in MISSED}
        if missed:
            names = ", ".join(f"{count} of {name}" for name, count in missed.items())
            late = all(why == "inactive" for _, why in lost if why in MISSED)
            remedy = (
                "they lay unread when it was deactivated" if late else "connect with a longer buffer or full = block"
            )
            self._logger.log.warning("%s", f"samples were not recorded: {names}; {remedy}")

    def _number_ports(self, session: BackgroundRecording) -> None:
        """Give each in-port its number in the recording."""
        numbers: dict[str, tuple[InPort[Any], int]] = {}
        for name, port in self._logger.ports.items():
            if isinstance(port, InPort):
                about_port = {"unit": port.unit} if port.unit else {}
                numbers[name] = port, session.add_port(name, port.type, about_port)
        self._inputs = numbers

    # -- notices of the recording's thread --------------------------------------------------------------------------

    def _teller(self, segment: int) -> Callable[[Notice], None]:
        loop = self._logger.kernel.loop

        def notify(notice: Notice) -> None:
            with contextlib.suppress(RuntimeError):  # the loop is closed: the notice has no receiver
                loop.call_soon_threadsafe(self._noticed, segment, notice)

        return notify

    def _noticed(self, segment: int, notice: Notice) -> None:
        logger = self._logger
        if notice.kind in ("dropped", "refused", "gone"):
            logger.log.warning("%s", notice.text)
        if segment != self._segment:
            return
        if notice.kind == "closed":
            self._closed.set()
        elif notice.kind == "failed" and not self._closing:
            for context in logger.contexts:
                if isinstance(context, EventContext):
                    context.trigger(logger)  # its cycle raises the failure
        elif notice.kind == "failed":
            logger.kernel.loop.call_later(_LATE, self._report_late, segment)

    def _report_late(self, segment: int) -> None:
        """Log a failure to close, when the component goes on and nothing else would report it."""
        session = self._session
        if segment == self._segment and not self._is_reported and session is not None and session.failure is not None:
            self._is_reported = True
            self._logger.log.error("%s", session.failure)


def _by_connector(lost: Counter[tuple[str, str]]) -> dict[str, dict[str, int]]:
    found: dict[str, dict[str, int]] = {}
    for (name, why), count in lost.items():
        found.setdefault(name, {})[why] = count
    return found


def options_of(values: Mapping[str, Any]) -> RecordingOptions:
    """The options of a recording from the parameters."""
    return RecordingOptions(
        encoding=values["encoding"],
        existing=values["existing"],
        chunk=values["chunk"],
        age=values["flush_age"],
        sync=values["sync"],
        queue=values["queue"],
        max_bytes=round(values["rotate_size"] * _MB) or None,
        max_seconds=values["rotate_time"] or None,
        min_free=None if values["min_free"] is None else round(values["min_free"] * _MB),
    )
