"""Checks a composite, or a change of it, before anything is changed."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, cast

from aiorts.composites.composition import groups_of
from aiorts.errors import DeclarationError, StateError, WiringError
from aiorts.kernel.execution.apart import check_apart
from aiorts.kernel.execution.cell import cell, has_cell

if TYPE_CHECKING:
    from aiorts.composites.composition import Export
    from aiorts.composites.group import CompositeGroup
    from aiorts.kernel.component import Component
    from aiorts.kernel.execution.cell import ComponentSide
    from aiorts.kernel.microkernel import Microkernel


def group_of(component: ComponentSide) -> CompositeGroup | None:
    """The group of a composite; None for a component that is no composite."""
    return cast("CompositeGroup | None", cell(component).stands_for)


def outer_of(component: ComponentSide) -> CompositeGroup | None:
    """The group of the composite that a component is a member of."""
    return cast("CompositeGroup | None", cell(component).group)


def parts_of(component: Component) -> tuple[Component, ...]:
    """The components that run when this component is started: itself, or the parts of a composite."""
    group = group_of(component)
    return (component,) if group is None else group.parts


def leaves_of(components: Iterable[Component]) -> tuple[Component, ...]:
    """These components, with each composite replaced by its members, even those with a schedule of their own."""
    found: list[Component] = []
    for component in components:
        group = group_of(component)
        found += (component,) if group is None else leaves_of(group.members)
    return tuple(found)


def resolved(kernel: Microkernel, composite: CompositeGroup, given: Sequence[Component | str]) -> tuple[Component, ...]:
    """The components for these names. StateError when names are unknown (all are named), or one is given twice."""
    there = kernel.components
    for one in given:
        if not isinstance(one, str) and not has_cell(one):
            raise DeclarationError(f"{composite.name}: expected components or their names, got {one!r:.80}")
    unknown = [one for one in given if isinstance(one, str) and one not in there]
    if unknown:
        raise StateError(
            f"{composite.name}: no component {', '.join(map(repr, unknown))}; there are {', '.join(there) or 'none'}"
        )
    members = tuple(there[one] if isinstance(one, str) else one for one in given)
    names = [member.name for member in members]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise StateError(f"{composite.name}: {', '.join(twice)} given twice")
    for member in members:
        if there.get(member.name) is not member:
            raise StateError(f"{member.name}: does not belong to {kernel.name}; await kernel.add(...) first")
    return members


def check(composite: CompositeGroup, members: Sequence[Component], rules: Sequence[Export] | None) -> None:
    """Raise StateError or WiringError when the composite cannot have these members and exports."""
    for member in members:
        if member in composite.members:
            continue
        _check_joins(composite, member)
    beside = [part for part in composite.root.parts if part not in composite.parts]
    check_apart(composite.line(members), beside, composite.root.name)
    if rules is not None:
        _check_rules(composite, rules, members)
    composite.check_ports(composite.ports_of(members, rules))


def grouped(
    composite: CompositeGroup, members: Sequence[Component], groups: str | Sequence[Sequence[str]] | None
) -> tuple[tuple[str, ...], ...]:
    """The requested groups; None keeps the present ones, without former members.

    Raises:
        ConfigurationError: a group names a component that is no member, or a member is in no group.
    """
    names = [member.name for member in members]
    if groups is None:
        kept = [[name for name in group if name in names] for group in composite.groups]
        groups = [group for group in kept if group]
    return groups_of(groups, names, composite.name)


def _check_joins(composite: CompositeGroup, member: Component) -> None:
    composite.kernel.registry.check_settled(member)
    if (other := cell(member).group) is not None:
        raise StateError(
            f"{member.name}: is a member of {other.name} already, and cannot join {composite.name}; "
            f"await {other.name}.remove_members({member.name!r}) first"
        )
    if holder := cell(member).held_for:
        raise StateError(f"{member.name}: is a member of {holder} already, and cannot join {composite.name}")
    outer: CompositeGroup | None = composite
    while outer is not None:
        if outer.component is member:
            raise StateError(f"{member.name}: would be a member of itself, by way of {composite.name}")
        outer = outer.outer
    if group_of(member) is not None and member.contexts and not composite.runs_apart(member):
        raise StateError(
            f"{member.name}: runs in {member.contexts[0].name}; remove it from there, or give it own_schedule=True"
        )


def _check_rules(composite: CompositeGroup, rules: Sequence[Export], members: Sequence[Component]) -> None:
    there = [f"{member.name}.{port}" for member in members for port in member.ports]
    for rule in rules:
        if rule.literal and rule.pattern not in there:
            far = next((path for one, path in composite.brought.items() if one.name == rule.component), "")
            raise WiringError(
                f"{composite.name}: exported {rule.pattern!r}: no such {'data ' * bool(far)}port of a member; "
                f"there are {', '.join(there) or 'none'}"
                + (f"; a service of {far} is not exported, connect with {far}.{rule.port} itself" if far else "")
            )
