"""What was counted of a system up to a moment, and in a window between two moments. It asks no clock."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from types import MappingProxyType
from typing import Final, NamedTuple

from aiorts.late import dataclass

_NO_EDGES: Final[Mapping[str, EdgeCounts]] = MappingProxyType({})
_NO_CONTEXTS: Final[Mapping[str, ContextCounts]] = MappingProxyType({})
_NO_ERRORS: Final[Mapping[str, str]] = MappingProxyType({})
ASKED_FOR: Final = frozenset(("skipped", "superseded", "inactive"))
"""Why samples are dropped that nobody misses: an option asks for it, or the reader is not active."""


class EdgeCounts(NamedTuple):
    """Samples of one connector."""

    source: str
    """The path of its out-port."""
    target: str
    """The path of its in-port."""
    written: int = 0
    dropped: int = 0
    """For another reason than those `ASKED_FOR`."""
    left_out: int = 0
    """For one of those."""


class ContextCounts(NamedTuple):
    """Ticks of one execution context."""

    ticks: int = 0
    """Those that were run and those that were left out."""
    overruns: int = 0
    by_machine: int = 0
    """Overruns for which the machine is to blame."""
    left_out: int = 0
    """Ticks that were left out by those."""
    rate: float | None = None
    """Hz; None for a context without a rate."""
    paced: bool = False
    """Whether the loop runs it and ticks that are missed are left out: no backlog of samples follows when it stalls."""
    members: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Window:
    """What was counted of a system between two moments, of what there is at the later one."""

    length_ns: int
    """On the kernel's clock."""
    edges: Mapping[str, EdgeCounts] = field(default_factory=lambda: _NO_EDGES)
    """By the connector's name."""
    contexts: Mapping[str, ContextCounts] = field(default_factory=lambda: _NO_CONTEXTS)
    errors: Mapping[str, str] = field(default_factory=lambda: _NO_ERRORS)
    """Components that are in error at its end, or were meanwhile, each with why."""
    idle: frozenset[str] = frozenset()
    """Components that a context has and none runs at its end: not active, and not in error."""
    stalled: float = 0.0
    """For which part of the time threads of this process were ready to run and the machine ran others: of all together,
    above 1 where it was several at once."""


def edge_since(start: EdgeCounts | None, end: EdgeCounts) -> EdgeCounts:
    """What was counted from one moment to the other; one that was made anew in between counts whole."""
    if start is None or any(was > now for was, now in zip(start[2:], end[2:], strict=True)):
        return end
    return EdgeCounts(end.source, end.target, *(now - was for was, now in zip(start[2:], end[2:], strict=True)))


def context_since(start: ContextCounts | None, end: ContextCounts) -> ContextCounts:
    """What was counted from one moment to the other; one that was started anew in between counts whole."""
    if start is None or start.ticks > end.ticks or start.overruns > end.overruns:
        return end
    return ContextCounts(
        end.ticks - start.ticks,
        end.overruns - start.overruns,
        end.by_machine - start.by_machine,
        end.left_out - start.left_out,
        end.rate,
        end.paced,
        end.members,
    )
