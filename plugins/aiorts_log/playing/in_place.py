"""`aiorts run SYSTEM --replay FILE`: recorded samples in the place of the components that sent them.

A component whose out-ports were all recorded is not started. A replacement with its ports and parameters, but without
its hooks, takes its place in its contexts, and the samples are sent from the out-ports when they are due. Samples that
others send to it go nowhere, and calls of its services are refused. It finishes at the end of the recording, as a
source does; for readers that have not read everything then, the run goes on for a while.
"""

from __future__ import annotations

import asyncio
import copy
import inspect
import logging
import time
import types
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from fnmatch import fnmatchcase
from functools import partial, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from aiorts import Component, InPort, KernelService, OutPort, Provided, StateMachineComponent, check_settings, setting
from aiorts.errors import AiortsError, ConfigurationError
from aiorts.exits import FAILED
from aiorts.spelling import suggestion
from aiorts.statechart import Chart, ChartWarning, State
from aiorts.types import type_name
from aiorts_log.commands.moment import moment_ns
from aiorts_log.errors import RecordingError
from aiorts_log.playing.player import Player, Playing
from aiorts_log.playing.read_ahead import Reading
from aiorts_log.playing.schedule import Pace
from aiorts_log.text.opening import open_recording

if TYPE_CHECKING:
    from aiorts_log.mcap.reader import RecordedPort

__all__ = ("InPlace", "ReplaySettings")

_LOG = logging.getLogger(__name__)
_NS: Final = 1_000_000_000
_SHOWN: Final = 10
_PATIENCE: Final = 60.0
"""Seconds for which slow readers are waited for at the end, and longer where the replay took longer."""
_REPLAYED: Final = "it is replayed, and none of its code runs"
_HOOKS: Final = (
    *("on_initialize", "on_finalize", "on_startup", "on_shutdown", "on_activated", "on_deactivated", "on_execute"),
    *("on_state_update", "on_rate_changed", "on_reset", "on_error", "on_aborting"),
)
"""All hooks of components; a test compares them with the kernel's."""


@dataclass(frozen=True, slots=True)
class ReplaySettings:
    """A recording that is replayed in the place of the components that sent it."""

    file: Path | None = setting(  # noqa: RUF009 - it makes a field
        None, "Send what this recording has in the place of the components that sent it.", option=""
    )
    ports: tuple[str, ...] = setting(
        (),
        "Replay these out-ports, COMPONENT.PORT with * and ?, also where their component has others, which then send "
        "nothing; repeatable. By default all of components whose out-ports were all recorded.",
        option="port",
    )
    start: str = setting("", "From +SECONDS after its first sample, or seconds since 1970.", option=True)
    end: str = setting("", "Up to there, without it.", option=True)
    speed: float = setting(
        1.0, "So many times as fast; inf is as fast as the readers take it.", option=True, above=0, endless=True
    )
    rate: float | None = setting(None, "Samples in a second, whatever their times are.", option=True, above=0)
    loop: int = setting(1, "How often; 0 is without end.", option=True, low=0)
    max_gap: float = setting(3600.0, "The longest gap that is waited for.", option=True, unit="s", above=0)
    absolute: bool = setting(False, "Time stamps as recorded, in place of the time now.", option=True)

    def __post_init__(self) -> None:
        check_settings(self)
        if self.file is None and any(getattr(self, one.name) != one.default for one in fields(self)):
            raise ConfigurationError("file: nothing says what to replay; give file = 'run.mcap', or --replay")


class InPlace(KernelService):
    """Replays a recording in the place of components of a system file."""

    name = "replay"
    settings = ReplaySettings

    _settings = ReplaySettings()
    _path: Path | None = None
    _player: Player | None = None
    _task: asyncio.Task[None] | None = None
    _began = 0.0
    """The time at which the replay began, by `time.monotonic()`."""

    # -- what is replayed --------------------------------------------------------------------------------------------

    def configure(self, settings: ReplaySettings) -> None:
        if settings.file is None:
            return
        self._settings, self._path = settings, settings.file
        self._recorded: dict[str, dict[str, RecordedPort]] = {}
        """The recorded ports of each path of an out-port, by their keys in the recording."""
        self._in_place: dict[str, frozenset[str]] = {}
        """The replaced components, each with the paths of its ports that are replayed."""
        try:
            with open_recording(settings.file) as reader:
                for key, port in reader.ports.items():
                    self._recorded.setdefault(port.name, {})[key] = port
                self._first = reader.start
        except RecordingError as error:
            raise ConfigurationError(str(error)) from error
        for glob in settings.ports:
            if not any(fnmatchcase(path, glob) for path in self._recorded):
                hint = suggestion(glob, self._recorded, f"there are {_list(self._recorded)}")
                raise ConfigurationError(f"replay: {settings.file} has no port {glob!r}; {hint}")
        self._begin, self._end = (
            moment_ns(f"replay: {key}", getattr(settings, key), self._first) if getattr(settings, key) else None
            for key in ("start", "end")
        )
        if self._begin is not None and self._end is not None and self._begin >= self._end:
            raise ConfigurationError("replay: start is not before end; nothing would be replayed")

    def in_place_of(self, name: str, cls: type[Component], make: Callable[[], Component]) -> type[Component] | None:
        if self._path is None or not any(path.partition(".")[0] == name for path in self._recorded):
            return None
        outs = {port.path: port for port in make().ports.values() if isinstance(port, OutPort)}
        recorded = {path for path in outs if path in self._recorded}
        if globs := self._settings.ports:
            recorded = {path for path in recorded if any(fnmatchcase(path, glob) for glob in globs)}
        if not recorded:
            return None
        missing = [path for path in outs if path not in recorded]
        if missing and not globs:
            _LOG.warning(
                "%s: runs, and its recorded ports are not replayed: %s was not recorded; --replay-port %s replays "
                "what was",
                *(name, _list(missing), min(recorded)),
            )
            return None
        if missing:
            _LOG.warning("%s: is replayed, and sends nothing from %s", name, _list(missing))
        for path in sorted(recorded):
            self._check(path, outs[path].type)
        self._in_place[name] = frozenset(recorded)
        return _without_hooks(cls)

    def stands_for(self, name: str) -> str:
        return "" if self._path is None or name not in self._in_place else _REPLAYED

    def _check(self, path: str, wanted: Any) -> None:
        for port in self._recorded[path].values():
            if port.unknown and port.count:
                raise ConfigurationError(f"{self._path}: port {path!r}: {port.unknown}")
            there = port.type
            if port.count and there is not wanted and not (isinstance(wanted, type) and issubclass(there, wanted)):
                raise ConfigurationError(
                    f"{self._path}: {path} was recorded as {type_name(there)}, and sends {type_name(wanted)} here; "
                    "leave it out: name the ports to replay with --replay-port"
                )

    async def starting(self) -> None:
        if self._path is None:
            return
        if not self._in_place:
            raise ConfigurationError(
                f"replay: {self._path}: no component here has its out-ports among those recorded: "
                f"{_list(self._recorded)}; `aiorts replay {self._path}` replays it alone"
            )
        elsewhere = [path for path in self._recorded if path.partition(".")[0] not in self.kernel.components]
        if elsewhere and not self._settings.ports:
            _LOG.warning("%s: is not replayed, since no component here sends it: %s", self._path, _list(elsewhere))
        if self._in_place.keys() >= {*self.kernel.components} and not self._settings.ports:
            _LOG.warning(
                "%s: every component is replayed and none runs; --replay-port says which ports to replay", self._path
            )
        for name in self._in_place:
            for port in self.kernel.components[name].ports.values():
                if isinstance(port, InPort):
                    for connector in list(port.connectors):
                        connector.close()

    def report(self) -> Mapping[str, Any]:
        if self._path is None or self._player is None:
            return {}
        return {"file": str(self._path), "in_place_of": sorted(self._in_place), "sent": self._player.sent}

    # -- playing -----------------------------------------------------------------------------------------------------

    def started(self) -> None:
        if self._path is None or self._player is not None:
            return  # a plan that is applied later on changes nothing of the replay
        kernel, settings = self.kernel, self._settings
        routes = {
            key: (kernel.components[name].ports[path.partition(".")[2]], port.type)
            for name, paths in self._in_place.items()
            for path in sorted(paths)
            for key, port in self._recorded[path].items()
            if port.count
        }
        self._player = Player(
            Reading(partial(open_recording, self._path), routes, self._begin, self._end),
            Playing(
                pace=Pace(settings.speed, settings.rate, round(settings.max_gap * _NS)),
                passes=settings.loop,
                absolute=settings.absolute,
                position=None if self._begin is None else max(self._begin, self._first),
            ),
            clock=kernel.clock,
            sleep=kernel.sleep,
            notify=self._warn,
        )
        _LOG.info("replays %s in the place of %s", self._path, _list(self._in_place))
        self._began = time.monotonic()
        self._task = asyncio.get_running_loop().create_task(self._play(self._player), name="replay")

    async def _play(self, player: Player) -> None:
        """Play to the end; however that comes, the components are finished then, and the run goes on to its own end."""
        lost = True
        try:
            await player.play()
            if player.fault:
                self._warn(player.fault)
            if not player.sent:
                self._warn("nothing was replayed: it has no sample of these ports in this time")
            lost = player.loses
        except asyncio.CancelledError:
            lost = False
            raise
        except AiortsError as error:
            _LOG.error("%s: %s", self._path, str(error).removeprefix(f"{self._path}: "))
        finally:
            self.patience = max(_PATIENCE, time.monotonic() - self._began)
            if lost:
                self.kernel.exit_status = self.kernel.exit_status or FAILED
            for name in self._in_place:
                if (component := self.kernel.components.get(name)) is not None:
                    component.finish()
        _LOG.info("replayed %d samples of %s", player.sent, self._path)

    def _warn(self, text: str) -> None:
        _LOG.warning("%s: %s", self._path, text)

    async def closing(self, budget: Any) -> None:
        task, self._task = self._task, None
        if task is not None:
            task.cancel()
            await asyncio.wait({task}, timeout=1.0)
            if task.done() and not task.cancelled() and (error := task.exception()) is not None:
                _LOG.error("%s: its replay failed", self._path, exc_info=error)


def _without_hooks(cls: type[Component]) -> type[Component]:
    """A class with the ports and parameters of `cls`, whose hooks do nothing and which answers no call."""
    # The class is listed, and saved, by the original's name.
    names: dict[str, Any] = {"__module__": cls.__module__, "__qualname__": cls.__qualname__}
    for attribute in dir(cls):
        if isinstance(end := inspect.getattr_static(cls, attribute), Provided):
            names[attribute] = alike = copy.copy(end)
            alike.refuses = _REPLAYED
    for hook in _HOOKS:
        names[hook] = _nothing_for(getattr(cls, hook))
    if issubclass(cls, StateMachineComponent):
        names["chart"] = Chart(State("replayed", initial=True))
    with warnings.catch_warnings(action="ignore", category=ChartWarning):  # events that the chart in its place ignores
        return types.new_class(cls.__name__, (cls,), exec_body=lambda body: body.update(names))


def _nothing_for(hook: Callable[..., object]) -> Callable[..., None]:
    """A hook that does nothing. It wraps the original hook: a state machine accepts no other."""

    @wraps(hook, updated=())
    def nothing(*_: object) -> None:
        """Do nothing."""

    return nothing


def _list(names: Mapping[str, object] | list[str]) -> str:
    more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    return ", ".join(list(names)[:_SHOWN]) + more
