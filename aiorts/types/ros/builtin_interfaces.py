"""Records of ROS's package builtin_interfaces."""

from __future__ import annotations

from aiorts.types.kinds import NS_PER_SEC
from aiorts.types.record import record
from aiorts.types.spelling import i32, u32


@record
class Time:
    """A moment since the epoch: whole seconds, negative before 1970, and nanoseconds beyond them."""

    sec: i32 = 0
    nanosec: u32 = 0

    @classmethod
    def from_ns(cls, ns: int) -> Time:
        """The moment so many nanoseconds after the epoch; RecordError outside -2**31 <= seconds < 2**31."""
        return cls(*divmod(ns, NS_PER_SEC))

    @property
    def ns(self) -> int:
        """Nanoseconds since the epoch."""
        return self.sec * NS_PER_SEC + self.nanosec
