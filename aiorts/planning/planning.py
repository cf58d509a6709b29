"""The service that describes a kernel's system as it would have to be wanted, and saves it."""

from __future__ import annotations

import asyncio
import math
import os
from collections.abc import Callable, Collection
from pathlib import Path
from typing import TYPE_CHECKING

from aiorts.errors import ApplyError, BusyError, ClosedError, ConfigurationError, StateError, format_error
from aiorts.health import Health
from aiorts.kernel.loop.tasks import current_task, kernel_task, owner_of
from aiorts.kernel.service import KernelService
from aiorts.model.health.verdict import verdict
from aiorts.model.wanted.applied import Applied
from aiorts.model.wanted.plan import Plan, plan
from aiorts.model.wanted.system_text import Saved, system_text

if TYPE_CHECKING:
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.model.health.verdict import Unhealthy
    from aiorts.model.health.windows import Window
    from aiorts.model.wanted.entries import ClockEntry, Wanted
    from aiorts.planning.applying import Application


class Planning(KernelService):
    """The wanted system of one kernel."""

    def __init__(self, kernel: Microkernel) -> None:
        super().__init__(kernel)
        self.clock: ClockEntry | None = None
        """What the system file said of the clock, whatever the command line said; None where there was no file."""
        self.health = Health(kernel)
        """What the windows of `apply` are measured by."""
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
        if isinstance(window, bool) or not isinstance(window, int | float) or not 0 <= window < math.inf:
            raise ConfigurationError(f"apply: window = {window!r}: expected seconds, 0 or more")
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
        task = kernel_task(kernel.loop, self._apply(Application(kernel, now, wanted, planned), window), "aiorts apply")
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

    async def _apply(self, application: Application, window: float) -> Applied:
        async with self.kernel.registry.renewal:
            await application.load()
            before = await self.health.before(window) if window else None
            try:
                await application.forth()
            except BaseException as error:
                await self._take_back(application, error)
                raise
            application.release()
            worse = None if before is None else await self._worse(before, window, application.new)
            left = () if worse is None else tuple(await application.back())
            application.release()
            await application.settle()
            return Applied(application.plan, worse is None, str(worse or ""), left)

    async def _worse(self, before: Window, window: float, new: Collection[str]) -> Unhealthy | None:
        """What the system does worse than before; None when the kernel closes meanwhile: it stays as it is."""
        try:
            return verdict(before, await self.health.window(window), new)
        except ClosedError:
            return None

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
