"""The service that describes a kernel's system as it would have to be wanted, and saves it."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from aiorts.errors import ApplyError, BusyError, StateError, format_error
from aiorts.kernel.loop.tasks import current_task, kernel_task, owner_of
from aiorts.kernel.service import KernelService
from aiorts.model.wanted.applied import Applied
from aiorts.model.wanted.plan import Plan, plan
from aiorts.model.wanted.system_text import Saved, system_text

if TYPE_CHECKING:
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.model.wanted.entries import ClockEntry, Wanted
    from aiorts.planning.applying import Application


class Planning(KernelService):
    """The wanted system of one kernel."""

    def __init__(self, kernel: Microkernel) -> None:
        super().__init__(kernel)
        self.clock: ClockEntry | None = None
        """What the system file said of the clock, whatever the command line said; None where there was no file."""
        self._applying: asyncio.Task[Applied] | None = None

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

    def plan(self, wanted: Wanted) -> Plan:
        """What would be done to make this system of the one that runs; see `Kernel.apply`."""
        from aiorts.planning.reading import wanted_of

        return self._planned(wanted_of(self.kernel), wanted)

    async def apply(self, wanted: Wanted, *, dry_run: bool, window: float) -> Applied:
        """See `Kernel.apply`."""
        from aiorts.planning.applying import Application
        from aiorts.planning.reading import wanted_of

        kernel = self.kernel
        if self._applying is not None:
            raise BusyError(f"{kernel.name}: another plan is applied, or its window has not ended; wait for that")
        if owner_of(current_task()) is not None or any(one.runner.inside() for one in kernel.contexts.values()):
            raise StateError(
                "apply: called by a hook, or a task, of a component, which it would wait for; call it from outside"
            )
        now = wanted_of(kernel)
        planned = self._planned(now, wanted)
        if dry_run:
            return Applied(planned, done=False)
        if planned.refused:
            raise StateError("\n".join(planned.refused))
        if planned.empty:
            return Applied(planned)
        task = kernel_task(kernel.loop, self._apply(Application(kernel, now, wanted, planned)), "aiorts apply")
        self._applying = task
        renewing = kernel.registry.renewing
        renewing.add(task)
        task.add_done_callback(renewing.discard)
        task.add_done_callback(self._ended)
        return await asyncio.shield(task)

    def _planned(self, now: Wanted, wanted: Wanted) -> Plan:
        components = self.kernel.components.values()
        limited = {port.path for one in components for port in one.ports.values() if port.max_connectors is not None}
        return plan(now, wanted, limited=limited, exclusive={one.name for one in components if not type(one).parks})

    def _ended(self, task: asyncio.Task[Applied]) -> None:
        self._applying = None
        if not task.cancelled():
            task.exception()  # its caller may have been cancelled

    async def _apply(self, application: Application) -> Applied:
        async with self.kernel.registry.renewal:
            await application.load()
            try:
                await application.forth()
            except BaseException as error:
                await self._take_back(application, error)
                raise
            application.release()
            await application.settle()
            return Applied(application.plan)

    async def _take_back(self, application: Application, error: BaseException) -> None:
        """ApplyError: says what failed, and what of it could not be taken back."""
        failed = application.failed_step
        left = () if self.kernel.closed else tuple(await application.back())
        application.release()
        await application.settle()
        if self.kernel.closed:
            return
        what = "all of it was taken back" if not left else "this could not be taken back: " + "; ".join(left)
        refused = ApplyError(f"{failed}: {format_error(error)}; {what}")
        refused.not_undone = left
        raise refused from error

    def _read(self, folder: Path) -> Callable[[], Saved]:
        """The system of this moment, as a function that writes it."""
        from aiorts.planning.reading import wanted_of

        notes: list[str] = []
        wanted = wanted_of(self.kernel, notes)
        return lambda: Saved(system_text(wanted, Path(os.path.realpath(folder)), notes), tuple(notes))


def _folder_of(path: str | os.PathLike[str]) -> Path:
    return Path(os.path.abspath(path)).parent
