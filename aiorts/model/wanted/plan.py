"""The difference between two systems, as the steps that make one of the other; pure.

New parts are made and connected first, then all changes are switched over, then parts that are not wanted go. So no
sample is lost for want of a reader, and the reverse steps in reverse order are right, too. No step touches equal
parts. The order of components, connections and contexts means nothing; the order of members does.
"""

from __future__ import annotations

from collections.abc import Collection, Generator, Iterator, Mapping, Set
from dataclasses import replace
from itertools import pairwise
from types import MappingProxyType
from typing import Any, Final, TypeVar

from aiorts.late import dataclass
from aiorts.model.names import names_kernel
from aiorts.model.naming import Numbering
from aiorts.model.options import CHANGEABLE, USUAL_APART, has_buffer, without_identity
from aiorts.model.wanted.entries import (
    CHANGED_BY_RULE,
    ComponentEntry,
    CompositeEntry,
    ConnectionEntry,
    ContextEntry,
    Wanted,
)
from aiorts.model.wanted.steps import (
    Activate,
    AddRules,
    Change,
    Configure,
    Connect,
    Create,
    Disconnect,
    Isolate,
    Move,
    Places,
    Reload,
    Remove,
    Renew,
    RenewContext,
    Retime,
    StartContext,
    Step,
    StopContext,
    Supervise,
)
from aiorts.model.wanted.stepwise import finished

_ABSENT: Final = object()
_NOTHING: Final[Mapping[str, Any]] = MappingProxyType({})
E = TypeVar("E", ContextEntry, CompositeEntry)


@dataclass(frozen=True, slots=True)
class Plan:
    """The steps that make one system of another, in order."""

    steps: tuple[Step, ...] = ()
    refused: tuple[str, ...] = ()
    """Differences that cannot be changed while a system runs."""

    @property
    def empty(self) -> bool:
        """Whether the two systems are the same."""
        return not self.steps and not self.refused

    def reverse(self) -> Plan:
        """The plan that takes all of this back."""
        return Plan(tuple(step.reverse() for step in reversed(self.steps)), self.refused)

    def to_plain(self) -> dict[str, Any]:
        """The plan as JSON has it."""
        return {"steps": [step.to_plain() for step in self.steps], "refused": list(self.refused)}


def plan(
    now: Wanted, wanted: Wanted, *, limited: Collection[str] = frozenset(), exclusive: Collection[str] = frozenset()
) -> Plan:
    """The steps that make the wanted system of the present one; both in the one form (see `Wanted`).

    Args:
        limited: paths of ports that take a limited number of connectors: there one goes before another comes.
        exclusive: names of components that hold a device that their replacement needs: they go before anything is made.
    """
    return finished(planning(now, wanted, limited, exclusive))


def planning(
    now: Wanted, wanted: Wanted, limited: Collection[str], exclusive: Collection[str]
) -> Generator[None, None, Plan]:
    """Do `plan` stepwise: a generator that pauses between parts of the work."""
    first = {
        name
        for name in exclusive
        if name in now.components
        and (name not in wanted.components or _code(wanted.components[name]) != _code(now.components[name]))
    }
    systems = [now]
    if first:
        systems.append(without(now, first))
        yield
    there = systems[-1]
    moved = {
        name
        for name, one in there.components.items()
        if name in wanted.components and wanted.components[name].isolation != one.isolation
    }
    if moved:
        systems += _isolating(there, wanted, moved)
        yield
    found = Plan((), tuple(_kept(there, wanted, moved)))
    for before, after in pairwise((*systems, wanted)):
        one = yield from _Planner(before, after, limited).plan()
        found = Plan(found.steps + one.steps, found.refused + one.refused)
    return Plan((), found.refused) if found.refused else found


def _kept(now: Wanted, wanted: Wanted, moved: Set[str]) -> Iterator[str]:
    """The reasons why components cannot be moved to another process."""
    for name in sorted(moved):
        if now.components[name].type != wanted.components[name].type:
            yield f"{name}: its type and its isolation change; apply one after the other"
    for composite in now.composites.values():
        for name in sorted(moved & set(composite.members)):
            where = composite.name
            yield f"{name}: is a member of {where}, and its isolation changes; take it out of {where} first"


def _isolating(now: Wanted, wanted: Wanted, moved: Set[str]) -> Iterator[Wanted]:
    """The system with these components in no context, and then with each in the process in which it is wanted.

    A context runs where its members are, so neither system has a context whose members change their process.
    """
    contexts = {
        name: _less(one, moved)
        for name, one in now.contexts.items()
        if _is_apart(now, name) == _is_apart(wanted, name) or moved.isdisjoint(one.members)
    }
    apart = replace(now, contexts=MappingProxyType(contexts))
    yield apart
    components = {
        name: replace(one, isolation=wanted.components[name].isolation, limits=wanted.components[name].limits)
        if name in moved
        else one
        for name, one in now.components.items()
    }
    yield replace(apart, components=MappingProxyType(components))


def _is_apart(system: Wanted, context: str) -> bool:
    """Whether a context runs in the process of its isolated member."""
    members = system.contexts[context].members if context in system.contexts else ()
    return any(name in system.components and bool(system.components[name].isolation) for name in members)


def _code(one: ComponentEntry) -> tuple[str, str]:
    """The type and process of a component: a change of either makes another instance."""
    return one.type, one.isolation


def without(system: Wanted, names: Collection[str]) -> Wanted:
    """The system without these components, their connections and their memberships."""
    return replace(
        system,
        components=MappingProxyType({name: one for name, one in system.components.items() if name not in names}),
        connections=tuple(
            one for one in system.connections if not any(path.partition(".")[0] in names for path in one.ports)
        ),
        contexts=MappingProxyType({name: _less(one, names) for name, one in system.contexts.items()}),
        composites=MappingProxyType({name: _less(one, names) for name, one in system.composites.items()}),
    )


def _less(entry: E, names: Collection[str]) -> E:
    return replace(entry, members=tuple(name for name in entry.members if name not in names))


def connections_by_name(wanted: Wanted) -> dict[str, ConnectionEntry]:
    """The connections by the names that their connectors have."""
    found: dict[str, ConnectionEntry] = {}
    numbering = Numbering(found.__contains__)
    for one in wanted.connections:
        name = str(one.options.get("name") or f"{one.ports[0]}-{one.ports[1]}")
        found[numbering.lowest(f"{name}-", 2) if name in found else name] = one
    return found


class _Planner:
    """Compares two systems."""

    def __init__(self, now: Wanted, wanted: Wanted, limited: Collection[str]) -> None:
        self._limited = limited
        self._now = now
        self._wanted = wanted
        self._before: Mapping[str, ConnectionEntry] = {}
        self._after: Mapping[str, ConnectionEntry] = {}
        self._touched: set[str] = set()
        """Components that may have other ports afterwards."""

    def plan(self) -> Generator[None, None, Plan]:
        """Compare the systems, stepwise; returns the steps."""
        self._before = connections_by_name(self._now)
        yield
        self._after = connections_by_name(self._wanted)
        yield
        there = self._now.components
        for name, one in self._wanted.components.items():
            if name in there and _shape(there[name]) != _shape(one):
                self._touched.add(name)
        yield
        refused = tuple(self._refused())
        if refused:
            return Plan((), refused)
        now, wanted = self._now, self._wanted
        made = [one for name, one in wanted.components.items() if name not in now.components]
        gone = [one for name, one in now.components.items() if name not in wanted.components]
        started = [one for name, one in wanted.contexts.items() if name not in now.contexts]
        stopped = [one for name, one in now.contexts.items() if name not in wanted.contexts]
        yield
        connecting, changing, ending = self._connections()
        yield
        again = {one.connection.ports for one in connecting}
        taken = {path for one in connecting for path in one.connection.ports if path in self._limited}
        clearing = [
            one
            for one in ending
            if one.name in self._after
            or one.connection.ports in again
            or self._is_touched(one.connection)
            or not taken.isdisjoint(one.connection.ports)
        ]
        waiting = [one for one in connecting if self._is_touched(one.connection)]
        steps: list[Step] = [
            *clearing,
            *map(Create, made),
            *(one for one in connecting if one not in waiting),
            *(StartContext(replace(one, members=())) for one in started),
            *self._components(),
            *waiting,
            *changing,
            *self._contexts(),
            *self._move(),
            *self._activity(),
            *self._rules(),
            *(StopContext(replace(one, members=())) for one in reversed(stopped)),
            *(one for one in ending if one not in clearing),
            *map(Remove, reversed(gone)),
        ]
        return Plan(tuple(steps))

    def _refused(self) -> Iterator[str]:
        now, wanted = self._now, self._wanted
        if now.clock != wanted.clock:
            yield "the clock of a system that runs cannot be changed; stop it and run the file"
        for name in {**now.services, **wanted.services}:
            before, after = now.services.get(name), wanted.services.get(name)
            if name == "rules" and self._adds_rules():
                continue
            if before != after:
                what = "is added" if before is None else "is taken away" if after is None else "is changed"
                yield f"[{name}] {what}: the table of a service is read when a system starts; stop it and run the file"
        for name, new in wanted.components.items():
            old = now.components.get(name)
            if old is not None and old.isolation == new.isolation and old.limits != new.limits:
                yield f"{name}: the limits of a process that runs cannot be changed; take its isolation away first"
        for one, other, what in ((now, wanted, "composite"), (wanted, now, "component")):
            for name in one.components:
                if name in other.composites:
                    yield f"{name}: becomes a {what} of the same name; give it another one"

    def _adds_rules(self) -> bool:
        """Whether all present rules stay, in front of any new ones."""
        before, after = rules_of(self._now), rules_of(self._wanted)
        return after[: len(before)] == before

    def _rules(self) -> Iterator[Step]:
        before, after = rules_of(self._now), rules_of(self._wanted)
        if before != after:
            yield AddRules(before, after)

    # -- components ------------------------------------------------------------------------------------------------

    def _components(self) -> Iterator[Step]:
        for name, after in self._wanted.components.items():
            before = self._now.components.get(name)
            if before is None or before == after:
                continue
            if before.isolation != after.isolation:
                at = (one for one, joined in self._after.items() if name in _components_of(joined))
                yield Isolate(before, after, tuple(at))
                continue
            if before.type != after.type:
                yield Reload(before, after)
                continue
            if _shape(before) != _shape(after):
                shaped = replace(after, **{word: getattr(before, word) for word in CHANGED_BY_RULE})
                yield Configure(before, shaped)
                before = shaped
            if before != after:
                yield Supervise(before, after)

    # -- connections -----------------------------------------------------------------------------------------------

    def _connections(self) -> tuple[list[Connect], list[Step], list[Disconnect]]:
        before, after = self._before, self._after
        changing: list[Step] = []
        left = {name: one for name, one in before.items() if name not in after or after[name].ports != one.ports}
        connecting = []
        for name, one in after.items():
            old = before.get(name)
            if old is None or old.ports != one.ports:
                connecting.append(Connect(name, one))
            elif (made := without_identity(one.options)) != (was := without_identity(old.options)):
                words = [word for word in {**was, **made} if was.get(word, _ABSENT) != made.get(word, _ABSENT)]
                kind = Change if all(word in CHANGEABLE for word in words) and _in_place(old, one) else Renew
                changing.append(kind(name, old, one, USUAL_APART if self._is_linked(one) else _NOTHING))
        return connecting, changing, [Disconnect(name, one) for name, one in left.items()]

    def _is_linked(self, connection: ConnectionEntry) -> bool:
        """Whether an end of the connection is in another kernel or process."""
        there = self._wanted.components
        apart = any(name in there and bool(there[name].isolation) for name in _components_of(connection))
        return apart or any(map(names_kernel, connection.ports))

    def _is_touched(self, connection: ConnectionEntry) -> bool:
        return not self._touched.isdisjoint(_components_of(connection))

    # -- contexts --------------------------------------------------------------------------------------------------

    def _contexts(self) -> Iterator[Step]:
        for name, after in self._wanted.contexts.items():
            before = self._now.contexts.get(name)
            if before is None or (before.kind, before.options) == (after.kind, after.options):
                continue
            changed = replace(before, kind=after.kind, options=after.options)
            yield Retime(before, changed) if _is_rate_alone(before, after) else RenewContext(before, changed)

    def _activity(self) -> Iterator[Step]:
        for name, after in self._wanted.contexts.items():
            before = self._now.contexts.get(name)
            if before is not None and before.activate != after.activate:
                yield Activate(name, before.activate, after.activate)

    def _move(self) -> Iterator[Step]:
        before = {name: one.members for name, one in self._now.contexts.items()}
        after = {name: one.members for name, one in self._wanted.contexts.items()}
        contexts = [name for name in {**before, **after} if before.get(name, ()) != after.get(name, ())]
        groups = {**self._now.composites, **self._wanted.composites}
        composites = [name for name in groups if self._now.composites.get(name) != self._wanted.composites.get(name)]
        if contexts or composites:
            yield Move(
                Places(
                    MappingProxyType({name: before.get(name, ()) for name in contexts}),
                    MappingProxyType({name: self._now.composites.get(name) for name in composites}),
                ),
                Places(
                    MappingProxyType({name: after.get(name, ()) for name in contexts}),
                    MappingProxyType({name: self._wanted.composites.get(name) for name in composites}),
                ),
            )


def rules_of(system: Wanted) -> tuple[Mapping[str, Any], ...]:
    """The entries of `[[rules]]`."""
    return tuple(system.services.get("rules", {}).get("rules", ()))


def _shape(one: ComponentEntry) -> tuple[Any, ...]:
    """The entries of a component that its ports may depend on."""
    return one.type, one.params, one.sets, one.active


def _components_of(connection: ConnectionEntry) -> list[str]:
    """The components at the ends of a connection."""
    return [path.partition(".")[0] for path in connection.ports]


def _in_place(before: ConnectionEntry, after: ConnectionEntry) -> bool:
    """Whether a connector can be changed in place: a connector without a buffer is of another kind."""
    return has_buffer(before.options) is has_buffer(after.options)


def _is_rate_alone(before: ContextEntry, after: ContextEntry) -> bool:
    """Whether two contexts differ only in the rate; a context without a rate is of another kind."""
    rates = before.options.get("rate"), after.options.get("rate")
    others = [{**one.options, "rate": None} for one in (before, after)]
    return before.kind == after.kind and None not in rates and others[0] == others[1]
