"""Changes who runs where: the members of contexts and composites, each context's between the same two cycles.

A switch starts from the present system, not from what a step says of it: a second time it does nothing, and the
reverse step takes back also half of a switch.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from aiorts.composites import Composite, group_of, outer_of, parts_of
from aiorts.errors import ComponentError, StateError, format_error
from aiorts.kernel.execution.cell import cell, flattened
from aiorts.model.lifecycle import LifecycleState
from aiorts.model.wanted.entries import said_keys
from aiorts.model.wanted.steps import Move, Places

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.execution.context import Context
    from aiorts.kernel.execution.cycle import Done, Steps
    from aiorts.kernel.execution.member import Member
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.model.wanted.entries import CompositeEntry


def tops(context: Context) -> list[Component]:
    """The members of a context in order, a composite in the place of those that run with it."""
    found: dict[Component, None] = {}
    for member in context.runner.members:
        component: Any = member.component
        outer = outer_of(component)
        root = None if outer is None else outer.root.component
        found[root if root is not None and context in root.contexts else component] = None
    return list(found)


class CompositesAside:
    """Composites that are out of their kernel.

    Args:
        keeps: whether a composite that goes is kept for its return; else it is removed.
    """

    def __init__(self, *, keeps: bool) -> None:
        self.keeps = keeps
        self._kept: dict[str, Composite] = {}

    async def take_out(self, composite: Component) -> None:
        """Take a composite out of its kernel; its members stay there."""
        group = group_of(composite)
        if not self.keeps or group is None or not isinstance(composite, Composite):
            await composite.kernel.remove(composite)
            return
        await group.dissolve()
        composite.kernel.registry.park(composite)
        self._kept[composite.name] = composite

    def take_back(self, name: str) -> Composite | None:
        """Put the kept composite of this name into its kernel again, without members; None where there is none."""
        composite = None if self.keeps else self._kept.pop(name, None)
        if composite is not None:
            composite.kernel.registry.unpark(composite)
        return composite

    async def end(self) -> None:
        """End the kept composites."""
        kept, self._kept = self._kept, {}
        for composite in kept.values():
            await composite.kernel.registry.end_parked(composite)


async def switch(
    kernel: Microkernel, after: Places, activates: Callable[[str, Any], bool], aside: CompositesAside | None = None
) -> None:
    """Put components, contexts and composites into these places.

    Args:
        activates: whether a component that comes into a context of this name is to be active there.
        aside: takes the composites that go; without `aside` they are removed.

    Raises:
        AiortsError: what a component, a context or a composite refuses, or a hook raised; some of it may be done.
    """
    with _keeping_connectors(kernel):
        await _switch(kernel, after, activates, aside or CompositesAside(keeps=False))


@contextmanager
def _keeping_connectors(kernel: Microkernel) -> Iterator[None]:
    """A context manager in which connectors stay although a composite no longer exports their port; steps end them."""
    groups = [group for one in kernel.components.values() if (group := group_of(one)) is not None]
    before = [dict(group.known) for group in groups]
    for group in groups:
        group.known = {port: frozenset(port.connectors) for port in group.known}
    try:
        yield
    finally:
        for group, known in zip(groups, before, strict=True):
            group.known.update({port: those for port, those in known.items() if port in group.known})


async def _switch(
    kernel: Microkernel, after: Places, activates: Callable[[str, Any], bool], aside: CompositesAside
) -> None:
    composites = kernel.components
    anew = [name for name, one in after.composites.items() if _is_made_anew(composites.get(name), one)]
    for context_name, members in after.contexts.items():
        context = kernel.contexts.get(context_name)
        if context is not None:
            gone = [one for one in tops(context) if isinstance(one, Composite) and _goes(one, members, anew)]
            if gone:
                await context.remove(*gone)
    for name in _outer_first(kernel, anew):
        _forget_placements(composites[name])
        await aside.take_out(composites[name])
    for name, entry in _inner_first(after.composites):
        composite = composites.get(name) or aside.take_back(name)
        if not isinstance(composite, Composite):
            await kernel.add(Composite(entry.name, *entry.members, **said_keys(entry)))
        else:
            _forget_placements(composite)
            await _change(composite, entry)
        _forget_placements(composites[name])
    alone = {one for name, line in after.contexts.items() if _is_alone(kernel.contexts.get(name)) for one in line}
    for context_name, members in after.contexts.items():
        context = kernel.contexts.get(context_name)
        if context is not None:
            leaving = [one for one in tops(context) if one.name not in members]
            if first := [one for one in leaving if _is_alone(context) or one.name in alone]:
                await context.remove(*first)  # who runs in a thread of its own is in no other, not for a moment
    for context_name, members in after.contexts.items():
        context = kernel.contexts.get(context_name)
        if context is not None:
            await _fill(context, [composites[name] for name in members], activates)
    for context_name, members in after.contexts.items():
        if members and context_name not in kernel.contexts:
            raise StateError(f"{context_name}: was stopped meanwhile; {', '.join(members)}: cannot run there")


def _is_alone(context: Context | None) -> bool:
    return context is not None and context.exclusive


def _forget_placements(component: Component) -> None:
    """Forget where members ran before: a component that leaves a composite goes where the plan says."""
    for part in parts_of(component):
        cell(part).previous_placements = ()


def _goes(composite: Composite, members: Sequence[str], anew: Sequence[str]) -> bool:
    return composite.name not in members or composite.name in anew


def _is_made_anew(there: Component | None, entry: CompositeEntry | None) -> bool:
    """Whether an existing composite has to go, at least for a moment."""
    if not isinstance(there, Composite):
        return False
    if entry is None:
        return True
    return (there.errors, there.own_schedule) != (entry.errors, entry.own_schedule)


def _outer_first(kernel: Microkernel, names: Iterable[str]) -> list[str]:
    def depth(name: str) -> int:
        group, found = outer_of(kernel.components[name]), 0
        while group is not None:
            group, found = group.outer, found + 1
        return found

    return sorted(names, key=depth)


def _inner_first(entries: Mapping[str, CompositeEntry | None]) -> list[tuple[str, CompositeEntry]]:
    """The composites, each after the composites that are its members."""
    left = {name: one for name, one in entries.items() if one is not None}
    found: list[tuple[str, CompositeEntry]] = []
    while left:
        for name, one in tuple(left.items()):
            if not any(member in left for member in one.members):
                found.append((name, left.pop(name)))
    return found


async def _change(composite: Composite, entry: CompositeEntry) -> None:
    group = group_of(composite)
    shown = {} if group is None else {rule.pattern: rule.name for rule in group.exports}
    await composite.change(
        members=entry.members,
        exported=None if entry.exported == shown else entry.exported,
        order=entry.order,
        groups=entry.groups,
    )


async def _fill(context: Context, wanted: list[Component], activates: Callable[[str, Any], bool]) -> None:
    """Fill a context with these members, in this order; single components come and go in one moment."""
    whole = [one for one in wanted if isinstance(one, Composite) and context not in one.contexts]
    if whole:
        await context.add(*whole)
    there = tops(context)
    single = [one for one in wanted if one not in there and not isinstance(one, Composite)]
    leaving = [one for one in there if one not in wanted]
    line: Any = flattened(wanted)
    if single or leaving or tuple(context.members) != line:
        for one in single:
            context.runner.check_may_join(one)
        switch = _Switch(context, [context.runner.new_member(one) for one in single], leaving, line, activates)
        await context.runner.ask([(f"switch {context.name}", switch.steps)], 5.0)
    for composite in whole:
        _forget_placements(composite)
        if activates(context.name, composite):
            await composite.activate()


class _Switch:
    """Members that come and go between two cycles of a context."""

    def __init__(
        self,
        context: Context,
        joining: Sequence[Member],
        leaving: Sequence[Component],
        line: Sequence[Component],
        activates: Callable[[str, Any], bool],
    ) -> None:
        self._context = context
        self._joining = joining
        self._leaving = leaving
        self._line = line
        self._activates = activates

    def steps(self, done: Done) -> Steps:
        """The steps, as one action; a component that cannot start is taken out again, and no member leaves."""
        context, life = self._context, self._context.runner.life
        joined: list[Member] = []
        for member in self._joining:
            joined.append(member)
            yield from life.add(member)
            if member.failure is not None:
                for other in reversed(joined):
                    yield from life.remove(other)
                done(_failed(member, "on_startup", member.failure))
                return
        for component in reversed(self._leaving):
            for member in tuple(cell(component).members):
                if member.context is context:
                    yield from life.remove(member)
        context.runner.arrange(self._line)
        failed: ComponentError | None = None
        for member in joined:
            if self._activates(context.name, member.component) and member.state is LifecycleState.INACTIVE:
                error = yield from life.activate(member)
                if error is not None and failed is None:
                    failed = _failed(member, "on_activated", error)
        done(failed)


def _failed(member: Any, hook: str, error: BaseException) -> ComponentError:
    failed = ComponentError(f"{member.component.name}: {hook} in {member.context.name} failed: {format_error(error)}")
    failed.__cause__ = error
    return failed


def without_components(move: Move, names: Collection[str]) -> Move:
    """The change without the components of these names."""

    def less(members: Iterable[str]) -> tuple[str, ...]:
        return tuple(name for name in members if name not in names)

    def entry(one: CompositeEntry | None) -> CompositeEntry | None:
        if one is None:
            return None
        exported = {rule: name for rule, name in one.exported.items() if rule.partition(".")[0] not in names}
        groups = tuple(filter(None, map(less, one.groups)))
        return replace(one, members=less(one.members), exported=exported, groups=groups)

    def places(one: Places) -> Places:
        return Places(
            {name: less(line) for name, line in one.contexts.items()},
            {name: entry(composite) for name, composite in one.composites.items()},
        )

    return replace(move, before=places(move.before), after=places(move.after))
