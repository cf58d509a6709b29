"""This file decides what a bounded buffer does at its ends; it never waits, wakes or asks the time.

`decide` is the truth for a full buffer.
"""

from __future__ import annotations

from enum import Enum, StrEnum
from typing import Final

DEFAULT_LENGTH: Final = 8
"""Samples of a buffer where nothing says how many."""
MAX_LENGTH: Final = 1_000_000
"""Samples of the longest buffer."""


class FullPolicy(StrEnum):
    """What a write does when the buffer is full."""

    OVERWRITE = "overwrite"
    REJECT = "reject"
    BLOCK = "block"


class EmptyPolicy(StrEnum):
    """What a generic component does when there is nothing to read (OpenRTM's buffer.read.empty_policy)."""

    READBACK = "readback"
    NOTHING = "do_nothing"
    BLOCK = "block"


class Verdict(Enum):
    """What becomes of a sample that is offered to a buffer."""

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
    """What to do with a sample offered to a buffer that holds `buffered` of at most `length` samples."""
    return _STORE if buffered < length else _WHEN_FULL[full]
