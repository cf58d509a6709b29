"""How often something happened a second: between two statistics, or since it could. It asks no clock."""

from __future__ import annotations

from typing import ClassVar, Self

from aiorts.errors import ConfigurationError


class Counted:
    """Statistics with a count and the moment they were taken at. See `rate_since`."""

    __slots__ = ()
    counted: ClassVar[str]
    """The field that has the count."""
    at_ns: int

    def rate_since(self, earlier: Self) -> float:
        """How often a second it was counted since the earlier statistics of the same thing, by the kernel's clock.

        Raises:
            ConfigurationError: the other statistics are not earlier, or are of something else.
        """
        kind = type(self).__name__
        if type(earlier) is not type(self):
            raise ConfigurationError(f"rate_since: {type(earlier).__name__}: expected earlier {kind}")
        span_ns = self.at_ns - earlier.at_ns
        more: int = getattr(self, self.counted) - getattr(earlier, self.counted)
        if span_ns == 0:
            raise ConfigurationError("rate_since: both statistics are of one moment; take the later ones later")
        if span_ns < 0:
            raise ConfigurationError(
                f"rate_since: the other statistics are {-span_ns / 1e9:g} s later; write later.rate_since(earlier)"
            )
        if more < 0:
            raise ConfigurationError(
                f"rate_since: {self.counted} was {-more} more in the earlier statistics; they are of something else"
            )
        return more * 1e9 / span_ns


def mean_rate(count: int, since_ns: int, at_ns: int) -> float:
    """How often a second from one moment to the other; 0 where there is no time between them."""
    return count * 1e9 / (at_ns - since_ns) if at_ns > since_ns else 0.0
