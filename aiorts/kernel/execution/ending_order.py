"""In which order components end: who calls before who answers, who writes before who reads. Pure: names and edges.

A component that calls another one in its last hook needs it there; what a writer sends last is read by a reader that is
still active. Circles have no such order: there it is the reverse of the start. A circle of data (a controller and its
plant) says nothing about calls, so calls are ordered within it, too.
"""

from __future__ import annotations

import heapq
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import TypeAlias

Edges: TypeAlias = Mapping[str, Collection[str]]
"""The components that end after each one, by its name."""


def ending_order(names: Sequence[str], calls: Edges, data: Edges) -> list[list[str]]:
    """The components in the order in which they end; those of one circle of calls are together.

    Args:
        names: of the components, in the order of their start.
        calls: of each that calls, those that answer.
        data: of each that writes, those that read.
    """
    order: list[list[str]] = []
    for group in _sorted_groups(names, (calls, data)):
        order += [part[::-1] for part in _sorted_groups(group, (calls,))]
    return order


def _sorted_groups(names: Sequence[str], layers: Sequence[Edges]) -> Iterator[list[str]]:
    """Components of one circle together, before all that end after them; else those first that were started last."""
    place = {name: index for index, name in enumerate(names)}
    after = {name: [one for edges in layers for one in edges.get(name, ()) if one in place] for name in names}
    groups = [sorted(group, key=place.__getitem__) for group in _circles(names, after)]
    group_of = {name: number for number, group in enumerate(groups) for name in group}
    behind = [{group_of[one] for name in group for one in after[name]} - {n} for n, group in enumerate(groups)]
    waits = [0] * len(groups)
    for those in behind:
        for number in those:
            waits[number] += 1
    ready = [(-place[group[-1]], number) for number, group in enumerate(groups) if not waits[number]]
    heapq.heapify(ready)
    while ready:
        _, number = heapq.heappop(ready)
        yield groups[number]
        for one in behind[number]:
            waits[one] -= 1
            if not waits[one]:
                heapq.heappush(ready, (-place[groups[one][-1]], one))


def _circles(names: Sequence[str], after: Mapping[str, Sequence[str]]) -> Iterator[list[str]]:
    """The strongly connected components of the graph (Tarjan), without recursion: a chain may have thousands."""
    seen: dict[str, int] = {}
    least: dict[str, int] = {}
    path: list[str] = []
    on_path: set[str] = set()
    for start in names:
        if start in seen:
            continue
        walk = [(start, iter(after[start]))]
        seen[start] = least[start] = len(seen)
        path.append(start)
        on_path.add(start)
        while walk:
            name, rest = walk[-1]
            for one in rest:
                if one not in seen:
                    seen[one] = least[one] = len(seen)
                    path.append(one)
                    on_path.add(one)
                    walk.append((one, iter(after[one])))
                    break
                if one in on_path:
                    least[name] = min(least[name], seen[one])
            else:
                walk.pop()
                if walk:
                    above = walk[-1][0]
                    least[above] = min(least[above], least[name])
                if least[name] == seen[name]:
                    place = path.index(name)
                    group = path[place:]
                    del path[place:]
                    on_path.difference_update(group)
                    yield group
