"""Components and contexts of a kernel, found by the name that a client gives; an error names near ones."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from aiorts.errors import AbsentError
from aiorts.spelling import suggestion

if TYPE_CHECKING:
    from aiorts.control.session import Session
    from aiorts.kernel.component import Component
    from aiorts.kernel.execution.context import Context


def component_named(session: Session, name: str) -> Component:
    """Find a component by its name; AbsentError where there is none."""
    known = session.kernel.components
    if name not in known:
        raise absent(f"{name:.80}: no such component", name, known)
    return known[name]


def context_named(session: Session, name: str) -> Context:
    """Find a running context by its name; AbsentError where there is none."""
    known = session.kernel.contexts
    if name not in known:
        raise absent(f"{name:.80}: no such context", name, known)
    return known[name]


def whose(given: Any, _: object) -> tuple[str]:
    """The component that a call changes: the one in its arguments."""
    return (given.component,)


def absent(what: str, name: str, known: Iterable[str]) -> AbsentError:
    """The error for a name that is not among the known ones."""
    return AbsentError(f"{what}; {suggestion(name, known, shown=str)}")
