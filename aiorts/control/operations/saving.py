"""The operation that describes a kernel's system as a system file."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from aiorts.control.operation import Operation, Right
from aiorts.control.session import Session
from aiorts.late import dataclass


@dataclass(frozen=True, slots=True)
class Place:
    """Where the file is going to lie."""

    folder: str
    """Files and plugins below it are named as counted from there."""


@dataclass(frozen=True, slots=True)
class Text:
    """A system as the text of a system file."""

    text: str
    notes: tuple[str, ...] = ()
    """What of the system no system file can say, and is not in the text."""


def _save(session: Session, given: Place) -> Text:
    from aiorts.planning import Planning  # late: few ask for it

    saved = session.kernel.service(Planning).text(Path(given.folder))
    return Text(saved.text, saved.notes)


ROWS: Final = (
    Operation("save", "The system as the text of a system file.", Place, Text, Right.VIEW, _save, idempotent=True),
)
