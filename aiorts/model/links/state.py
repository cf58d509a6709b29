"""The states of a link, as either end sees it."""

from __future__ import annotations

from enum import StrEnum


class LinkState(StrEnum):
    """The state of a link."""

    CONNECTING = "connecting"
    """The link has had no channel yet, or the other end has not answered on it."""
    UP = "up"
    """Samples travel."""
    STALLED = "stalled"
    """There is a channel, and nothing was acknowledged for 2 s though samples are on their way."""
    DOWN = "down"
    """The channel is gone; the link waits for another."""
    ENDED = "ended"
    """One of the ends was disconnected."""
