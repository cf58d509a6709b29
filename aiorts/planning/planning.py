"""The service that describes a kernel's system as it would have to be wanted, and saves it."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from aiorts.kernel.service import KernelService
from aiorts.model.wanted.system_text import Saved, system_text

if TYPE_CHECKING:
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.model.wanted.entries import ClockEntry


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
        return self._read(folder)()

    async def text_aside(self, folder: Path) -> Saved:
        """The same; the text is written in a thread, so that the loop is held for the reading alone."""
        from anyio import to_thread

        return await to_thread.run_sync(self._read(folder))

    async def save(self, path: str | os.PathLike[str], *, overwrite: bool) -> tuple[str, ...]:
        """See `Kernel.save`."""
        from anyio import to_thread

        from aiorts.configuration import replace_text

        saved = await self.text_aside(_folder_of(path))
        await to_thread.run_sync(lambda: replace_text(Path(path), saved.text, overwrite=overwrite))
        return saved.notes

    def _read(self, folder: Path) -> Callable[[], Saved]:
        """The system of this moment, as a function that writes it."""
        from aiorts.planning.reading import wanted_of

        notes: list[str] = []
        wanted = wanted_of(self.kernel, notes)
        return lambda: Saved(system_text(wanted, Path(os.path.realpath(folder)), notes), tuple(notes))


def _folder_of(path: str | os.PathLike[str]) -> Path:
    return Path(os.path.abspath(path)).parent
