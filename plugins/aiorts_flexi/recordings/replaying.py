"""The replaying role of FlexiLogger: a recording becomes out-ports, and its samples are sent when they are due.

A task of its own, in any context, keeps the time of the kernel's clock. At the end of the recording the component
finishes, which is no error.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Final, Protocol

from aiorts import OutPort
from aiorts.errors import ConfigurationError, StateError
from aiorts.exits import FAILED
from aiorts_flexi.common.options import Option
from aiorts_flexi.recordings.replayed import Contents, Replayed, look_into, replayed_ports
from aiorts_log import DamagedError, Pace, Player, Playing, Reading, moment_ns, open_recording

if TYPE_CHECKING:
    from aiorts_flexi.recordings.logger import FlexiLogger

_NS: Final = 1_000_000_000
_FLAGS: Final = {"begin": " (--start)", "end": " (--end)"}
REPLAY_OPTIONS: Final = (
    Option(("-a", "--absolute_times", "--absolute"), "absolute", "flag", "replay: keep time stamps as recorded"),
    Option(("-g", "--ignore_times", "--rate"), "rate", "number", "replay: HZ samples in a second, at a fixed rate"),
    Option(("--speed",), "speed", "number", "replay: 0.1..1000 times as fast, or max (default 1)", words={"max": None}),
    Option(("--start",), "begin", "text", "replay: from +SECONDS after the first sample, or seconds since 1970"),
    Option(("--end",), "end", "text", "replay: up to there, without it"),
    Option(("--position",), "position", "text", "replay: the first pass begins there; as --start"),
    Option(("--step",), "step", "number", "replay: send so many samples although it is paused"),
    Option(("--loop",), "loop", "number", "replay: N times; without N, or with 0, without end", bare="0"),
    Option(("--max-gap",), "max_gap", "number", "replay: seconds of a gap that are waited for (default 3600)"),
    Option(("--ports",), "only", "text", "replay: only these ports, separated by commas"),
    Option(("--skip",), "skip", "text", "replay: without these ports, separated by commas"),
    Option(("--remap",), "remap", "repeat", "replay: OLD=NEW, another name for a port; repeat for more"),
    Option(("--strict",), "strict", "flag", "replay: a recording that was not closed is an error, as a damaged one is"),
)


class Playback(Protocol):
    """Controls a replay while it is active."""

    async def pause(self) -> bool:
        """Pause; returns whether it was playing."""
        ...

    async def resume(self) -> bool:
        """Go on; returns whether it was paused."""
        ...

    async def step(self, count: int) -> bool:
        """Send the next `count` samples while the replay is paused; return whether it is paused."""
        ...

    async def seek(self, seconds: float) -> float:
        """Play from that many seconds after the first sample of the recording; return the position."""
        ...

    async def position(self) -> float:
        """Seconds after the first sample of the recording that are played now."""
        ...


@dataclass(frozen=True, slots=True)
class Plan:
    """The replay that the parameters describe."""

    contents: Contents
    ports: Mapping[str, Replayed]
    begin: int | None
    end: int | None
    position: int | None
    pace: Pace
    passes: int
    absolute: bool
    strict: bool
    paused: bool
    steps: int

    @property
    def fixed(self) -> dict[str, Any]:
        """The values that cannot be changed while it is active, by parameter."""
        ports = {name: port.keys for name, port in self.ports.items()}
        found = {"logfile": self.contents.path, "ports": ports, "begin": self.begin, "end": self.end}
        return {**found, "absolute": self.absolute, "strict": self.strict}

    @property
    def first(self) -> int | None:
        """The log time at which the replay begins; None is the first wanted sample's."""
        given = [time for time in (self.begin, self.position) if time is not None]
        return max(*given, self.contents.start) if given else None


class Replaying:
    """Replays for one FlexiLogger."""

    def __init__(self, logger: FlexiLogger) -> None:
        self._logger = logger
        self._contents: Contents | None = None
        self._plan: Plan | None = None
        self._player: Player | None = None
        self._task: asyncio.Task[None] | None = None
        self._left: set[asyncio.Task[None]] = set()
        """Cancelled tasks that are still closing their file."""
        self._active_in = 0
        self._enabled = True

    # -- parameters ------------------------------------------------------------------------------------------------

    def ports_for(self, values: Mapping[str, Any]) -> Mapping[str, OutPort[Any]]:
        return {name: OutPort(port.type, unit=port.unit) for name, port in self._ports(values).items()}

    def check_configuration(self, values: Mapping[str, Any]) -> Callable[[], None]:
        ports = self._ports(values)
        contents = self._look_into(values)
        begin, end, position = (
            moment_ns(f"{self._logger.name}.{name}{_FLAGS.get(name, '')}", values[name], contents.start)
            if values[name]
            else None
            for name in ("begin", "end", "position")
        )
        if begin is not None and end is not None and begin >= end:
            raise ConfigurationError(f"{self._logger.name}: begin is not before end; nothing would be replayed")
        speed, gap = values["speed"], values["max_gap"]
        pace = Pace(float("inf") if speed is None else speed, values["rate"], round(gap * _NS))
        plan = Plan(
            contents,
            ports,
            begin,
            end,
            position,
            pace,
            values["loop"],
            values["absolute"],
            values["strict"],
            values["paused"],
            values["step"],
        )
        return partial(self._use, plan)

    def _ports(self, values: Mapping[str, Any]) -> dict[str, Replayed]:
        return replayed_ports(self._look_into(values), values["only"], values["skip"], values["remap"])

    def _look_into(self, values: Mapping[str, Any]) -> Contents:
        known, path = self._contents, values["logfile"]
        if known is None or known.path != path or self._player is None:
            # A replay keeps the content that it began with, even when the file grows meanwhile.
            known = self._contents = look_into(path, known)
        return known

    def _use(self, plan: Plan) -> None:
        before, player = self._plan, self._player
        if before is not None and player is not None:
            self._change(before, plan, player)
        self._plan = plan

    def _change(self, before: Plan, plan: Plan, player: Player) -> None:
        now = plan.fixed
        if changed := [name for name, value in before.fixed.items() if value != now[name]]:
            raise ConfigurationError(
                f"{self._logger.name}.{changed[0]}: {before.contents.path} is being replayed; deactivate it first"
            )
        player.change(plan.pace)
        player.passes = plan.passes
        if plan.position is not None and plan.position != before.position:
            player.seek(max(plan.position, plan.contents.start))
        self._put(player, self._enabled and not plan.paused)
        if plan.steps > before.steps:
            player.step(plan.steps - before.steps)

    # -- hooks -----------------------------------------------------------------------------------------------------

    def initialized(self) -> None:
        pass

    def activated(self) -> None:
        self._active_in += 1
        if self._player is not None:
            return  # in another context already
        logger, plan = self._logger, self._plan
        assert plan is not None  # noqa: S101 - the configuration is in force since it was made
        try:
            loop = asyncio.get_running_loop()
        except RuntimeError:
            raise StateError(
                f"{logger.name}: replays on the kernel's loop and not in a thread; run it in an event context"
            ) from None
        self._enabled = not logger.use_control
        routes = {
            key: (logger.out_port(name), cls)
            for name, port in plan.ports.items()
            for key, cls in zip(port.keys, self._types_of(plan, port), strict=True)
        }
        player = self._player = Player(
            Reading(partial(open_recording, plan.contents.path), routes, plan.begin, plan.end),
            Playing(
                pace=plan.pace,
                passes=plan.passes,
                absolute=plan.absolute,
                position=plan.first,
                paused=plan.paused or not self._enabled,
            ),
            clock=logger.clock,
            sleep=logger.sleep,
            notify=self._warn,
        )
        if plan.paused:
            player.step(plan.steps)
        self._task = loop.create_task(self._play(player, plan), name=f"{logger.name} replays")

    def _types_of(self, plan: Plan, port: Replayed) -> list[Any]:
        types = {key: cls for one in plan.contents.ports for key, cls in zip(one.keys, one.types, strict=True)}
        return [types[key] for key in port.keys]

    def execute(self) -> None:
        pass

    def deactivated(self) -> None:
        self._active_in -= 1
        task = self._task
        if task is None or self._active_in > 0:
            return
        self._task = self._player = None
        if not task.done():
            task.cancel()
            self._left.add(task)
            task.add_done_callback(self._left.discard)

    async def wait_closed(self) -> None:
        if self._left:
            await asyncio.wait(self._left)

    async def finalized(self) -> None:
        await self.wait_closed()

    async def _play(self, player: Player, plan: Plan) -> None:
        await player.play()
        if player.fault:
            text = f"{plan.contents.path}: {player.fault}"
            if plan.strict:
                raise DamagedError(text)
            self._warn(text)
        if player.loses:
            kernel = self._logger.kernel
            kernel.exit_status = kernel.exit_status or FAILED
        if not player.sent:
            self._warn(f"{plan.contents.path}: nothing was replayed: it has no sample of these ports in this time")
        if self._logger.verbosity >= 1:
            self._logger.log.info("replayed %d samples of %s", player.sent, plan.contents.path)
        self._logger.finish()

    def _warn(self, text: str) -> None:
        self._logger.log.warning("%s", text)

    # -- while it plays --------------------------------------------------------------------------------------------

    def start(self) -> bool:
        return self._switch(True)

    def stop(self) -> bool:
        return self._switch(False)

    def pause(self) -> bool:
        """Pause the replay, as `stop` does."""
        return self._switch(False)

    def resume(self) -> bool:
        """Go on with the replay, as `start` does."""
        return self._switch(True)

    def step(self, count: int) -> bool:
        """Send the next samples while the replay is paused; return whether it is. ValueError for less than one."""
        if count < 1:
            raise ValueError(f"step: expected 1 or more samples, got {count}")
        player = self._playing("step")
        player.step(count)
        return player.paused

    def seek(self, seconds: float) -> float:
        """Play from that time on; ValueError for a number that is no time."""
        if not 0.0 <= seconds < 1e10:
            raise ValueError(f"seek: expected seconds after the first sample, got {seconds}")
        self._playing("seek").seek(self._start + round(seconds * _NS))
        return self.position()

    def position(self) -> float:
        """The position, in seconds after the first sample of the recording."""
        position = self._playing("position").position
        return 0.0 if position is None else (position - self._start) / _NS

    @property
    def _start(self) -> int:
        return 0 if self._plan is None else self._plan.contents.start

    def _playing(self, what: str) -> Player:
        if self._player is None:
            raise StateError(f"{self._logger.name}: {what}: nothing is replayed now; activate it")
        return self._player

    def _switch(self, enabled: bool) -> bool:
        player, plan = self._player, self._plan
        self._enabled = enabled
        if player is None or plan is None:
            return False
        return self._put(player, enabled and not plan.paused)

    def _put(self, player: Player, running: bool) -> bool:
        """Play or pause; return whether anything has changed."""
        if player.paused is not running:
            return False
        if running:
            player.resume()
        else:
            player.pause()
        return True
