"""Operations that write a kernel's system as a file, compare it with a wanted system, and change it into the latter."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias
from weakref import WeakKeyDictionary

from aiorts.clock import SimulatedClock
from aiorts.control.operation import Operation, Right, converters_read, is_code
from aiorts.control.session import Session
from aiorts.errors import DeniedError, StateError
from aiorts.kernel.loop.tasks import kernel_task
from aiorts.late import dataclass
from aiorts.model.wanted.applied import Applied
from aiorts.model.wanted.carried import received
from aiorts.model.wanted.entries import ComponentEntry, ConnectionEntry, ContextEntry
from aiorts.model.wanted.steps import Places
from aiorts.model.wanted.system_text import Saved
from aiorts.sessions import Made

if TYPE_CHECKING:
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.model.wanted.entries import Wanted
    from aiorts.model.wanted.plan import Plan

_Entry: TypeAlias = (
    ComponentEntry | ConnectionEntry | ContextEntry | Places | tuple[Mapping[str, Any], ...] | bool | None
)
"""The value that a step changes, before or after the step."""
_DECIDED: Final = 120.0
"""Seconds that a change waits for the decision, while other kernels make their changes; then it is undone."""
_open: Final[WeakKeyDictionary[Session, tuple[asyncio.Future[str], asyncio.Task[Applied]]]] = WeakKeyDictionary()
"""The undecided change of each session: the future of the decision, and the task."""


@dataclass(frozen=True, slots=True)
class Target:
    """A wanted system."""

    wanted: tuple[str, ...]
    """The text that `aiorts.model.wanted.carried` makes of the system, in parts: a text may have 65,536 characters."""


@dataclass(frozen=True, slots=True)
class Application:
    """A wanted system to apply to the running one."""

    wanted: tuple[str, ...]
    """As in `Target`."""
    window: float = 0.0
    """Seconds of the kernel's clock for which the old and new systems are measured; a worse one is taken back."""


@dataclass(frozen=True, slots=True)
class Decision:
    """The decision about a change."""

    keep: bool
    """Whether the change is kept; False: it is taken back."""


@dataclass(frozen=True, slots=True)
class PlannedStep:
    """One step of a plan: its kind and its subject; `aiorts.model.wanted.steps` has all kinds."""

    step: str
    """The kind of step."""
    sign: Literal["+", "-", "~"]
    """"+": the subject comes, "-": it goes, "~": it changes."""
    text: str
    """The step in one line."""
    name: str = ""
    """The name of the connector."""
    component: ComponentEntry | None = None
    connection: ConnectionEntry | None = None
    context: ContextEntry | str | None = None
    before: _Entry = None
    """The changed value before the step."""
    after: _Entry = None
    """The changed value after the step."""


@dataclass(frozen=True, slots=True)
class Planned:
    """The steps from the running system to the wanted one."""

    steps: tuple[PlannedStep, ...]
    """The steps in order."""
    refused: tuple[str, ...]
    """The differences that cannot be changed while the system runs."""


@dataclass(frozen=True, slots=True)
class Changed:
    """The outcome of a plan."""

    steps: tuple[PlannedStep, ...]
    """As in `Planned`."""
    refused: tuple[str, ...]
    """Always empty."""
    done: bool
    """Whether the system is the wanted one now."""
    rolled_back: str
    """The reason, such as a worse figure, for which the change was taken back; "" when it was kept."""
    notes: tuple[str, ...]
    """The points in which the result differs from the plan, or from its reverse."""


@dataclass(frozen=True, slots=True)
class Place:
    """The place of the file that will be written."""

    folder: str
    """The folder of the file: files and plugins below it are named by their path from there."""


class _Answer(Made):
    """A plan or its outcome, made plain in the thread that sends it: a long plan would hold up the loop."""

    __slots__ = ("_value",)

    def __init__(self, value: Plan | Applied) -> None:
        self._value = value

    def message(self) -> Any:
        return self._value.to_plain()


def _plan(session: Session, given: Target) -> _Answer | Awaitable[_Answer]:
    from aiorts.planning import Planning  # late: few ask for it

    planning = session.kernel.service(Planning)
    if isinstance(session.kernel.clock, SimulatedClock):
        return _Answer(planning.plan(_read(given.wanted)))  # a task would be one more that is ready at this instant

    async def plan() -> _Answer:
        return _Answer(await planning.plan_aside(await _read_aside(given.wanted)))

    return plan()


async def _apply(session: Session, given: Application) -> _Answer:
    from aiorts.planning import Planning

    async def agreed(plan: Plan) -> str:
        session.operates(_changed(session.kernel, plan))  # not at the end: the change goes on after the session's end
        return ""

    wanted, planning = await _allowed(session, given.wanted), session.kernel.service(Planning)
    return _Answer(await planning.apply(wanted, dry_run=False, window=given.window, agreed=agreed))


async def _change(session: Session, given: Target) -> _Answer:
    from aiorts.planning import Planning

    kernel = session.kernel
    loop, simulated = kernel.loop, isinstance(kernel.clock, SimulatedClock)
    made: asyncio.Future[Plan] = loop.create_future()
    decided: asyncio.Future[str] = loop.create_future()

    async def agreed(plan: Plan) -> str:
        if not made.done():
            made.set_result(plan)
        try:
            async with asyncio.timeout(None if simulated else _DECIDED):
                why = await decided
        except TimeoutError:
            return f"nothing was decided within {_DECIDED:g} s"
        if not why:
            session.operates(_changed(kernel, plan))
        return why

    wanted = await _allowed(session, given.wanted)
    applying = kernel.service(Planning).apply(wanted, dry_run=False, window=0.0, agreed=agreed)
    changing = kernel_task(loop, applying, "aiorts change")
    changing.add_done_callback(_observed)
    session.keep(partial(_settle, decided, "who wanted it has gone"))
    first: tuple[asyncio.Future[Any], ...] = changing, made
    await asyncio.wait(first, return_when=asyncio.FIRST_COMPLETED)
    if not changing.done():
        _open[session] = decided, changing
    return _Answer(changing.result() if changing.done() else Applied(made.result(), done=False))


async def _decide(session: Session, given: Decision) -> _Answer:
    decided, changing = _open.pop(session, (None, None))
    if decided is None or changing is None:
        raise StateError("decide: nothing is changed in this session")
    _settle(decided, "" if given.keep else "not wanted any more")
    return _Answer(await asyncio.shield(changing))


def _changed(kernel: Microkernel, plan: Plan) -> Iterator[str]:
    """The components that a plan has changed: the client that applied it is now their operator."""
    from aiorts.model.wanted.steps import Activate, Configure, Create, Isolate, Move, Reload, RenewContext, Supervise

    for step in plan.steps:
        if isinstance(step, Create):
            yield step.component.name
        elif isinstance(step, Configure | Isolate | Reload | Supervise):
            yield step.after.name
        elif isinstance(step, Activate | RenewContext):
            context = step.context if isinstance(step, Activate) else step.after.name
            yield from (one.name for one in kernel.contexts[context].members)
        elif isinstance(step, Move):
            yield from _come(step.before, step.after)


def _come(before: Places, after: Places) -> Iterator[str]:
    """The components that join contexts and composites, and new composites."""
    for name, members in after.contexts.items():
        yield from set(members) - set(before.contexts.get(name, ()))
    for name, composite in after.composites.items():
        was = before.composites.get(name)
        if composite is not None:
            come = [name] if was is None else set(composite.members) - set(was.members)
            yield from (member.rpartition("/")[2] for member in come)


def _save(session: Session, given: Place) -> Saved | Awaitable[Saved]:
    from aiorts.planning import Planning  # late: few ask for it

    planning, folder = session.kernel.service(Planning), Path(given.folder)
    if isinstance(session.kernel.clock, SimulatedClock):
        return planning.text(folder)  # a task would be one more that is ready at this instant
    return planning.text_aside(folder)


def _settle(decided: asyncio.Future[str], why: str) -> None:
    if not decided.done():
        decided.set_result(why)


def _observed(task: asyncio.Task[Applied]) -> None:
    if not task.cancelled():
        task.exception()  # retrieved here, since the caller may be gone


async def _allowed(session: Session, parts: tuple[str, ...]) -> Wanted:
    """Read the wanted system.

    DeniedError: the system needs code that the kernel neither runs nor offers, and the session lacks the right "code".
    """
    kernel = session.kernel
    wanted = _read(parts) if isinstance(kernel.clock, SimulatedClock) else await _read_aside(parts)
    if not session.right.allows(Right.CODE):
        from aiorts.planning import wanted_of

        strange = sorted(set(_code_of(wanted)) - set(_code_of(wanted_of(kernel, []))))
        if strange:
            raise DeniedError(
                f"{strange[0]}: needs the right 'code'; with {session.right.value!r} a system has types that this "
                "kernel runs, or that an installed package offers it by a name"
            )
    return wanted


def _code_of(wanted: Wanted) -> Iterator[str]:
    """The sources of code of a system that no package offers by a name: types, plugin paths, converters."""
    yield from (one.type for one in wanted.components.values() if is_code(one.type))
    yield from map(str, wanted.plugin_paths)
    for one in wanted.connections:
        yield from converters_read(one.options)


def _read(parts: tuple[str, ...]) -> Wanted:
    return received("".join(parts))


async def _read_aside(parts: tuple[str, ...]) -> Wanted:
    from anyio import to_thread

    return await to_thread.run_sync(_read, parts)


ROWS: Final = (
    Operation("apply", "Change the system that runs into a wanted one.", Application, Changed, Right.OPERATE, _apply),
    Operation(
        "change",
        "Change the system that runs into a wanted one, until this session decides.",
        Target,
        Changed,
        Right.OPERATE,
        _change,
    ),
    Operation("decide", "Keep what was changed, or take it back.", Decision, Changed, Right.OPERATE, _decide),
    Operation(
        "plan",
        "The steps from the system that runs to a wanted one.",
        Target,
        Planned,
        Right.VIEW,
        _plan,
        idempotent=True,
    ),
    Operation("save", "The system as the text of a system file.", Place, Saved, Right.VIEW, _save, idempotent=True),
)
