"""The operation that describes a kernel's system as a system file."""

from __future__ import annotations

from collections.abc import Awaitable
from pathlib import Path
from typing import Final

from aiorts.clock import SimulatedClock
from aiorts.control.operation import Operation, Right
from aiorts.control.session import Session
from aiorts.late import dataclass
from aiorts.model.wanted.system_text import Saved


@dataclass(frozen=True, slots=True)
class Place:
    """Where the file is going to lie."""

    folder: str
    """Files and plugins below it are named as counted from there."""


def _save(session: Session, given: Place) -> Saved | Awaitable[Saved]:
    from aiorts.planning import Planning  # late: few ask for it

    planning, folder = session.kernel.service(Planning), Path(given.folder)
    if isinstance(session.kernel.clock, SimulatedClock):
        return planning.text(folder)  # a task would be one more that is ready at this instant
    return planning.text_aside(folder)


ROWS: Final = (
    Operation("save", "The system as the text of a system file.", Place, Saved, Right.VIEW, _save, idempotent=True),
)
