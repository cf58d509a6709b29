"""One viewer: its state, its subscriptions, and the bounded queue of samples to it."""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import AsyncIterator, Iterable, Mapping
from typing import Final

from aiorts_foxglove import protocol
from aiorts_foxglove.channels import Channel

QUEUE: Final = 1_000
"""The most samples that wait for a viewer."""
QUEUE_BYTES: Final = 8 << 20
_PATIENCE: Final = 1.0
"""Seconds between two statements of how much was dropped."""


class Viewer:
    """A viewer. Messages to it are made of state where they can be, so only samples queue up: the oldest are dropped.

    Attributes:
        wanted: by channel, the viewer's number of the subscription.
        dropped: samples that it wanted and did not get.
    """

    def __init__(self) -> None:
        self.wanted: dict[int, int] = {}
        self.dropped = 0
        self._session = self._sent_session = ("", "")
        self._channels: Mapping[int, Channel] = {}
        self._sent_channels: dict[int, Channel] | None = None
        self._statuses: dict[str, tuple[int, str] | None] = {}
        self._shown: set[str] = set()
        self._time_ns = self._sent_time_ns = 0
        self._samples: deque[tuple[int, bytes]] = deque()
        self._bytes = 0
        self._dropped_shown, self._dropped_at = 0, 0.0
        self._wake = asyncio.Event()

    def show(self, session: tuple[str, str], channels: Mapping[int, Channel]) -> None:
        """Show what runs: its name, the number of the session, the channels."""
        self._session, self._channels = session, channels
        for channel in self.wanted.keys() - channels.keys():
            del self.wanted[channel]
        self._wake.set()

    def subscribe(self, wanted: Iterable[tuple[int, int]]) -> None:
        """Subscribe to channels; those that are refused are reported in one line."""
        refused = 0
        for subscription, channel in wanted:
            known = channel in self._channels and channel in (self._sent_channels or ())
            if known and channel not in self.wanted and subscription not in self.wanted.values():
                self.wanted[channel] = subscription
            else:
                refused += 1
        if refused:
            why = "no such channel, or the channel or number is in use"
            self.say("request", protocol.ERROR, f"subscribe: {refused} refused: {why}")

    def unsubscribe(self, subscriptions: Iterable[int]) -> None:
        """End subscriptions; their waiting samples are not sent."""
        ended = set(subscriptions)
        gone = {channel for channel, subscription in self.wanted.items() if subscription in ended}
        for channel in gone:
            del self.wanted[channel]
        if unknown := len(ended) - len(gone):
            self.say("request", protocol.WARNING, f"unsubscribe: {unknown} of no subscription")
        self._samples = deque(one for one in self._samples if one[0] not in gone)
        self._bytes = sum(len(message) for _, message in self._samples)

    def say(self, key: str, level: int, text: str) -> None:
        """Show a line in the place of the line with the same key; "" removes it."""
        if text:
            self._statuses[key] = level, text[:500]
        elif key in self._shown or key in self._statuses:
            self._statuses[key] = None
        self._wake.set()

    def show_time(self, time_ns: int) -> None:
        """Show the time; never an earlier one than before."""
        if time_ns > self._time_ns:
            self._time_ns = time_ns
            self._wake.set()

    def offer(self, channel: int, time_ns: int, payload: bytes) -> None:
        """Queue a sample of a channel that is wanted."""
        message = protocol.sample(self.wanted[channel], time_ns, payload)
        self._samples.append((channel, message))
        self._bytes += len(message)
        while len(self._samples) > QUEUE or (self._bytes > QUEUE_BYTES and len(self._samples) > 1):
            self._bytes -= len(self._samples.popleft()[1])
            self.dropped += 1
        self._wake.set()

    def lose(self, count: int) -> None:
        """Count samples that were dropped on their way here."""
        self.dropped += count
        self._wake.set()

    async def messages(self) -> AsyncIterator[str | bytes]:
        """The messages to send, as they come; the queue is bounded while the next is not asked for."""
        while True:
            for _ in range(len(self._samples)):
                if not self._samples:
                    break
                message = self._samples.popleft()[1]
                self._bytes -= len(message)
                yield message
            for text in self._changed():
                yield text
            if self._time_ns > self._sent_time_ns:
                self._sent_time_ns = self._time_ns
                yield protocol.time(self._time_ns)
            if not self._samples:
                await self._sleep()

    def _changed(self) -> list[str]:
        """The messages for all state that differs from what was sent last."""
        found: list[str] = []
        before, self._sent_channels = self._sent_channels, dict(self._channels)
        now = self._sent_channels
        if gone := (before or {}).keys() - now.keys():
            found.append(protocol.unadvertise(gone))
        if self._session != self._sent_session:
            self._sent_session = self._session
            found.append(protocol.server_info(*self._session))
            self._sent_time_ns = self._time_ns = 0
        self._count_dropped()
        statuses, self._statuses = self._statuses, {}
        found += [protocol.status(key, *line) for key, line in statuses.items() if line is not None]
        self._shown |= {key for key, line in statuses.items() if line is not None}
        if removed := [key for key, line in statuses.items() if line is None and key in self._shown]:
            self._shown -= set(removed)
            found.append(protocol.remove_status(removed))
        if before is None or now.keys() - before.keys():
            found.append(protocol.advertise(now[one].plain for one in sorted(now.keys() - (before or {}).keys())))
        return found

    def _count_dropped(self) -> None:
        now = time.monotonic()
        if self.dropped > self._dropped_shown and now - self._dropped_at >= _PATIENCE:
            self._dropped_shown, self._dropped_at = self.dropped, now
            self.say("dropped", protocol.WARNING, f"{self.dropped} samples were dropped on the way to this viewer")

    async def _sleep(self) -> None:
        """Wait until there is something to send."""
        left = _PATIENCE if self.dropped > self._dropped_shown else None
        try:
            async with asyncio.timeout(left):
                await self._wake.wait()
        except TimeoutError:
            pass
        self._wake.clear()
