"""A port as its recorder has it: how its samples become octets, where they go, and what became of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from aiorts.types import has_tm, is_mutable
from aiorts_log.weight import weigher

__all__ = ("PortState",)


class PortState:
    """A port that is recorded, and where its samples go: one channel, or more when there are records of subclasses."""

    def __init__(self, name: str, cls: type, metadata: Mapping[str, str]) -> None:
        self.name = name
        self.cls = cls
        self.metadata = metadata
        self.weigh = weigher(cls)
        self.stamped = has_tm(cls)
        self.mutable = is_mutable(cls)
        self.kind: type | None = None
        self.encode: Callable[[Any], bytes] = bytes
        """Makes octets of the records of that class."""
        self.split: Callable[[Any], tuple[bytes, bytes]] | None = None
        """The same in two parts, for large ones; None when that is no gain."""
        self.seen: type | None = None
        """The class of the sample before; channel and sequence are those of its samples."""
        self.channel = 0
        self.sequence = 0
        self.next: dict[int, int] = {}
        """The next sequence number of the other channels."""
        self.offered = 0
        self.dropped = 0
        self.refused = 0
        self.unfit = 0
        """Refused at once, by the thread that offered it."""
        self.stored = 0
