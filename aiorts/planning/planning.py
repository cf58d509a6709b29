"""The service that reads a kernel's system into `Wanted`, saves the system, and changes it into a wanted one."""

from __future__ import annotations

import asyncio
import math
import os
from collections.abc import Awaitable, Callable, Generator, Iterator
from contextlib import ExitStack, contextmanager
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from aiorts.clock import SimulatedClock
from aiorts.errors import ApplyError, BusyError, ClosedError, ConfigurationError, StateError, format_error
from aiorts.health import Health
from aiorts.kernel.loop.tasks import current_task, kernel_task, owner_of
from aiorts.kernel.loop.turns import in_turns
from aiorts.kernel.service import KernelService
from aiorts.model.health.verdict import verdict
from aiorts.model.wanted.applied import Applied
from aiorts.model.wanted.plan import Plan, planning
from aiorts.model.wanted.stepwise import finished
from aiorts.model.wanted.system_text import Saved, system_text
from aiorts.planning.canon import as_it_stands, without_isolation, without_provenance
from aiorts.supervision import Supervising

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.kernel.ports import Port
    from aiorts.model.health.verdict import Unhealthy
    from aiorts.model.health.windows import Window
    from aiorts.model.wanted.entries import ClockEntry, Wanted
    from aiorts.planning.applying import Application

_TRIES: Final = 3
"""How often the read of a changing system, with turns of the loop in between, is tried."""

_LATE: Final = ("aiorts.reload", "aiorts.supervision", "aiorts.planning.applying", "aiorts.planning.reading")
"""The modules that `apply` needs besides: imported late and one by one, so that the loop has its turns in between."""


class Planning(KernelService):
    """The wanted system of one kernel."""

    def __init__(self, kernel: Microkernel) -> None:
        super().__init__(kernel)
        self.clock: ClockEntry | None = None
        """The clock of the system file, whatever the command line chose; None where there was no file."""
        self.exclusive: dict[str, bool] = {}
        """Components that a plan ends before anything is made, as system files say."""
        self.health = Health(kernel)
        """The measuring of the windows of `apply`."""
        self._applying: asyncio.Task[Applied] | None = None
        self._measuring = False
        """Whether a window before a change is being measured."""

    def text(self, folder: Path) -> Saved:
        """The system at this moment, as a system file in this folder.

        Raises:
            SystemFileError: names all that no system file can say.
        """
        from aiorts.planning.reading import wanted_of

        notes: list[str] = []
        return _saved(wanted_of(self.kernel, notes), folder, notes)

    async def text_aside(self, folder: Path) -> Saved:
        """The text as `text` gives it; the loop has its turns meanwhile, and a thread writes the text."""
        from anyio import to_thread

        notes: list[str] = []
        wanted = await self._wanted(notes)
        return await to_thread.run_sync(_saved, wanted, folder, notes)

    async def save(self, path: str | os.PathLike[str], *, overwrite: bool) -> tuple[str, ...]:
        """See `Kernel.save`."""
        from anyio import to_thread

        from aiorts.configuration import replace_text

        saved = await self.text_aside(_folder_of(path))
        await to_thread.run_sync(lambda: replace_text(Path(path), saved.text, overwrite=overwrite))
        return saved.notes

    def plan(self, wanted: Wanted) -> Plan:
        """The plan that changes the running system into this one; see `Kernel.apply`."""
        from aiorts.planning.reading import wanted_of

        return finished(self._planning(wanted_of(self.kernel), wanted))

    async def plan_aside(self, wanted: Wanted) -> Plan:
        """The plan as `plan` gives it; the loop has its turns meanwhile."""
        return await self._plan(await self._wanted([]), wanted)

    async def apply(
        self, wanted: Wanted, *, dry_run: bool, window: float, agreed: Callable[[Plan], Awaitable[str]] | None = None
    ) -> Applied:
        """See `Kernel.apply`.

        Args:
            agreed: awaited when all is done; gives the reason to take the change back, or "" to keep it.
        """
        kernel = self.kernel
        if isinstance(window, bool) or not isinstance(window, int | float) or not 0 <= window < math.inf:
            raise ConfigurationError(f"apply: window = {window!r}: expected seconds, 0 or more")
        if self._applying is not None:
            raise BusyError(f"{kernel.name}: another plan is applied, or its window has not ended; wait for that")
        if owner_of(current_task()) is not None or any(one.runner.inside() for one in kernel.contexts.values()):
            raise StateError(
                "apply: called by a hook, or a task, of a component, which it would wait for; call it from outside"
            )
        if dry_run:
            return Applied(await self.plan_aside(wanted), done=False)
        task = kernel_task(kernel.loop, self._apply(wanted, window, agreed), "aiorts apply")
        self._applying = task
        renewing = kernel.registry.renewing
        renewing.add(task)
        task.add_done_callback(renewing.discard)
        task.add_done_callback(self._ended)
        try:
            return await asyncio.shield(task)
        except asyncio.CancelledError:
            if self._measuring:
                task.cancel()
            raise

    def parks(self, component: Component) -> bool:
        """Whether a component that a plan takes out is kept whole for its return."""
        return type(component).parks and component.name not in self.exclusive

    @contextmanager
    def services_wait(self) -> Iterator[None]:
        """A context manager in which services that connect by themselves wait; they look for ports afterwards."""
        try:
            with ExitStack() as making:
                for service in self.kernel.services:
                    making.enter_context(service.making())
                yield
        finally:
            for service in self.kernel.services:
                service.started()

    def _planning(self, now: Wanted, wanted: Wanted) -> Generator[None, None, Plan]:
        now, wanted = (without_provenance(one, self.kernel.plugins) for one in (now, wanted))
        if isinstance(self.kernel.clock, SimulatedClock):  # there all components run in this process
            wanted = without_isolation(wanted)
        wanted = as_it_stands(now, wanted, self.kernel)
        components = self.kernel.components.values()
        limited = {port.path for one in components for port in one.ports.values() if _is_limited(port)}
        yield
        first = {
            one.name
            for one in components
            if not self.parks(one) or (type(one).max_instance is not None and one.name not in wanted.components)
        }
        return (yield from planning(now, wanted, limited, first))

    def _ended(self, task: asyncio.Task[Applied]) -> None:
        self._applying = None
        if not task.cancelled():
            task.exception()  # its caller may have been cancelled

    async def _apply(self, wanted: Wanted, window: float, agreed: Callable[[Plan], Awaitable[str]] | None) -> Applied:
        for name in _LATE:
            import_module(name)
            await asyncio.sleep(0)
        async with self.kernel.registry.renewal:
            before = await self._before(wanted, window) if window else None
            with ExitStack() as making:
                making.enter_context(self.services_wait())

                async def why(application: Application) -> str:
                    worse = None if before is None else await self._worse(before, window, application)
                    return str(worse or "") or ("" if agreed is None else await agreed(application.plan))

                return await self._carried_out(wanted, why, making)

    async def _before(self, wanted: Wanted, window: float) -> Window | None:
        """The window of counts before the change; the kernel is read after it, so that the plan fits the system."""
        planned = await self._plan(await self._wanted([]), wanted)
        if planned.refused or planned.empty:
            return None
        self._measuring = True
        try:
            return await self.health.before(window)
        finally:
            self._measuring = False

    async def _carried_out(
        self, wanted: Wanted, why: Callable[[Application], Awaitable[str]], making: ExitStack
    ) -> Applied:
        from aiorts.planning.applying import Application

        now = await self._wanted([])
        planned = await self._plan(now, wanted)
        if planned.refused:
            raise StateError("\n".join(planned.refused))
        if planned.empty:
            return Applied(planned)
        application = Application(self, now, wanted, planned)
        await application.load()
        try:
            await application.forth()
        except BaseException as error:
            await self._take_back(application, error)
            raise
        application.release()
        making.close()
        refused = await why(application)
        left = tuple(await application.back()) if refused else ()
        application.release()
        await application.settle()
        return Applied(application.plan, not refused, refused, left)

    async def _worse(self, before: Window, window: float, application: Application) -> Unhealthy | None:
        """The finding that the system does worse than before; None if it does not, or the kernel closes meanwhile."""
        try:
            return verdict(before, await self.health.window(window), application.new, application.ended)
        except ClosedError:
            return None

    async def _take_back(self, application: Application, error: BaseException) -> None:
        """Take the change back and raise ApplyError: what failed, and what could not be taken back."""
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

    async def _wanted(self, notes: list[str]) -> Wanted:
        """The system of one moment; where nothing of it changes meanwhile, the loop has its turns."""
        from aiorts.planning.reading import reading, wanted_of

        bus, supervising = self.kernel.bus, self.kernel.attached(Supervising)
        for _ in range(_TRIES if self._takes_turns else 0):
            if supervising is not None:
                await supervising.settle()  # who is between two instances is not gone
            before, notes[:] = bus.sequence, []
            found = await in_turns(reading(self.kernel, notes))
            if bus.sequence == before:
                return found
        if supervising is not None:
            await supervising.settle()
        notes[:] = []
        return wanted_of(self.kernel, notes)

    async def _plan(self, now: Wanted, wanted: Wanted) -> Plan:
        steps = self._planning(now, wanted)
        return await in_turns(steps) if self._takes_turns else finished(steps)

    @property
    def _takes_turns(self) -> bool:
        """Whether work gives the loop its turns: not on a simulated clock, where each run must be the same."""
        return not isinstance(self.kernel.clock, SimulatedClock)


def _saved(wanted: Wanted, folder: Path, notes: list[str]) -> Saved:
    return Saved(system_text(wanted, Path(os.path.realpath(folder)), notes), tuple(notes))


def _folder_of(path: str | os.PathLike[str]) -> Path:
    return Path(os.path.abspath(path)).parent


def _is_limited(port: Port[Any]) -> bool:
    """Whether a connector of this port must go before another can come."""
    ends = getattr(port, "interfaces", ())
    return port.max_connectors is not None or any(one.polarity == "required" and not one.many for one in ends)
