"""What a client names, looked up in a kernel: components and contexts; what is not there is told with what is."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, Final

from aiorts.errors import AbsentError
from aiorts.spelling import nearest

if TYPE_CHECKING:
    from aiorts.control.session import Session
    from aiorts.kernel.component import Component
    from aiorts.kernel.execution.context import Context

_SHOWN: Final = 10


def component_named(session: Session, name: str) -> Component:
    """The component; AbsentError where there is none."""
    known = session.kernel.components
    if name not in known:
        raise absent(f"{name:.80}: no such component", name, known)
    return known[name]


def context_named(session: Session, name: str) -> Context:
    """The context, which runs; AbsentError where there is none."""
    known = session.kernel.contexts
    if name not in known:
        raise absent(f"{name:.80}: no such context", name, known)
    return known[name]


def whose(given: Any, _: object) -> tuple[str]:
    """The component that the arguments of a call name: it is changed by the call."""
    return (given.component,)


def absent(what: str, name: str, known: Iterable[str]) -> AbsentError:
    """The error for a name that is not among the known ones."""
    there = list(known)
    near = nearest(name, there)
    rest = ", ..." if len(there) > _SHOWN else ""
    hint = f"did you mean {near}?" if near else f"there are {', '.join(there[:_SHOWN]) or 'none'}{rest}"
    return AbsentError(f"{what}; {hint}")
