"""Composites and members in a system file: the components a name stands for, and the contexts they run in. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

from aiorts.model.names import names_kernel
from aiorts.model.wanted.entries import CompositeEntry, ContextEntry
from aiorts.supervision import ADDED
from aiorts.system.file.values import SystemFile
from aiorts.system.text.places import Key


def owners(composites: Mapping[str, CompositeEntry]) -> dict[str, str]:
    """The composite of each member."""
    return {member: entry.name for entry in composites.values() for member in entry.members}


def root(composites: Mapping[str, CompositeEntry], name: str) -> str:
    """The outermost composite that a component or composite runs with; without such a composite, its own name."""
    of = owners(composites)
    while name in of and not (name in composites and composites[name].own_schedule):
        name = of[name]
    return name


def parts(composites: Mapping[str, CompositeEntry], name: str, *, everybody: bool = False) -> tuple[str, ...]:
    """The components of this kernel that a component or composite consists of, in the order stated; `everybody`: also
    members of composites with a schedule of their own."""
    entry = composites.get(name)
    if entry is None:
        return () if names_kernel(name) else (name,)
    return tuple(
        part
        for member in entry.members
        if everybody or not (member in composites and composites[member].own_schedule)
        for part in parts(composites, member, everybody=everybody)
    )


def inner_first(composites: Mapping[str, CompositeEntry]) -> list[CompositeEntry]:
    """The composites, each after the composites that are its members."""
    ordered: dict[str, CompositeEntry] = {}

    def visit(entry: CompositeEntry) -> None:
        for member in entry.members:
            if member in composites and member not in ordered:
                visit(composites[member])
        ordered.setdefault(entry.name, entry)

    for entry in composites.values():
        visit(entry)
    return list(ordered.values())


def with_parts(system: SystemFile) -> SystemFile:
    """The system with components in the place of composites in the members of contexts; connections are unchanged."""
    contexts = {
        entry.name: replace(
            entry, members=tuple(part for member in entry.members for part in parts(system.composites, member))
        )
        for entry in system.contexts.values()
    }
    return replace(system, contexts=contexts)


def misplaced(
    composites: Mapping[str, CompositeEntry], contexts: Mapping[str, ContextEntry]
) -> Iterator[tuple[Key, str]]:
    """Members of a context that the file makes run in another context: the key, and the fault."""
    of = owners(composites)
    homes: dict[str, str] = {}
    for context in contexts.values():
        for member in context.members:
            homes.setdefault(member, context.name)
    for context in contexts.values():
        for number, member in enumerate(context.members):
            key: Key = ("contexts", context.name, "members", number)
            outer = root(composites, member)
            inner = composites[member].members if member in composites else ()
            if inner and all(one in composites and composites[one].own_schedule for one in inner):
                yield key, f"each member of {member} has own_schedule; name {', '.join(inner)}, each in its context"
            elif member in composites and outer != member:
                yield key, f"{member!r} is a member of {of[member]} and runs with it; give it own_schedule = true"
            elif outer != member and outer in homes:
                yield key, f"{member!r} runs in {homes[outer]} already, as a part of {outer}; take it away here"
            elif member in composites and homes[member] != context.name:
                yield key, f"{member!r} runs in {homes[member]} already; a composite is in one context"


def unstartable(system: SystemFile) -> Iterator[tuple[Key, str]]:
    """The parts of a system that cannot be started: the key, and the fault.

    These are start rules of components in no context, and contexts whose members run in different processes.
    """
    yield from _apart(system)
    run = {
        part
        for context in system.contexts.values()
        for member in context.members
        for part in parts(system.composites, member)
    }
    for entry in system.components.values():
        if entry.start is None:
            continue
        key: Key = ("components", entry.name, "start")
        if entry.name not in run:
            yield key, f"{entry.name} is in no context and cannot be started; name it among the members of one"
        for number, condition in enumerate(entry.start.conditions):
            inside = parts(system.composites, condition.component, everybody=True)
            if condition.state != ADDED and not run.intersection(inside):
                what = f"waits for {str(condition)!r} forever: {condition.component} is in no context"
                yield (*key, "after", number), f"{what}; name it among the members of one"


def _apart(system: SystemFile) -> Iterator[tuple[Key, str]]:
    """Contexts that have a member with a process of its own together with other members: the key, and the fault."""
    of = owners(system.composites)
    isolated = {name for name, entry in system.components.items() if entry.isolation}
    for name, entry in system.contexts.items():
        line = [part for member in entry.members for part in parts(system.composites, member)]
        alone = next((part for part in line if part in isolated), None)
        other = next((part for part in line if part != alone), None)
        if alone is not None and other is not None:
            where = "one, too" if other in isolated else "none"
            what = f"{alone} has a process of its own, and {other} has {where}"
            advice = "a context runs where its members are; give each one of its own"
            if alone in of:
                advice += f", and in {of[alone]} as a composite with own_schedule = true"
            yield ("contexts", name, "members"), f"{what}: {advice}"


def readers_first(names: Sequence[str], edges: Iterable[tuple[str, str]]) -> list[str]:
    """The names, each after its readers; `edges` are (writer, reader). In a circle, the order of `names` decides."""
    readers: dict[str, list[str]] = {name: [] for name in names}
    for writer, reader in edges:
        readers[writer].append(reader)
    ordered: dict[str, None] = {}
    for first in names:
        seen, stack = {first}, [(first, iter(readers[first]))]
        while stack:
            name, rest = stack[-1]
            following = next((one for one in rest if one not in seen and one not in ordered), None)
            if following is None:
                stack.pop()
                ordered.setdefault(name)
            else:
                seen.add(following)
                stack.append((following, iter(readers[following])))
    return list(ordered)


def activation_order(system: SystemFile) -> list[str]:
    """The order in which components and composites are activated, each after those it sends to: the first sample of a
    source finds its reader active."""
    composites = system.composites
    units = dict.fromkeys(root(composites, name) for name in (*system.components, *composites))
    edges = []
    for connection in system.connections:
        writer, *readers = (root(composites, path.partition(".")[0]) for path in connection.ports)
        edges += [(writer, reader) for reader in readers if not names_kernel(writer) and not names_kernel(reader)]
    return readers_first(list(units), edges)
