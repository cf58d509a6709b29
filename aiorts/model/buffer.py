"""This file decides what a bounded buffer does at its ends; it never waits, wakes or asks the time.

`decide` alone defines what happens at a full buffer.
"""

from __future__ import annotations

from enum import Enum, StrEnum
from typing import Final

DEFAULT_LENGTH: Final = 8
"""The length of a buffer, in samples, where none is given."""
MAX_LENGTH: Final = 1_000_000
"""The length of the longest buffer, in samples."""


class FullPolicy(StrEnum):
    """The behaviour of a write when the buffer is full."""

    OVERWRITE = "overwrite"
    REJECT = "reject"
    BLOCK = "block"


class EmptyPolicy(StrEnum):
    """The behaviour of a generic component when there is nothing to read (OpenRTM's buffer.read.empty_policy)."""

    READBACK = "readback"
    NOTHING = "do_nothing"
    BLOCK = "block"


class Verdict(Enum):
    """The treatment of a sample that is offered to a buffer."""

    STORE = "store"
    REPLACE_OLDEST = "replace oldest"
    REFUSE = "refuse"
    WAIT = "wait"


_WHEN_FULL = {
    FullPolicy.OVERWRITE: Verdict.REPLACE_OLDEST,
    FullPolicy.REJECT: Verdict.REFUSE,
    FullPolicy.BLOCK: Verdict.WAIT,
}


_STORE = Verdict.STORE


def decide(buffered: int, length: int, full: FullPolicy) -> Verdict:
    """The decision on a sample offered to a buffer that holds `buffered` of at most `length` samples."""
    return _STORE if buffered < length else _WHEN_FULL[full]
