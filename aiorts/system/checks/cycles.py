"""Finds the cycles in a graph of connected components, and names them for messages. Pure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final, TypeAlias

Edges: TypeAlias = Mapping[str, Mapping[str, tuple[str, str, int]]]
"""By writer and reader: the out-port and in-port that join them, and the number of the connection."""
_MOST_NAMED: Final = 12
"""The most ports of a cycle that a message names."""


def cycles(edges: Edges) -> Iterator[tuple[str, int, list[str]]]:
    """A cycle through each component that no earlier cycle has: its ports, last connection's number, and components."""
    told: set[str] = set()
    for start in edges:
        if start in told or not (cycle := _cycle(edges, start)):
            continue
        told.update(cycle)
        path = [
            port for here, there in zip(cycle, [*cycle[1:], cycle[0]], strict=True) for port in edges[here][there][:2]
        ]
        shown = [*path[:_MOST_NAMED], "..."] if len(path) > _MOST_NAMED else path
        yield " → ".join([*shown, path[0]]), edges[cycle[-1]][cycle[0]][2], cycle


def _cycle(edges: Mapping[str, Mapping[str, Any]], start: str) -> list[str]:
    """The shortest way from a component back to itself; empty where there is none."""
    came: dict[str, str] = {}
    level = [start]
    while level:
        following = []
        for here in level:
            for there in edges[here]:
                if there == start:
                    way = [here]
                    while way[-1] != start:
                        way.append(came[way[-1]])
                    return way[::-1]
                if there not in came:
                    came[there] = here
                    following.append(there)
        level = following
    return []
