"""The half of FlexiLogger that records: takes what the in-ports have and hands it on, waiting for nobody.

The log time of a sample is when it was taken: the kernel's clock as it was at the activation, and from there on by its
monotonic time. Publish time is the sample's own `tm`.
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
from aiorts_flexi.about import about
from aiorts_flexi.ports import named_types
from aiorts_log import RecordingError, RecordingOptions, RecordingWriter, TextWriter
from aiorts_log.control import BackgroundRecording, MakeWriter, Notice
from aiorts_log.info import MISSED
from aiorts_log.target import check_parts, check_target

if TYPE_CHECKING:
    from aiorts_flexi.logger import FlexiLogger

__all__ = ("Recording",)

_AT_ONCE: Final = 1000
"""Samples taken of a port in one cycle when their writer can wait."""
_FULL: Final = 0.75
"""How full the queue may be before who can wait has to."""
_LOOK_AGAIN: Final = 0.005
_SOON: Final = 0.005
"""Seconds that an activation waits on the loop for the file: as a rule it is there at once."""
_LATE: Final = 0.5
"""Seconds after which a failure to close is told, if it was not the component's end that asked for it."""
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
        self._closed = asyncio.Event()
        self._closing = self._is_told = True

    # -- parameters ------------------------------------------------------------------------------------------------

    def ports_for(self, values: Mapping[str, Any]) -> Mapping[str, InPort[Any]]:
        return {name: InPort(cls) for name, cls in self._types(values).items()}

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
        """Record or stand still from now on; what has come until now is dealt with as before. Whether that changed."""
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
        """Refuse a file that cannot be had before anything runs; it is made when the component is activated."""
        if self._logger.kernel.components.get(self._logger.name, self._logger) is not self._logger:
            return  # it takes the place of another one, whose file it takes over (`take_over`)
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
        self._closing = self._is_told = False
        session = self._session = BackgroundRecording(
            path,
            self._options,
            metadata=about(logger, self._segment),
            attachments={"system.toml": logger.kernel.origin.encode()} if logger.kernel.origin else None,
            owner=self,
            tell=self._teller(self._segment),
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
            self._is_told = True
            raise

    def execute(self) -> None:
        if self._session is not None and self._session.is_ordered and not self._closing:
            self._begin()  # new code that had taken over went, and closed it: go on in another segment
        if self._session is not None and self._session.failure is not None:
            self._is_told = True
            raise self._session.failure
        self._take(record=self._enabled and not self._paused)

    def deactivated(self) -> None:
        session = self._session
        self._active_in -= 1
        if session is None or self._active_in > 0:
            return
        self._closing = True
        lost = self._lost() - self._lost_before
        session.close({"dropped_before": _by_connector(lost)} if lost else None)
        self._tell_lost(lost)
        self._inputs = {}
        if self._may_block:
            session.wait_closed()
            self._raise_untold(session)

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
        self._raise_untold(session)

    def _raise_untold(self, session: BackgroundRecording) -> None:
        """Once, why a recording has ended."""
        if session.failure is not None and not self._is_told:
            self._is_told = True
            raise session.failure

    def take_over(self, old: Recording) -> None:
        """Go on with what another one records, whose code was replaced; its ports are ours by now."""
        options = self._options
        vars(self).update({name: value for name, value in vars(old).items() if name != "_logger"})
        self._options, self._looking = options, False
        if self._session is not None:
            self._session.belong(self, self._teller(self._segment))
            self._number_ports(self._session)

    # -- samples ---------------------------------------------------------------------------------------------------

    @property
    def _may_block(self) -> bool:
        """Whether nobody else waits when this does: in a thread's context, and where time stands still meanwhile."""
        return self._is_simulated or not self._logger.kernel.on_loop_thread()

    @property
    def _is_simulated(self) -> bool:
        return isinstance(self._logger.clock, SimulatedClock)

    def _take(self, *, record: bool) -> None:
        """Take what the in-ports have. Who would wait for us is left alone while the disk is behind."""
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
            elif any(connector.blocks for connector in port.connectors):
                held = self._record_some(session, number, port, now) or held
            elif samples := port.drain():
                session.write(number, samples, now)
                self._tell_taken(port.name, len(samples))
        if held:
            self._look_again()

    def _record_all(self, session: BackgroundRecording, number: int, samples: Sequence[Any], now: int) -> None:
        """Without any loss: virtual time would run away from the disk, and waits."""
        for sample in samples:
            if session.load >= _FULL:
                session.flush()
            session.write(number, (sample,), now)

    def _record_some(self, session: BackgroundRecording, number: int, port: InPort[Any], now: int) -> bool:
        """Take as much as there is room for; whether some had to be left there."""
        taken = 0
        while taken < _AT_ONCE and session.load < _FULL and port.is_new:
            session.write(number, (port.read_nowait(),), now)
            taken += 1
        self._tell_taken(port.name, taken)
        return port.is_new

    def _look_again(self) -> None:
        """Some samples were left in a port that their writer waits at."""
        if not self._may_block and not self._looking:  # in a thread's context the next cycle does
            self._looking = True
            self._logger.kernel.loop.call_later(_LOOK_AGAIN, self._look)

    def _look(self) -> None:
        self._looking = False
        if self._session is not None and not self._closing:
            self._take(record=self._enabled and not self._paused)

    def _tell_taken(self, name: str, count: int) -> None:
        if count and self._logger.verbosity >= 3:
            self._logger.log.info("%s: %d samples", name, count)

    def _lost(self) -> Counter[tuple[str, str]]:
        """What the connectors of the in-ports have dropped until now, by connector and reason."""
        found: Counter[tuple[str, str]] = Counter()
        for port, _ in self._inputs.values():
            for connector in port.connectors:
                found.update({(connector.name, why): n for why, n in connector.statistics.dropped.items() if n})
        return found

    def _tell_lost(self, lost: Counter[tuple[str, str]]) -> None:
        missed = {name: n for (name, why), n in lost.items() if why in MISSED}
        if missed:
            names = ", ".join(f"{count} of {name}" for name, count in missed.items())
            late = all(why == "inactive" for _, why in lost if why in MISSED)
            remedy = (
                "they lay unread when it was deactivated" if late else "connect with a longer buffer or full = block"
            )
            self._logger.log.warning("%s", f"samples were not recorded: {names}; {remedy}")

    def _number_ports(self, session: BackgroundRecording) -> None:
        """Give each in-port that there is now its number in the recording."""
        numbers: dict[str, tuple[InPort[Any], int]] = {}
        for name, port in self._logger.ports.items():
            if isinstance(port, InPort):
                about_port = {"unit": port.unit} if port.unit else {}
                numbers[name] = port, session.add_port(name, port.type, about_port)
        self._inputs = numbers

    # -- what the recording's thread says --------------------------------------------------------------------------

    def _teller(self, segment: int) -> Callable[[Notice], None]:
        loop = self._logger.kernel.loop

        def tell(notice: Notice) -> None:
            with contextlib.suppress(RuntimeError):  # the loop is closed: nobody is left to be told
                loop.call_soon_threadsafe(self._noticed, segment, notice)

        return tell

    def _noticed(self, segment: int, notice: Notice) -> None:
        logger = self._logger
        if notice.kind in ("dropped", "gone"):
            logger.log.warning("%s", notice.text)
        if segment != self._segment:
            return
        if notice.kind == "closed":
            self._closed.set()
        elif notice.kind == "failed" and not self._closing:
            for context in logger.contexts:
                if isinstance(context, EventContext):
                    context.trigger(logger)  # which raises it
        elif notice.kind == "failed":
            logger.kernel.loop.call_later(_LATE, self._tell_late, segment)

    def _tell_late(self, segment: int) -> None:
        """It failed when it was closed, and the component stays, so that nobody asks how that went."""
        session = self._session
        if segment == self._segment and not self._is_told and session is not None and session.failure is not None:
            self._is_told = True
            self._logger.log.error("%s", session.failure)


def _by_connector(lost: Counter[tuple[str, str]]) -> dict[str, dict[str, int]]:
    found: dict[str, dict[str, int]] = {}
    for (name, why), count in lost.items():
        found.setdefault(name, {})[why] = count
    return found


def options_of(values: Mapping[str, Any]) -> RecordingOptions:
    """How a recording is written, of the parameters."""
    return RecordingOptions(
        encoding=values["encoding"],
        existing=values["existing"],
        chunk=values["chunk"],
        age=values["flush_age"],
        sync=values["sync"],
        queue=values["queue"],
        max_octets=round(values["rotate_size"] * _MB) or None,
        max_seconds=values["rotate_time"] or None,
        min_free=None if values["min_free"] is None else round(values["min_free"] * _MB),
    )
