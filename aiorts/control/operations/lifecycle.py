"""Operations on lifecycles, on membership in a composite of another kernel, and on the run as a whole."""

from __future__ import annotations

import os
import sys
from collections.abc import Awaitable, Callable
from typing import Final

from aiorts.control.operation import Operation, Right
from aiorts.control.operations.known import component_named, whose
from aiorts.control.session import Session
from aiorts.control.values import Done, Member, Stop
from aiorts.errors import StateError
from aiorts.kernel.execution.cell import cell
from aiorts.kernel.microkernel import Microkernel
from aiorts.late import dataclass
from aiorts.model.values import shown


@dataclass(frozen=True, slots=True)
class Holding:
    """A component, and the composite of another kernel that has it as a member."""

    component: str
    holder: str


def _requesting(request: Callable[..., Awaitable[None]]) -> Callable[[Session, Member], Awaitable[Done]]:
    """Make the operation that requests a transition of a component."""

    async def run(session: Session, given: Member) -> Done:
        await request(session.kernel, given.component, context=given.context, timeout=given.timeout)
        return Done()

    return run


def _hold(session: Session, given: Holding) -> Done:
    component = component_named(session, given.component)
    here, group = cell(component), cell(component).group
    held = group.name if group is not None else here.held_for
    if held:
        raise StateError(f"{component.name}: is a member of {held} already")
    here.held_for = given.holder

    def let_go() -> None:
        here.held_for = ""

    session.keep(let_go)
    return Done()


def _stop(session: Session, given: Stop) -> Done:
    kernel = session.kernel
    if not kernel.request_stop(given.status):
        program = shown(" ".join(sys.argv)) if sys.argv else "an interpreter"
        raise StateError(
            f"{kernel.address or kernel.name}: is part of another program, which does not wait for "
            f"`Kernel.wait_stop_requested()`: end the program itself, process {os.getpid()} ({program}), with SIGTERM "
            "or in its own way"
        )
    return Done()


_REQUESTS: Final = (
    ("activate", "Activate a component.", Microkernel.activate),
    ("deactivate", "Deactivate a component.", Microkernel.deactivate),
    ("reset", "Take a component out of error.", Microkernel.reset),
)
ROWS: Final = (
    *(
        Operation(name, text, Member, Done, Right.OPERATE, _requesting(request), changes=whose)
        for name, text, request in _REQUESTS
    ),
    Operation(
        "hold",
        "Have a component as a member of a composite of another kernel, as long as the session lasts.",
        Holding,
        Done,
        Right.OPERATE,
        _hold,
    ),
    Operation("stop", "End the run in order.", Stop, Done, Right.OPERATE, _stop, idempotent=True),
)
