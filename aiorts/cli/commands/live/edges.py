"""The connectors that a word of a command line means: one by its name or its ports, or all of a port."""

from __future__ import annotations

from collections.abc import Mapping
from fnmatch import fnmatchcase
from typing import Any

import click

from aiorts.cli.commands.live.target import Kernels, Running, kernels, the_one
from aiorts.errors import AbsentError
from aiorts.late import dataclass


@dataclass(frozen=True, slots=True)
class Edge:
    """A connector of data ports in a running kernel."""

    name: str
    out: str
    in_: str

    @property
    def path(self) -> str:
        """The paths of both ports, with " -> " between them."""
        return f"{self.out} -> {self.in_}"


def edges(names: Mapping[str, Any]) -> dict[str, Edge]:
    """The connectors of a kernel by name, from the answer of the operation `names`."""
    wires = names["connectors"].items()
    return {name: Edge(name, ports[0], ports[1]) for name, ports in wires if len(ports) == 2}


def find_edges(found: Kernels, word: str) -> tuple[Running, tuple[Edge, ...]]:
    """Find the connectors of one kernel by a word: "a.out->b.in", a connector's name, or "a.out" for all of a port.

    * and ? stand for any characters.

    Raises:
        AbsentError: no connector fits the word.
        AmbiguousError: connectors of several kernels fit; the text lists them.
        NoAnswerError: the kernel that is meant does not answer.
    """
    kernel, _, path = word.rpartition("/")
    path = path.replace(" ", "")
    hits: list[tuple[Running, tuple[Edge, ...]]] = []
    for one in found.running:
        if not kernel or one.fits(kernel):
            meant = tuple(edge for edge in edges(one.names).values() if _means(path, edge))
            hits += [(one, meant)] if meant else []
    if hits:
        return the_one(word, hits, [f"{one.name}/{path}" for one, _ in hits])
    known = found.find(f"{kernel}/{path.partition('->')[0]}" if kernel else path.partition("->")[0])
    there = ", ".join(edge.path for edge in edges(known.running.names).values()) or "none"
    raise AbsentError(
        f"{word}: no connector is there, and only they count samples; {known.running.name} has {there:.300}"
    )


def _means(path: str, edge: Edge) -> bool:
    return any(fnmatchcase(one, path) for one in (edge.name, edge.path.replace(" ", ""), edge.out, edge.in_))


def complete_edge(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[Any]:
    """Complete ports and connectors of running kernels."""
    from aiorts.cli.console.completion import items

    with kernels(timeout=0.1) as found:
        those = [edge for one in found.running for edge in edges(one.names).values()]
    return items(dict.fromkeys(word for edge in those for word in (edge.out, edge.in_, edge.name)), incomplete)
