"""Who knows a component by more than its name, and is to know another instance in its place from now on."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, cast

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.composed import Composed
    from aiorts.kernel.context import Context
    from aiorts.kernel.kernel import Kernel

__all__ = ("pass_on_distant_references", "pass_on_references")


def pass_on_references(kernel: Kernel, old: Component, new: Component) -> None:
    """The kernel's books, composites, supervision, and those that a machine tells. On the loop, between two cycles."""
    roster = kernel._roster
    roster.components[new.name] = new  # in its place: the order is that of creation
    roster._kinds[type(new)] += 1
    roster._kinds[type(old)] -= 1
    if not roster._kinds[type(old)]:
        del roster._kinds[type(old)]
    supervisor = kernel._supervisor
    one = None if supervisor is None else supervisor.supervised.get(new.name)
    if one is not None and one.component is old:
        one.component = new
        one._factory = _makes(one._factory, type(old), type(new))
    composite = new._rt_composite
    if composite is not None:
        _in_composite(composite, old, new)
    for member in new._rt_members:
        _in_sections(member.context, old, new)


def pass_on_distant_references(kernel: Kernel, pairs: Mapping[Component, Component]) -> None:
    """Those that only a look at every component finds, for all of a context at once."""
    machines = "aiorts.kernel.machine" in sys.modules
    for component in kernel.components.values():
        if component._rt_homes:
            component._rt_homes = tuple(
                replace(home, behind=_all_renewed(home.behind, pairs)) for home in component._rt_homes
            )
        machine: Any = getattr(component, "machine", None) if machines else None
        participants = getattr(machine, "_participants", None)
        if participants and not pairs.keys().isdisjoint(participants):
            machine._participants = _all_renewed(participants, pairs)


def _makes(factory: Any, old: type[Component], new: type[Component]) -> Any:
    """The factory with the new class in the place of the old one: that class itself, or a `partial` over it."""
    if isinstance(factory, type):
        return new if (factory.__module__, factory.__qualname__) == (old.__module__, old.__qualname__) else factory
    if type(factory) is not partial:
        return factory
    words = {name: _makes(word, old, new) for name, word in factory.keywords.items()}
    return partial(_makes(factory.func, old, new), *(_makes(word, old, new) for word in factory.args), **words)


def _renewed(those: Iterable[Component], old: Component, new: Component) -> tuple[Component, ...]:
    return tuple(new if one is old else one for one in those)


def _all_renewed(those: Iterable[Component], pairs: Mapping[Component, Component]) -> tuple[Component, ...]:
    return tuple(pairs.get(one, one) for one in those)


def _in_composite(composite: Composed, old: Component, new: Component) -> None:
    composite._rt_direct = _renewed(composite._rt_direct, old, new)
    composite._rt_laid_out = _renewed(composite._rt_laid_out, old, new)
    given = cast("tuple[Component, ...]", composite._rt_given)  # or names, which stay
    composite._rt_given = _renewed(given, old, new)


def _in_sections(context: Context, old: Component, new: Component) -> None:
    if context._sections:
        context._sections = tuple(
            tuple(_renewed(group, old, new) for group in section) for section in context._sections
        )
