"""What a composite given in place of a component stands for; nothing here changes anything."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, TypeGuard

from aiorts.errors import StateError

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.composed import Composed
    from aiorts.kernel.context import Context
    from aiorts.kernel.member import Member
    from aiorts.model.lifecycle import LifeCycleState

__all__ = ("check_free", "composed", "is_composite", "members_in", "unfolded")


def is_composite(component: Component) -> TypeGuard[Composed]:
    """Whether it stands for others."""
    return component._rt_composes


def composed(components: Sequence[Component]) -> bool:
    """Whether one of these is a composite."""
    return any(component._rt_composes for component in components)


def unfolded(components: Sequence[Component]) -> tuple[Component, ...]:
    """The components that run, composites replaced by their parts."""
    if not composed(components):
        return tuple(components)
    return tuple(part for component in components for part in component._rt_unfold())


def members_in(context: Context, components: Sequence[Component], state: LifeCycleState) -> list[Member]:
    """The members that are meant: those named, and of a composite those that are in `state`."""
    members = []
    for component in components:
        those = [context._member(part) for part in component._rt_unfold()]
        members += [one for one in those if one.state is state] if component._rt_composes else those
    return members


def check_free(components: Sequence[Component], what: str) -> None:
    """Raise StateError when one is a member of a composite, which alone says where it runs."""
    for component in components:
        outer = component._rt_composite
        if outer is not None and outer._rt_holds and not outer._rt_runs_apart(component):
            raise StateError(
                f"{component.name}: cannot {what}: it is a member of {outer.name}; "
                f"await {outer.name}.remove_members({component.name!r}) first"
            )
