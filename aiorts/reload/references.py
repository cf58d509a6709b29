"""Passes on the references to a component to the instance that takes its place."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from aiorts.kernel.declarations import kinds_of
from aiorts.kernel.execution.cell import cell

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.microkernel import Microkernel


def pass_on_references(kernel: Microkernel, old: Component, new: Component) -> None:
    """Pass on the references of kernel, composites, supervision and observers. On the loop, between two cycles."""
    kernel.registry.replace(old, new)
    group = cell(new).group
    if group is not None:
        group.member_replaced(old, new)


def pass_on_distant_references(kernel: Microkernel, pairs: Mapping[Component, Component]) -> None:
    """Pass on references that are found only by searching every component, for all instances of a context at once."""
    for component in kernel.components.values():
        for kind in kinds_of(component):
            kind.others_replaced(component, pairs)
