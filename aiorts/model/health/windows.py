"""The counts of a system up to a moment, and in a window between two moments. No clock is asked."""

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
"""The reasons of drops that are no loss: an option asks for them, or the reader is not active."""


class EdgeCounts(NamedTuple):
    """The counts of one connector's samples."""

    source: str
    """The path of its out-port."""
    target: str
    """The path of its in-port."""
    written: int = 0
    dropped: int = 0
    """Samples dropped for a reason that is not in `ASKED_FOR`."""
    left_out: int = 0
    """Samples dropped for a reason of `ASKED_FOR`."""


class ContextCounts(NamedTuple):
    """The counts of one execution context's ticks."""

    ticks: int = 0
    """The ticks that were run, and those that were left out."""
    overruns: int = 0
    by_machine: int = 0
    """Overruns for which the machine is to blame."""
    left_out: int = 0
    """Ticks that were left out by overruns for which the machine is to blame."""
    rate: float | None = None
    """The rate in Hz; None for a context without one."""
    paced: bool = False
    """Whether the loop runs the context and leaves out missed ticks: no backlog of samples follows a stall."""
    members: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Window:
    """The counts of a system between two moments, of the connectors and contexts that exist at the later one."""

    length_ns: int
    """The length on the kernel's clock."""
    edges: Mapping[str, EdgeCounts] = field(default_factory=lambda: _NO_EDGES)
    """The counts by the connector's name."""
    contexts: Mapping[str, ContextCounts] = field(default_factory=lambda: _NO_CONTEXTS)
    errors: Mapping[str, str] = field(default_factory=lambda: _NO_ERRORS)
    """The reason, by component, of each component that was in error in the window."""
    idle: frozenset[str] = frozenset()
    """Components that are in contexts and run in none at the window's end: not active, and not in error."""
    stalled: float = 0.0
    """The part of the time in which threads of this process were ready to run and the machine ran others; the sum over
    all threads, so above 1 where several waited at once."""


def edge_since(start: EdgeCounts | None, end: EdgeCounts) -> EdgeCounts:
    """The counts from one moment to the other; all counts of a connector that was made again in between."""
    if start is None or any(was > now for was, now in zip(start[2:], end[2:], strict=True)):
        return end
    return EdgeCounts(end.source, end.target, *(now - was for was, now in zip(start[2:], end[2:], strict=True)))


def context_since(start: ContextCounts | None, end: ContextCounts) -> ContextCounts:
    """The counts from one moment to the other; all counts of a context that was started again in between."""
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
