"""`aiorts run --record FILE`: a service that records the samples of a whole system's out-ports.

It takes each sample in the write itself, or soon on the loop where a thread writes, and hands it to a background
recording. The system does not know the service: components, connections and the end of the run stay as they are.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields, replace
from datetime import UTC, datetime
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path
from time import sleep
from typing import TYPE_CHECKING, Any, Final, Literal

from aiorts import KernelService, OutPort, SimulatedClock, check_settings, setting
from aiorts.errors import ConfigurationError
from aiorts.events import ContextStarted, PortAdded, PortRemoved
from aiorts.spelling import suggestion
from aiorts.types import type_name
from aiorts_log.errors import RecordingError

if TYPE_CHECKING:
    from aiorts import Component, Connector, InPort, Microkernel
    from aiorts_log.recorder.control import BackgroundRecording, Notice

__all__ = ("Beside", "RecordSettings")

_LOG = logging.getLogger(__name__)
_TIME: Final = "%Y%m%dT%H%M%SZ"
"""The format of `{time}`, in UTC of the machine, whatever clock the system has: 20261122T181500Z."""
_FULL: Final = 0.75
"""The load of the queue from which writers have to wait."""
_LENGTHS: Final = 8, 100_000
"""Samples that a port may have unread while the disk is behind, or until the loop has a turn: least, most."""
_BYTES: Final = 2**26
"""Bytes that these samples may hold."""
_AT_ONCE: Final = 100
"""Small samples that are recorded between two checks for room; large samples are checked one by one."""
_MOST: Final = 1_000
"""The most samples that are taken of a port in one step of the loop."""
_LOOK_AGAIN: Final = 0.005
_OPEN_WITHIN: Final = 2.0
"""The most seconds that a start waits for the file, which is normally open at once."""
_PAUSE: Final = 0.001
_LAST: Final = 0.2
"""Seconds in which the file has to be closed when the kernel's own time for closing is over."""
_MB: Final = 1_000_000
_OLDEST: Final = 3600.0
"""Seconds until a chunk is written in virtual time: so many that only its size, the same in each run, decides."""


@dataclass(frozen=True, slots=True)
class RecordSettings:
    """A recording of what the out-ports of the system send."""

    file: Path | None = setting(  # noqa: RUF009 - it makes a field
        None, "Record what the system's out-ports send into this file (MCAP); {time} is when it started.", option=""
    )
    ports: tuple[str, ...] = setting(
        (), "Record these out-ports, COMPONENT.PORT with * and ?; repeatable; all by default.", option="port"
    )
    append: bool = setting(False, "Continue the file of --record when it is there.", option="--append")
    overwrite: bool = setting(False, "Replace the file of --record when it is there.", option="--overwrite")
    encoding: Literal["msgpack", "json"] = setting("msgpack", "Of the samples; json opens in Foxglove.")
    min_free: float | None = setting(
        None, "The part of the disk that stays free; 1 GiB, or 5 % of a small one.", unit="MB", low=0, high=1e12
    )
    full: Literal["block", "overwrite"] = setting(
        "block", "What a write does when the disk is far behind: wait, or lose the oldest."
    )

    def __post_init__(self) -> None:
        check_settings(self)
        if self.file is None:
            if any(getattr(self, one.name) != one.default for one in fields(self)):
                raise ConfigurationError("file: nothing says where to record; give file = 'run.mcap', or --record")
            return
        from aiorts_log.recorder.target import unfit_name

        name = str(self.file)
        if unknown := [one for one in re.findall(r"\{[^}]*\}", name) if one != "{time}"]:
            raise ConfigurationError(f"file: {unknown[0]} in {name!r}: only {{time}} is replaced, by the start's time")
        if why := unfit_name(self.file):
            raise ConfigurationError(f"file: {why}")
        if self.append and self.overwrite:
            raise ConfigurationError("append: goes not with overwrite; choose one of the two")
        if bad := [one for one in self.ports if not isinstance(one, str) or not one]:
            raise ConfigurationError(f"ports: expected texts such as 'camera*.image', got {bad[0]!r}")


@dataclass(eq=False, slots=True)
class _Tapped:
    """An out-port that is recorded, and its number in the recording."""

    out: OutPort[Any]
    weigh: Callable[[Any], int] | None
    """The approximate bytes of a sample; None where all are small."""
    number: int = -1
    room: int = 0
    """Samples that may be recorded before the next check for room."""
    busy: bool = False
    """Whether the port is being read: a read may let a waiting writer go on, whose sample is read after it."""
    connector: Connector = None  # type: ignore[assignment] # it needs this to be made

    @property
    def at_once(self) -> int:
        """The most samples that are read at once."""
        return _AT_ONCE if self.weigh is None else 1

    def read(self, port: InPort[Any], unread: int) -> list[Any]:
        """The oldest of so many unread samples, no more than are recorded at once."""
        if unread <= self.room:
            return port.drain()
        return [port.read_nowait() for _ in range(self.room)]

    def length_for(self, sample: Any) -> int:
        """The buffer's length for samples like this one; 0 where the buffer has about that length."""
        least, most = _LENGTHS
        length = most if self.weigh is None else min(most, max(least, _BYTES // self.weigh(sample)))
        now = self.connector.profile.length
        return length if not now // 2 <= length <= now * 2 else 0


class Beside(KernelService):
    """Records what out-ports send: all of them or those that a glob names, also of components that come later."""

    name = "record"
    settings = RecordSettings
    encodes = True

    def __init__(self, kernel: Microkernel) -> None:
        super().__init__(kernel)
        self._settings = RecordSettings()
        self._path: Path | None = None
        self._taps: dict[OutPort[Any], _Tapped] = {}
        self._session: BackgroundRecording | None = None
        self._monotonic_ns, self._base = kernel.clock.monotonic_ns, 0
        self._lost = 0
        """Samples that came too late, or found no room before they reached the recorder."""
        self._looking = self._refused = False
        self._closed = asyncio.Event()

    # -- what there is ---------------------------------------------------------------------------------------------

    def configure(self, settings: RecordSettings) -> None:
        if settings.file is None:
            return
        if self._path is not None:
            raise ConfigurationError(f"record: records into {self._path} already")
        self._settings = settings
        self._path = self._target(str(settings.file))
        bus = self.kernel.bus
        bus.subscribe(PortAdded, lambda event: self._look_at(event.component))
        bus.subscribe(PortRemoved, lambda event: self._look_at(event.component))
        bus.subscribe(ContextStarted, lambda _event: self._begin())
        for component in self.kernel.components.values():
            self.component_added(component)
        if self.kernel.contexts:
            self._begin()

    def _target(self, name: str) -> Path:
        """The file to write, checked as far as that is possible before it is opened."""
        from aiorts_log.recorder.target import check_target

        path = Path(name.replace("{time}", datetime.now(UTC).strftime(_TIME)))
        refuses = self._existing == "refuse"
        try:
            check_target(path, "append" if refuses else self._existing)
        except RecordingError as error:
            raise ConfigurationError(str(error)) from None
        if refuses and path.exists():
            raise ConfigurationError(
                f"{path}: exists already; --append continues it, --overwrite replaces it, "
                "or name another file, such as run-{time}.mcap"
            )
        return path

    @property
    def _existing(self) -> Literal["refuse", "append", "overwrite"]:
        return "append" if self._settings.append else "overwrite" if self._settings.overwrite else "refuse"

    async def starting(self) -> None:
        if self._path is None:
            return
        known = sorted({path for component in self.kernel.components.values() for path, _ in _out_ports(component)})
        for glob in self._settings.ports:
            if not any(fnmatchcase(path, glob) for path in known):
                raise ConfigurationError(f"record: no out-port is called {glob!r}; {suggestion(glob, known)}")
        try:
            self._begin().wait_open(_OPEN_WITHIN)
        except RecordingError as error:
            self._refused = True
            raise ConfigurationError(str(error)) from None

    def report(self) -> Mapping[str, Any]:
        return {} if self._path is None else {"file": str(self._path), "ports": len(self._taps), "lost": self._lost}

    def component_added(self, component: Component) -> None:
        if self._path is None:
            return
        globs = self._settings.ports
        for path, port in _out_ports(component):
            if port not in self._taps and (not globs or any(fnmatchcase(path, glob) for glob in globs)):
                self._tap(port)

    def component_removed(self, component: Component) -> None:
        gone = {id(port) for _, port in _out_ports(component)}
        if component.name not in self.kernel.components:  # the ports of a composite stay with its members
            self._let_go(f"{component.name}.", gone)

    def components_replaced(self, pairs: Mapping[Component, Component]) -> None:
        for component in pairs.values():
            self._look_at(component.name)

    def _look_at(self, name: str) -> None:
        """Follow a change of a component's ports."""
        component = self.kernel.components.get(name)
        if component is not None:
            there = {id(port) for _, port in _out_ports(component)}
            self._let_go(f"{name}.", {id(out) for out in self._taps} - there)
            self.component_added(component)

    # -- taps ------------------------------------------------------------------------------------------------------

    def _tap(self, out: OutPort[Any]) -> None:
        from aiorts_log.recorder.weight import weigher

        session = self._session
        if session is not None and (other := session.type_of(out.path)) not in (None, out.type):
            now = type_name(out.type)
            self._failed(f"{out.path}: is recorded as {type_name(other)}, and sends {now} now, which is not recorded")
            return
        one = self._taps[out] = _Tapped(out, weigher(out.type))
        take: partial[None] = partial(self._take, one)
        one.connector = self.kernel.connections.tap(self, out, take, length=_LENGTHS[1], full=self._settings.full)
        if session is not None:
            self._number(session, one)

    def _number(self, session: BackgroundRecording, one: _Tapped) -> None:
        one.number = session.add_port(one.out.path, one.out.type, {"unit": one.out.unit} if one.out.unit else {})

    def _let_go(self, front: str, gone: set[int]) -> None:
        for out, one in list(self._taps.items()):
            if id(out) in gone and out.path.startswith(front):
                del self._taps[out]
                self._end_tap(one)

    def _end_tap(self, one: _Tapped) -> None:
        """Record the samples left as far as there is room, and close the port's tap."""
        one.busy = True
        samples = one.connector.in_.drain()
        session = self._session
        if session is None or session.failure is not None:
            self._lost += len(samples)
        elif samples:
            session.write(one.number, samples, self._base + self._monotonic_ns())
        one.connector.close()
        self._lost += sum(one.connector.statistics.dropped.values())

    # -- samples ---------------------------------------------------------------------------------------------------

    @property
    def _is_simulated(self) -> bool:
        return isinstance(self.kernel.clock, SimulatedClock)

    def _begin(self) -> BackgroundRecording:
        """Open the file in the background, and record the samples sent before."""
        from aiorts_log.recorder.about import about_system
        from aiorts_log.recorder.control import BackgroundRecording
        from aiorts_log.recorder.options import RecordingOptions

        if self._session is not None:
            return self._session
        assert self._path is not None  # noqa: S101 - it was configured
        kernel, settings = self.kernel, self._settings
        options = RecordingOptions(
            encoding=settings.encoding,
            existing=self._existing,
            min_free=None if settings.min_free is None else round(settings.min_free * _MB),
        )
        if self._is_simulated:
            options = replace(options, age=_OLDEST)
        self._base = kernel.clock.time_ns() - kernel.clock.monotonic_ns()
        session = self._session = BackgroundRecording(
            self._path,
            options,
            metadata=about_system(kernel, self.name, 1),
            attachments={"system.toml": kernel.origin.encode()} if kernel.origin else None,
            owner=self,
            notify=self._notify,
        )
        for one in self._taps.values():
            self._number(session, one)
        self._look()
        _LOG.info("records %d ports into %s", len(self._taps), self._path)
        return session

    def _take(self, one: _Tapped, port: InPort[Any]) -> None:
        """Record the unread samples of a port, as far as there is room: its writers wait while the disk is behind."""
        # Keep this short: it runs in each write of the system.
        session = self._session
        if session is None or one.busy:
            return
        one.busy = True
        try:
            for _ in range(_MOST // one.at_once):
                if not port.is_new:
                    return
                if one.room <= 0 and not self._has_room(session, one, port):
                    break
                samples = one.read(port, self.kernel.connections.unread(one.connector))
                one.room -= len(samples)
                session.write(one.number, samples, self._base + self._monotonic_ns())
                if one.weigh is not None and (length := one.length_for(samples[-1])):
                    self.kernel.connections.resize_tap(one.connector, length)
            self._look_soon()
        finally:
            one.busy = False

    def _has_room(self, session: BackgroundRecording, one: _Tapped, port: InPort[Any]) -> bool:
        """Whether the recording takes samples of this port now; after its failure they are counted as lost."""
        while self._is_simulated and session.load >= _FULL and session.failure is None:
            sleep(_PAUSE)  # virtual time would run ahead of the disk
        if session.failure is not None:
            self._lost += len(port.drain())
            return False
        if session.load >= _FULL:
            return False
        one.room = one.at_once
        return True

    def _look_soon(self) -> None:
        if not self._looking:
            self._looking = True
            self.kernel.loop.call_later(_LOOK_AGAIN, self._look)

    def _look(self) -> None:
        """Record the samples that are still in the ports."""
        self._looking = False
        for one in tuple(self._taps.values()):
            self._take(one, one.connector.in_)

    # -- the end ---------------------------------------------------------------------------------------------------

    async def ending(self, budget: object) -> None:
        session = self._session
        if session is None:
            return
        while any(one.connector.in_.is_new for one in self._taps.values()):
            self._look()
            await asyncio.sleep(0 if not self._looking else _LOOK_AGAIN)
        self._finish(session)
        if self._is_simulated:
            session.wait_closed()
        else:
            await self._closed.wait()

    def stopped(self) -> None:
        session = self._session
        if session is None or self._refused:  # the caller that asked for the start knows the reason
            return
        self._finish(session)  # where `ending` was left no time for it
        if not session.wait_closed(_LAST):
            why = "was not closed in time; what is in it is whole, what still waited is lost"
            self._failed(f"{self._path}: {why}")
            return
        found = session.statistics
        lost = self._lost + sum(found.dropped.values()) + sum(found.refused.values())
        if lost:
            self._failed(f"{self._path}: is not complete: {lost} samples that were sent are not in it")
        elif session.failure is not None:
            self.kernel.exit_status = self.kernel.exit_status or 1

    def _finish(self, session: BackgroundRecording) -> None:
        """Close all taps, and request that the file is closed."""
        for one in self._taps.values():
            self._end_tap(one)
        self._taps.clear()
        session.close({"dropped_before": {"record": self._lost}} if self._lost else None)

    def _failed(self, text: str) -> None:
        _LOG.error("%s", text)
        self.kernel.exit_status = self.kernel.exit_status or 1

    def _notify(self, notice: Notice) -> None:
        """Pass a notice on to the loop; called in the recording's thread."""
        with contextlib.suppress(RuntimeError):  # the loop is closed: the notice has no receiver
            self.kernel.loop.call_soon_threadsafe(self._noticed, notice)

    def _noticed(self, notice: Notice) -> None:
        if notice.kind in ("dropped", "refused", "gone"):
            _LOG.warning("%s", notice.text)
        elif notice.kind == "failed" and not self._refused:
            self._failed(notice.text)
            self._look()  # writers that wait for room go on
        elif notice.kind == "closed":
            self._closed.set()


def _out_ports(component: Component) -> Iterator[tuple[str, OutPort[Any]]]:
    """The out-ports of a component, by path; a composite has those of its members that it shows."""
    for name, port in component.ports.items():
        if isinstance(port, OutPort):
            yield f"{component.name}.{name}", port
