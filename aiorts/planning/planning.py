"""The service that describes a kernel's system as it would have to be wanted, and saves it."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from aiorts.kernel.service import KernelService
from aiorts.late import dataclass

if TYPE_CHECKING:
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.model.wanted.entries import ClockEntry


@dataclass(frozen=True, slots=True)
class Saved:
    """A system as the text of a system file."""

    text: str
    notes: tuple[str, ...] = ()
    """What of the system no system file can say, and is not in the text."""


class Planning(KernelService):
    """The wanted system of one kernel."""

    def __init__(self, kernel: Microkernel) -> None:
        super().__init__(kernel)
        self.clock: ClockEntry | None = None
        """What the system file said of the clock, whatever the command line said; None where there was no file."""

    def text(self, folder: Path) -> Saved:
        """The system at this moment, as a system file in this folder.

        Raises:
            SystemFileError: names all that no system file can say.
        """
        from aiorts.model.wanted.system_text import system_text
        from aiorts.planning.reading import wanted_of

        notes: list[str] = []
        text = system_text(wanted_of(self.kernel, notes), Path(os.path.realpath(folder)), notes)
        return Saved(text, tuple(notes))

    async def save(self, path: str | os.PathLike[str], *, overwrite: bool) -> tuple[str, ...]:
        """See `Kernel.save`."""
        from anyio import to_thread

        from aiorts.configuration import replace_text

        saved = self.text(_folder_of(path))
        await to_thread.run_sync(lambda: replace_text(Path(path), saved.text, overwrite=overwrite))
        return saved.notes


def _folder_of(path: str | os.PathLike[str]) -> Path:
    return Path(os.path.abspath(path)).parent
