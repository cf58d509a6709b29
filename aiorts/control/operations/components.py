"""Operations on whole components: create, remove, make members of composites."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from typing import TYPE_CHECKING, Any, Final

from aiorts.control.operation import Operation, Right, is_code
from aiorts.control.operations.known import component_named, context_named
from aiorts.control.session import Session
from aiorts.control.values import Done
from aiorts.errors import AiortsError, ComponentError, StateError, UnknownTypeError, format_error
from aiorts.kernel.extensions.catalogue import AbsentExtension
from aiorts.late import dataclass
from aiorts.model.plain import empty

if TYPE_CHECKING:
    from aiorts.composites import Composite


@dataclass(frozen=True, slots=True)
class Creation:
    """A component to create."""

    type: str
    """A name that a plugin offers; or, with the right code, "FILE.py:Class" or "package.module:Class"."""
    name: str = ""
    """The name of the component; by default made from the type's name."""
    params: Mapping[str, Any] = field(default_factory=empty)
    """Values of parameters; a text is read by the parameter's type."""
    context: str | None = None
    """The context that the component joins."""
    activate: bool = False
    timeout: float | None = 5.0
    """Seconds of the kernel's clock for joining and for activation; None waits without limit."""


@dataclass(frozen=True, slots=True)
class Removal:
    """Components to remove."""

    components: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Membership:
    """Members of a composite."""

    composite: str
    members: tuple[str, ...]
    timeout: float | None = 5.0
    """Seconds of the kernel's clock; None waits without limit."""


async def _create(session: Session, given: Creation) -> Done:
    kernel = session.kernel
    if given.activate and given.context is None:
        raise StateError(f"{given.name or given.type}: nothing is activated outside of a context; say which context")
    context = None if given.context is None else context_named(session, given.context)
    try:
        component = await kernel.create(given.type, given.name, **given.params)
    except AbsentExtension as error:  # the client gave this name, so it is an unknown type, not a faulty file
        raise UnknownTypeError(str(error)) from error
    except AiortsError:
        raise
    except Exception as error:  # raised by a user's on_initialize
        raise ComponentError(f"{given.name or given.type}: on_initialize raised {format_error(error)}") from error
    if context is not None:
        try:
            await context.add(component, timeout=given.timeout)
        except BaseException:
            await kernel.remove(component)
            raise
        if given.activate:
            await kernel.activate(component, context=context, timeout=given.timeout)
    return Done(component.name)


async def _remove(session: Session, given: Removal) -> Done:
    found = [component_named(session, name) for name in given.components]
    for one in found:
        await session.kernel.remove(one)
    return Done()


async def _add_members(session: Session, given: Membership) -> Done:
    composite, members = _composite(session, given)
    await composite.add_members(*members, timeout=given.timeout)
    return Done()


async def _remove_members(session: Session, given: Membership) -> Done:
    composite, members = _composite(session, given)
    await composite.remove_members(*members, timeout=given.timeout)
    return Done()


def _composite(session: Session, given: Membership) -> tuple[Composite, list[Any]]:
    from aiorts.composites import Composite  # late: most systems have none

    found = component_named(session, given.composite)
    if not isinstance(found, Composite):
        raise StateError(f"{given.composite}: is no composite but a {type(found).__name__}")
    return found, [component_named(session, name) for name in given.members]


def _needed(given: Creation) -> Right:
    return Right.CODE if is_code(given.type) else Right.OPERATE


def _made(given: Creation, done: Done | None) -> tuple[str]:
    return (given.name if done is None else done.text,)


ROWS: Final = (
    Operation("add_members", "Make components members of a composite.", Membership, Done, Right.OPERATE, _add_members),
    Operation("create", "Create a component.", Creation, Done, Right.OPERATE, _create, demands=_needed, changes=_made),
    Operation("remove", "Remove components.", Removal, Done, Right.OPERATE, _remove),
    Operation("remove_members", "Take members out of a composite.", Membership, Done, Right.OPERATE, _remove_members),
)
