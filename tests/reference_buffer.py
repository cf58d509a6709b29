"""The buffer that connectors are compared with: a full policy and a ledger, and nothing done for speed."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from aiorts.model.buffer import FullPolicy, Verdict, decide

T = TypeVar("T")

DROP_REASONS = ("overwritten", "rejected", "timeout", "skipped", "superseded", "inactive", "disconnected", "lost")
"""Why a sample that was written is never delivered; `lost` is for remote connectors."""


@dataclass
class Buffer(Generic[T]):
    """The reference buffer: `length` samples at the most, a full policy, a ledger that always balances."""

    length: int
    full: FullPolicy = FullPolicy.OVERWRITE
    samples: deque[T] = field(default_factory=deque)
    written: int = 0
    delivered: int = 0
    dropped: dict[str, int] = field(default_factory=dict)

    def offer(self, sample: T) -> Verdict:
        """Take the sample in as far as the full policy allows; WAIT leaves everything as it was."""
        verdict = decide(len(self.samples), self.length, self.full)
        if verdict is Verdict.WAIT:
            return verdict
        self.written += 1
        if verdict is Verdict.REFUSE:
            self.drop("rejected")
            return verdict
        if verdict is Verdict.REPLACE_OLDEST:
            self.samples.popleft()
            self.drop("overwritten")
        self.samples.append(sample)
        return verdict

    def take(self) -> T:
        """The oldest sample; IndexError when there is none."""
        sample = self.samples.popleft()
        self.delivered += 1
        return sample

    def take_newest(self) -> T:
        """The newest sample; what is older is superseded. IndexError when there is none."""
        sample = self.samples.pop()
        self.delivered += 1
        self.drop("superseded", len(self.samples))
        self.samples.clear()
        return sample

    def discard(self, reason: str) -> None:
        """Drop everything for `reason`."""
        self.drop(reason, len(self.samples))
        self.samples.clear()

    def drop(self, reason: str, count: int = 1) -> None:
        """Count `count` samples as dropped for `reason`."""
        if count:
            self.dropped[reason] = self.dropped.get(reason, 0) + count

    @property
    def balanced(self) -> bool:
        """Whether written = delivered + dropped + buffered."""
        return self.written == self.delivered + sum(self.dropped.values()) + len(self.samples)
