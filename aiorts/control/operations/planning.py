"""The operations that compare a kernel's system with a wanted one, and make that of it."""

from __future__ import annotations

from collections.abc import Awaitable, Mapping
from typing import TYPE_CHECKING, Any, Final

from aiorts.clock import SimulatedClock
from aiorts.control.operation import Operation, Right
from aiorts.control.protocol import Made
from aiorts.control.session import Session
from aiorts.late import dataclass
from aiorts.model.wanted.carried import received

if TYPE_CHECKING:
    from aiorts.model.wanted.applied import Applied
    from aiorts.model.wanted.entries import Wanted
    from aiorts.model.wanted.plan import Plan


@dataclass(frozen=True, slots=True)
class Target:
    """A system that is wanted."""

    wanted: tuple[str, ...]
    """The text that `aiorts.model.wanted.carried` makes of it, in parts: a text may have 65,536 characters."""


@dataclass(frozen=True, slots=True)
class Application:
    """A system that is to be made of the one that runs."""

    wanted: tuple[str, ...]
    """As in a plan."""
    window: float = 0.0
    """Seconds of the kernel's clock for which it is measured, before and after; it must not do worse."""


@dataclass(frozen=True, slots=True)
class Planned:
    """The steps that make a wanted system of the one that runs."""

    steps: tuple[Mapping[str, Any], ...]
    """In order: `step` is the kind, `sign` + for what comes and - for what goes, `text` what it does, in one line."""
    refused: tuple[str, ...]
    """What differs and cannot be changed while a system runs."""


@dataclass(frozen=True, slots=True)
class Changed:
    """What has become of a plan."""

    steps: tuple[Mapping[str, Any], ...]
    """As in a plan."""
    refused: tuple[str, ...]
    """Empty."""
    done: bool
    """Whether the system is the wanted one now."""
    rolled_back: str
    """The figure that the system was taken back for; "" when it was kept."""
    notes: tuple[str, ...]
    """What could not be as the plan, or its reverse, says."""


class _Answer(Made):
    """A plan, or what has become of it: long ones are made plain beside the loop."""

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

    kernel = session.kernel
    simulated = isinstance(kernel.clock, SimulatedClock)
    wanted = _read(given.wanted) if simulated else await _read_aside(given.wanted)
    return _Answer(await kernel.service(Planning).apply(wanted, dry_run=False, window=given.window))


def _read(parts: tuple[str, ...]) -> Wanted:
    return received("".join(parts))


async def _read_aside(parts: tuple[str, ...]) -> Wanted:
    from anyio import to_thread

    return await to_thread.run_sync(_read, parts)


ROWS: Final = (
    Operation("apply", "Change the system that runs into a wanted one.", Application, Changed, Right.CODE, _apply),
    Operation(
        "plan",
        "The steps from the system that runs to a wanted one.",
        Target,
        Planned,
        Right.VIEW,
        _plan,
        idempotent=True,
    ),
)
