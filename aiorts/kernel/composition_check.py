"""Everything that says no to a composite or to a change of it, before anything is changed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from aiorts.errors import DeclarationError, StateError, WiringError
from aiorts.model.composition import groups_of

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.composed import Composed
    from aiorts.kernel.kernel import Kernel
    from aiorts.model.composition import Export

__all__ = ("check", "check_startable", "grouped", "resolved")


def resolved(kernel: Kernel, composite: Composed, given: Sequence[Component | str]) -> tuple[Component, ...]:
    """The components that are meant. StateError when names are unknown (all of them are told), or one stands twice."""
    there = kernel.components
    for one in given:
        if not isinstance(one, str) and getattr(one, "_rt_host", None) is None:
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


def check(composite: Composed, members: Sequence[Component], rules: Sequence[Export] | None) -> None:
    """Raise StateError or WiringError when the composite cannot have these members and exports."""
    for member in members:
        if member in composite._rt_direct:
            continue
        _check_joins(composite, member)
    if rules is not None:
        _check_rules(composite, rules, members)
    composite._rt_check_ports(composite._rt_exports(members, rules))


def grouped(
    composite: Composed, members: Sequence[Component], groups: str | Sequence[Sequence[str]] | None
) -> tuple[tuple[str, ...], ...]:
    """The groups it is to have; None keeps those it has, without who is no member any more.

    Raises:
        ConfigurationError: a group names nobody, or a member is in none.
    """
    names = [member.name for member in members]
    if groups is None:
        kept = [[name for name in group if name in names] for group in composite._rt_groups]
        groups = [group for group in kept if group]
    return groups_of(groups, names, composite.name)


def _check_joins(composite: Composed, member: Component) -> None:
    composite.kernel._roster.check_settled(member)
    if member._rt_composite is not None:
        raise StateError(
            f"{member.name}: is a member of {member._rt_composite.name} already, and cannot join {composite.name}; "
            f"await {member._rt_composite.name}.remove_members({member.name!r}) first"
        )
    outer: Composed | None = composite
    while outer is not None:
        if outer is member:
            raise StateError(f"{member.name}: would be a member of itself, by way of {composite.name}")
        outer = outer._rt_composite
    if member._rt_composes and member.contexts and not composite._rt_runs_apart(member):
        raise StateError(
            f"{member.name}: runs in {member.contexts[0].name}; remove it from there, or give it own_schedule=True"
        )


def _check_rules(composite: Composed, rules: Sequence[Export], members: Sequence[Component]) -> None:
    there = [f"{member.name}.{port}" for member in members for port in member.ports]
    for rule in rules:
        if rule.literal and rule.pattern not in there:
            raise WiringError(
                f"{composite.name}: exported {rule.pattern!r}: no such port of a member; "
                f"there are {', '.join(there) or 'none'}"
            )


def check_startable(components: Sequence[Component]) -> None:
    """Raise StateError when one of these composites runs already."""
    for component in components:
        if component.contexts:
            raise StateError(f"{component.name}: runs in {component.contexts[0].name} already")
