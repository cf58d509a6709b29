"""Operations on execution contexts: start, stop, change rate and members."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from typing import Any, Final

from aiorts.control.operation import Nothing, Operation, Right
from aiorts.control.operations.known import absent, component_named, context_named
from aiorts.control.session import Session
from aiorts.control.values import Done
from aiorts.errors import ConfigurationError, StateError
from aiorts.kernel.execution.context import Context
from aiorts.late import dataclass
from aiorts.model.plain import empty
from aiorts.model.values import convert_value
from aiorts.observe import ContextReport

_ORDER: Final = (bool, int, float, str)
"""The order in which the possible types of an option are tried for a text."""


@dataclass(frozen=True, slots=True)
class Start:
    """A context to start."""

    name: str
    """The name of the context; with "" the kernel chooses a name."""
    kind: str = "periodic"
    members: tuple[str, ...] = ()
    """Components, in order of execution."""
    options: Mapping[str, Any] = field(default_factory=empty)
    """The options of the kind: rate, deadline, ...; a text is read by the option's type."""
    activate: bool = False
    timeout: float | None = 5.0
    """Seconds of the kernel's clock; None waits without limit."""


@dataclass(frozen=True, slots=True)
class Which:
    """A context."""

    context: str


@dataclass(frozen=True, slots=True)
class Rate:
    """A new rate for a context."""

    context: str
    rate: float
    """Hz."""
    timeout: float | None = 5.0
    """Seconds of the kernel's clock; None waits without limit."""


@dataclass(frozen=True, slots=True)
class Joining:
    """Components that join or leave a context."""

    context: str
    members: tuple[str, ...]
    activate: bool = False
    """Whether joining components are activated, too."""
    timeout: float | None = 5.0
    """Seconds of the kernel's clock; None waits without limit."""


def _contexts(session: Session, _: Nothing) -> dict[str, ContextReport]:
    from aiorts.observe import context_report

    return {name: context_report(one) for name, one in session.kernel.contexts.items()}


async def _start(session: Session, given: Start) -> Done:
    from aiorts.kernel.extensions.arguments import settings_faults, settings_of
    from aiorts.kernel.extensions.loading import load_aside

    kernel = session.kernel
    offers = kernel.plugins.extensions("contexts")
    if given.kind not in offers:
        raise absent(f"{given.kind!r:.80}: no such kind of context", given.kind, offers)
    members = [component_named(session, name) for name in given.members]
    cls = await load_aside(kernel.plugins.find("contexts", given.kind), kernel.clock, Context)
    options = {name: _read(cls, name, value) for name, value in given.options.items()}
    faults = [f"{key}: {what}" if key else what for key, what, _ in settings_faults(cls, options)]
    if faults:
        raise ConfigurationError("\n".join(f"{given.name or given.kind}: {fault}" for fault in faults))
    context = settings_of(cls, {**options, **({"name": given.name} if given.name else {})})
    await kernel.start(context, *members, activate=given.activate, timeout=given.timeout)
    return Done(context.name)


def _read(cls: type, name: str, value: Any) -> Any:
    """Read an option's text by its type; a text that fits no type stays, and is refused with the other faults."""
    from aiorts.kernel.extensions.arguments import arguments_of

    kinds = arguments_of(cls).get(name, (str,))
    for kind in (one for one in _ORDER if isinstance(value, str) and one in kinds):
        try:
            return convert_value(value, kind)
        except (TypeError, ValueError):
            continue
    return value


async def _stop(session: Session, given: Which) -> Done:
    await session.kernel.stop(context_named(session, given.context))
    return Done()


async def _set_rate(session: Session, given: Rate) -> Done:
    context: Any = context_named(session, given.context)
    if not hasattr(context, "set_rate"):
        raise StateError(f"{given.context}: a context of kind {context.kind} has no rate")
    await context.set_rate(given.rate, timeout=given.timeout)
    return Done()


async def _join(session: Session, given: Joining) -> Done:
    context = context_named(session, given.context)
    members = [component_named(session, name) for name in given.members]
    await context.add(*members, timeout=given.timeout)
    if given.activate:
        await context.activate(*members, timeout=given.timeout)
    return Done()


async def _leave(session: Session, given: Joining) -> Done:
    context = context_named(session, given.context)
    await context.remove(*(component_named(session, name) for name in given.members), timeout=given.timeout)
    return Done()


def _members(given: Start | Joining, _: Done | None) -> tuple[str, ...]:
    return given.members


ROWS: Final = (
    Operation(
        "contexts", "Execution contexts.", Nothing, dict[str, ContextReport], Right.VIEW, _contexts, idempotent=True
    ),
    Operation("join_context", "Have components join a context.", Joining, Done, Right.OPERATE, _join, changes=_members),
    Operation("leave_context", "Have components leave a context.", Joining, Done, Right.OPERATE, _leave),
    Operation("set_rate", "Change the rate of a context.", Rate, Done, Right.OPERATE, _set_rate, idempotent=True),
    Operation("start_context", "Start a context.", Start, Done, Right.OPERATE, _start, changes=_members),
    Operation("stop_context", "Stop a context.", Which, Done, Right.OPERATE, _stop),
)
