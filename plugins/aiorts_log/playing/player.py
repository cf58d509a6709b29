"""Plays a recording: sends each sample when it is due; can be paused, stepped and moved meanwhile.

`schedule` decides when a sample is due, `read_ahead` which is next; the player waits. A slow receiver delays the
samples after, in order; none is left out.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

from aiorts import Clock, OutPort, SimulatedClock, WouldBlock
from aiorts.types import with_tm
from aiorts_log.playing.read_ahead import ReadAhead, Reading
from aiorts_log.playing.schedule import Pace, Schedule

Send: TypeAlias = Callable[[Any, Any], Awaitable[None]]
"""Sends a sample to the target of its route."""
_AT_ONCE: Final = 8
"""Samples between two turns of the loop: the default length of a connector's buffer."""
_LONGEST_SLEEP: Final = 100_000 * 1_000_000_000
"""Nanoseconds of the longest sleep; more of them cannot be exact as seconds in a float."""
_PAUSE: Final = 0.001
"""Seconds of a pause after a pass that took no time: endless passes would otherwise stop simulated time."""
_STAMP_LIMIT: Final = 2**32 * 1_000_000_000


async def to_port(port: OutPort[Any], sample: Any) -> None:
    """Write a sample, and wait where there is no room."""
    try:
        port.write_nowait(sample)
    except WouldBlock:
        await port.write(sample)


@dataclass(frozen=True, slots=True, kw_only=True)
class Playing:
    """The options for playing a recording.

    Attributes:
        pace: how fast.
        passes: how often; 0 is without end.
        absolute: whether time stamps stay as recorded; else they are shifted so that the first is the time of the
            clock, and go on evenly over pauses, jumps, gaps and passes. 0, which is no time, stays 0.
        position: log time in ns from which the first pass plays; None is its beginning.
        paused: whether it is paused from the beginning.
    """

    pace: Pace
    passes: int = 1
    absolute: bool = False
    position: int | None = None
    paused: bool = False


class Player:
    """One replay of a recording, from its activation to its end.

    Args:
        reading: the recording that is played.
        playing: the options.
        clock: whose time it keeps; sleep: waits for seconds of it.
        send: sends a sample, and may wait; by default it writes to the target, an out-port.
        notify: called with a sentence about a problem found.

    Attributes:
        sent: samples sent.
        gaps: gaps that were shortened; left_out: ns of them.
        passes: how often it is played in all, 0 without end; may be changed.
    """

    def __init__(
        self,
        reading: Reading,
        playing: Playing,
        *,
        clock: Clock,
        sleep: Callable[[float], Awaitable[None]],
        send: Send = to_port,
        notify: Callable[[str], None],
    ) -> None:
        self.sent = self.gaps = self.left_out = 0
        self.passes = playing.passes
        self._clock, self._sleep, self._send, self._notify = clock, sleep, send, notify
        self._ahead = ReadAhead(reading, in_place=isinstance(clock, SimulatedClock))
        self._begin_at = playing.position
        self._pace = playing.pace
        self._schedule = Schedule(playing.pace, clock.monotonic_ns(), playing.position)
        self._absolute = playing.absolute
        self._offset: int | None = None
        self._clamped = self._went_back = 0
        self._target: int | None = None
        """The log time that `seek` requested."""
        self._task: asyncio.Task[Any] | None = None
        self._sleeping = self._nudged = False
        self._changed = asyncio.Event()
        self._fresh: set[Any] = set()
        """Targets that got samples since the last turn of the loop."""
        self._before: Any = None
        self._moment = -1
        """Target and log time of the last sample."""
        if playing.paused:
            self._schedule.pause(clock.monotonic_ns())

    # -- requests while it plays -------------------------------------------------------------------------------------

    @property
    def paused(self) -> bool:
        """Whether it is paused."""
        return self._schedule.paused

    @property
    def position(self) -> int | None:
        """The log time that is played now, in ns; None before the first sample."""
        return self._schedule.position(self._clock.monotonic_ns())

    def pause(self) -> None:
        """Send nothing more until `resume`."""
        self._schedule.pause(self._clock.monotonic_ns())
        self._wake()

    def resume(self) -> None:
        """Go on where it was paused."""
        self._schedule.resume(self._clock.monotonic_ns())
        self._wake()

    def step(self, count: int = 1) -> None:
        """Send the next `count` samples while it is paused; does nothing while it plays."""
        self._schedule.allow(count)
        self._wake()

    def seek(self, position: int) -> None:
        """Play from that log time on, paused or not."""
        self._schedule.jump(self._clock.monotonic_ns(), position)
        self._target = position
        self._wake()

    def change(self, pace: Pace) -> None:
        """Go on at another pace."""
        self._schedule.change(self._clock.monotonic_ns(), pace)
        self._pace = pace
        self._wake()

    # -- playing ---------------------------------------------------------------------------------------------------

    async def play(self) -> None:
        """Play the recording to its end.

        Raises:
            RecordingError: it cannot be opened, or not read to its end; the samples before that were sent.
        """
        self._task = asyncio.current_task()
        try:
            await self._ahead.open()
            await self._ahead.begin(self._begin_at)
            await self._play()
        finally:
            await self._ahead.close()
        self._report()

    async def _play(self) -> None:
        done, restarted, looked = 0, False, True
        began = self._clock.monotonic_ns()
        while True:
            block = await self._ahead.block()
            if self._target is None:
                if looked:
                    # The time it took to open the file, or to find the place, must not cause a burst.
                    self._schedule.begin(self._clock.monotonic_ns())
                    looked = False
                if restarted and block.samples:
                    self._schedule.again(block.samples[0][1])
                    restarted = False
                await self._play_block(block.samples)
            if self._target is not None:
                target, self._target, restarted, looked = self._target, None, False, True
                await self._ahead.begin(target)
            elif block.error is not None:
                raise block.error
            elif not block.samples:
                done += 1
                if restarted or 0 < self.passes <= done:
                    if await self._is_over():
                        return
                    continue
                if self._clock.monotonic_ns() - began < 1e9 * _PAUSE:
                    await self._sleep(_PAUSE)
                began, restarted = self._clock.monotonic_ns(), True
                await self._ahead.begin(None)

    async def _is_over(self) -> bool:
        """Wait at the end while the player is paused, since `seek` may go back. False when `seek` did."""
        while self.paused and self._target is None:
            self._changed.clear()
            await self._changed.wait()
        return self._target is None

    async def _play_block(self, samples: list[tuple[Any, int, Any, bool]]) -> None:
        """Send each sample when it is due, until the end of the block or a `seek`."""
        schedule, send, monotonic_ns = self._schedule, self._send, self._clock.monotonic_ns
        adjusted, now = not self._absolute, monotonic_ns()
        fresh, before, moment = self._fresh, self._before, self._moment
        for target, log_time, record, stamped in samples:
            if self._target is not None:
                return
            if target is not before and fresh and (target in fresh or log_time != moment):
                # A turn for the loop: a reader of both ports in one cycle must not get the later sample first.
                await asyncio.sleep(0)
                fresh.clear()
                if self._target is not None:
                    return
            if cut := schedule.take(log_time):
                self._note_cut(log_time, cut)
            due = schedule.due
            if due is None or due > now:
                await self._until_due()
                now = monotonic_ns()
                fresh.clear()
            if self._target is not None:
                return
            allowed = schedule.paused
            if allowed:
                schedule.step(now)
            await send(target, self._stamped(record) if stamped and adjusted else record)
            self.sent += 1
            moment = log_time
            schedule.sent(now, allowed=allowed)
            fresh.add(target)
            before = target
            if not self.sent % _AT_ONCE:
                await asyncio.sleep(0)
                fresh.clear()
        self._before, self._moment = before, moment

    async def _until_due(self) -> None:
        schedule = self._schedule
        while self._target is None:
            due = schedule.due
            if due is None:
                self._changed.clear()
                await self._changed.wait()
                continue
            left = due - self._clock.monotonic_ns()
            if left <= 0:
                return
            await self._sleep_unless_woken(min(left, _LONGEST_SLEEP) / 1e9)

    async def _sleep_unless_woken(self, seconds: float) -> None:
        self._sleeping = True
        try:
            await self._sleep(seconds)
        except asyncio.CancelledError:
            task = self._task
            if not self._nudged or task is None or task.uncancel() > 0:
                raise
        finally:
            self._sleeping = self._nudged = False

    def _wake(self) -> None:
        """Interrupt the wait for the next sample: its due time has changed."""
        self._changed.set()
        if self._sleeping and not self._nudged and self._task is not None:
            self._nudged = True
            self._task.cancel()

    # -- stamps, and what was found --------------------------------------------------------------------------------

    def _stamped(self, record: Any) -> Any:
        tm = record.tm
        if not tm:
            return record
        shift = self._schedule.shift
        if self._offset is None:
            self._offset = self._clock.time_ns() - tm - shift
        shifted = tm + self._offset + shift
        if not 0 <= shifted < _STAMP_LIMIT:
            shifted = min(max(shifted, 0), _STAMP_LIMIT - 1)
            self._clamped += 1
        return with_tm(record, shifted)

    def _note_cut(self, log_time: int, cut: int) -> None:
        if cut < 0:
            self._went_back += 1
            if self._went_back == 1:
                self._notify(f"its clock was set back by {-cut / 1e9:g} s; it is played in the order of its numbers")
            return
        self.gaps += 1
        self.left_out += cut
        most = (self._pace.max_gap or 0) / 1e9
        self._notify(
            f"no sample for {cut / 1e9 + most:g} s before log time {log_time}; {most:g} s of it are waited for"
        )

    def _report(self) -> None:
        unreadable = self._ahead.unreadable
        if unreadable.count:
            self._notify(f"{unreadable.count} samples are none of their type and were left out: {unreadable.first}")
        if self._clamped:
            self._notify(
                f"{self._clamped} stamps would have been outside of what a stamp can be, and were brought back"
            )

    @property
    def fault(self) -> str:
        """The fault of the recording, as far as known; "" is none."""
        return self._ahead.fault

    @property
    def loses(self) -> bool:
        """Whether the recording has samples that cannot be sent: its end is torn, or a sample is not of its type."""
        return self._ahead.loses

    @property
    def unreadable(self) -> int:
        """The number of samples left out since they are not of their type."""
        return self._ahead.unreadable.count
