"""New instances in the places of old ones on trial: then the new ones settle there, or the old ones come back."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable
from contextlib import nullcontext
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from aiorts.errors import AiortsError
from aiorts.kernel.execution.cell import cell
from aiorts.kernel.execution.cycle import Action, Call
from aiorts.kernel.loop.bus import HookFailed
from aiorts.kernel.loop.guarded import KernelLog
from aiorts.kernel.loop.tasks import kernel_task
from aiorts.reload.replacement import Replacement, retire
from aiorts.reload.swap import Group, Swap

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.execution.cycle import Steps
    from aiorts.kernel.execution.member import Member
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.model.configuration.sets import ConfigurationState
    from aiorts.reload.fresh_code import Code
    from aiorts.reload.reload_events import ComponentReloaded

_LOG = KernelLog()
_GOING_BACK: Final = 10.0
"""Seconds that are waited until the old instances of a context are in their places again."""


class Trial:
    """A trial: new instances next to the old ones, and then in their places.

    Args:
        timeout: seconds of the kernel's clock until each is made, and until all are in their places; None is forever.
    """

    def __init__(self, kernel: Microkernel, timeout: float | None) -> None:
        self._kernel = kernel
        self._timeout = timeout
        self.swap = Swap(kernel, timeout)
        self._unsubscribe: Callable[[], None] | None = None

    async def prepare(
        self, old: Component, code: Code, edit: Callable[[ConfigurationState], ConfigurationState] | None = None
    ) -> None:
        """Make a new instance next to an old one, which goes on.

        Args:
            edit: makes the new configuration from the declared one; by default the old one's is taken over.

        Raises:
            PluginError: the new instance cannot be made; says why, with file and line.
        """
        replacement = Replacement(self._kernel, old, code, edit)
        self.swap.replacements.append(replacement)
        await replacement.prepare(self._timeout)

    async def switch(self) -> None:
        """Put every new instance in its place, between two cycles of its context; what fails is raised."""
        self._unsubscribe = self._kernel.bus.subscribe(HookFailed, self._look)
        replacements = self.swap.replacements
        composed = any(cell(replacement.old).group is not None for replacement in replacements)
        async with self._kernel.registry.composing if composed else nullcontext():
            await self.swap.switch()

    def left_out(self) -> tuple[str, ...]:
        """The connectors at ports that the new instances do not have: they end when these settle."""
        return tuple(
            connector.name for one in self.swap.replacements for port in one.gone for connector in port.connectors
        )

    def end_watch(self) -> None:
        """From now on a hook that fails is the component's own affair; nothing is taken back for it."""
        if self._unsubscribe is not None:
            self._unsubscribe()
            self._unsubscribe = None

    async def settle(self) -> tuple[ComponentReloaded, ...]:
        """Keep the new instances: the ports that have gone lose their connectors, and the old instances are ended."""
        self.end_watch()
        events = []
        for replacement in self.swap.replacements:
            if (event := replacement.settle()) is not None:
                events.append(event)
            await asyncio.sleep(0)  # many of them must not hold the loop for long
        for replacement in self.swap.replacements:
            await retire(self._kernel, replacement.old, replacement.new)
        return tuple(events)

    def _look(self, event: HookFailed) -> None:
        """Handle a failed hook: one of a new instance takes everything back before the failure has other effects."""
        if self.swap.failure is not None:
            return
        for replacement in self.swap.replacements:
            if replacement.switched and self._kernel.components.get(event.component) is replacement.new:
                if event.hook == "task" and not event.context and cell(replacement.new).members:
                    return  # one of the old instance's, which is being ended
                self.swap.fail(self.swap.blamed(replacement, event.hook, event.error))
                return

    # -- as it was -------------------------------------------------------------------------------------------------

    async def take_back(self, error: BaseException) -> None:
        """Put every old instance back and end the new ones; notes at `error` what came of that."""
        kernel = self._kernel
        self.end_watch()
        if self.swap.failure is None:
            self.swap.failure = error
            self.swap.regroup()
        self.swap.go_back()
        for group in self.swap.groups:
            # If a hook does not return in its thread, its instance is taken back when it does: that is not awaited.
            waited = [one for one in (group.came, group.back) if one is not None and not kernel.closed]
            if waited:
                await asyncio.wait(waited, timeout=_GOING_BACK)
            self._take_back_stopped(group)
        self._leave_late(error)
        for replacement in self.swap.replacements:
            if not replacement.late:
                await self._end_one(replacement)
            if replacement.tasks and not replacement.homeless:
                anew = "on_deactivated and on_activated of the old code are run, to start them anew"
                ended = ", ".join(replacement.tasks)
                _add_text(error, f"these tasks of {replacement.old.name} had been ended: {ended}; {anew}")
        await self._start_anew([replacement for replacement in self.swap.replacements if not replacement.late])

    async def _start_anew(self, replacements: Iterable[Replacement]) -> None:
        """Start the old instances again without a gap: their tasks were ended for the new code."""
        waited = []
        for replacement in replacements:
            old = replacement.old
            if replacement.tasks and not replacement.homeless and self._kernel.components.get(old.name) is old:
                for member in cell(old).members:
                    if member.active and member.context.running:
                        done = self._kernel.loop.create_future()
                        notify = partial(self.swap.report, done)
                        member.context.runner.submit(Action(partial(_anew, member, notify), notify))
                        waited.append(done)
        if waited:
            await asyncio.wait(waited, timeout=_GOING_BACK)

    def _take_back_stopped(self, group: Group) -> None:
        for replacement in reversed(group.replacements):
            if not cell(replacement.new).members:
                replacement.undo()  # its context has stopped meanwhile
                self.swap.pass_back(group)

    async def _end_one(self, replacement: Replacement) -> None:
        """End the instance of a replacement that has no place."""
        if replacement.switched or replacement.homeless:
            await retire(self._kernel, replacement.old, replacement.new)
        elif replacement.made is not None:
            await retire(self._kernel, replacement.made, finalize=replacement.initialized)

    def _leave_late(self, error: BaseException) -> None:
        """Leave the old instance until a hook of the new code returns: then it comes back; none is ended before."""
        registry, names = self._kernel.registry, []
        for group in self.swap.groups:
            driver = None if group.context is None else group.context.runner.driver
            if driver is None or not any(one.switched for one in group.replacements):
                continue
            for replacement in group.replacements:
                replacement.late = True
                registry.taken_back.add(replacement.new)
                names.append(replacement.old.name)
            task = kernel_task(self._kernel.loop, self._end_late(group, driver.ended), "aiorts reload")
            registry.renewing.add(task)
            task.add_done_callback(registry.renewing.discard)
            task.add_done_callback(log_error)
        if names:
            _add_text(error, f"but {', '.join(names)} still runs the new code until its hook returns")

    async def _end_late(self, group: Group, stopped: asyncio.Future[None]) -> None:
        for moved in (group.came, group.back):
            if moved is not None:
                waited: list[asyncio.Future[Any]] = [moved, stopped]
                await asyncio.wait(waited, return_when=asyncio.FIRST_COMPLETED)
        self._take_back_stopped(group)
        for replacement in group.replacements:
            self._kernel.registry.taken_back.discard(replacement.new)
            await self._end_one(replacement)
        await self._start_anew(group.replacements)


def _anew(member: Member, notify: Callable[[BaseException | None], None]) -> Steps:
    """Run `on_deactivated` and `on_activated`; the member stays active, and its ports take samples all the while."""
    try:
        for hook in ("on_deactivated", "on_activated"):
            if not member.active or member.left:
                return
            error = yield Call(member, hook)
            if error is not None:
                member.context.runner.life.failed(member, hook, error)
    finally:
        notify(None)


def _add_text(error: BaseException, text: str) -> None:
    if issubclass(type(error), AiortsError):
        error.args = (f"{error}; {text}",)


def log_error(task: asyncio.Task[Any]) -> None:
    """Log the error of a task that has no waiter."""
    error = None if task.cancelled() else task.exception()
    if error is not None:
        _LOG.warning("%s failed: %s", task.get_name().removeprefix("aiorts "), error)
