"""Hot reload: the code of a component type is replaced while the system runs, or everything is as it was.

In this order: the file is read and run aside (`fresh_code.py`); a new instance of each component of the type is made
beside the old one (`replacement.py`); in each context all of them are put in place between two cycles, one
after the other with nothing in between (`swap.py`), and `on_reload` is told the old one; they have to do a few
cycles without a failure, and in a window of time no worse than the old ones before; then the old ones are ended. What
fails on the way takes all of it back. One reload at a time.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Iterable
from contextlib import nullcontext
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from aiorts.errors import AiortsError, ComponentError, ConfigurationError, StateError
from aiorts.health import Health
from aiorts.kernel.declarations import kinds_of
from aiorts.kernel.execution.cell import cell
from aiorts.kernel.execution.cycle import Action, Call
from aiorts.kernel.loop.bus import HookFailed
from aiorts.kernel.loop.guarded import KernelLog
from aiorts.kernel.loop.tasks import current_task, kernel_task, owner_of
from aiorts.model.health.verdict import verdict
from aiorts.reload.fresh_code import FreshCode, find_type, read_anew
from aiorts.reload.reload_events import Reloaded
from aiorts.reload.replacement import Replacement, retire
from aiorts.reload.swap import Group, Swap, resolve

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.execution.cycle import Steps
    from aiorts.kernel.execution.member import Member
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.model.health.windows import Window

_LOG = KernelLog()
_GOING_BACK: Final = 10.0
"""Seconds that are waited until the old instances of a context are in their places again."""
_LOOKS: Final = 50
"""How often within `seconds` it is looked whether enough cycles were done."""


async def reload(
    kernel: Microkernel,
    kind: type[Component] | str,
    *,
    cycles: int,
    seconds: float,
    timeout: float | None,
    import_timeout: float,
    window: float = 0.0,
) -> Reloaded:
    """See `Kernel.reload`."""
    for name, value in (
        ("cycles", cycles),
        ("seconds", seconds),
        ("timeout", timeout),
        ("import_timeout", import_timeout),
        ("window", window),
    ):
        if value is not None and not (isinstance(value, int | float) and 0 <= value < math.inf):
            raise ConfigurationError(f"reload: {name} = {value!r}: expected a number from 0 on")
    origin = find_type(kernel, kind)
    caller = owner_of(current_task())
    for component in kernel.components.values():
        if origin.is_of(type(component)):
            check_replaceable(component)
            if caller is component or any(context.runner.inside() for context in component.contexts):
                raise StateError(
                    f"reload({origin}): called by a hook, or a task, that it would wait for or end; call it from "
                    "outside of the component's contexts"
                )
    one = _Reload(kernel, kind, cycles, seconds, timeout, import_timeout, window)
    task = kernel_task(kernel.loop, one.run(), f"aiorts reload {origin}")
    renewing = kernel.registry.renewing
    renewing.add(task)
    task.add_done_callback(renewing.discard)
    try:
        return await asyncio.shield(task)
    except asyncio.CancelledError:
        task.add_done_callback(_log_error)
        raise


def check_replaceable(component: Component) -> None:
    """Raise StateError when this component cannot be replaced where it is."""
    name = component.name
    component.kernel.registry.check_settled(component)
    if cell(component).abandoned is not None:
        why = "one of its hooks was abandoned and still runs the old code; remove it"
    elif component in component.kernel.registry.taken_back:
        why = "its code was taken back, and a hook of it has not returned; wait for that"
    elif cell(component).realtime:
        why = (
            "is in a real-time context, whose thread never waits; take it out with `context.remove`, reload, and "
            "add it again"
        )
    else:
        why = next(filter(None, (kind.keeps_code(component) for kind in kinds_of(component))), "")
    if why:
        raise StateError(f"{name}: cannot be reloaded: {why}")


def _log_error(task: asyncio.Task[Any]) -> None:
    error = None if task.cancelled() else task.exception()
    if error is not None:
        _LOG.warning("%s failed: %s", task.get_name().removeprefix("aiorts "), error)


class _Reload:
    """One reload, from the file to the end of the old instances."""

    def __init__(
        self,
        kernel: Microkernel,
        kind: type[Component] | str,
        cycles: int,
        seconds: float,
        timeout: float | None,
        import_timeout: float,
        window: float,
    ) -> None:
        self._kernel = kernel
        self._timeout = timeout
        self._swap = Swap(kernel, timeout)
        self._kind = kind
        self._cycles = cycles
        self._seconds = seconds
        self._import_timeout = import_timeout
        self._window = window
        self._health = Health(kernel)

    async def run(self) -> Reloaded:
        """All of it."""
        kernel = self._kernel
        async with kernel.registry.renewal:
            kernel.check_open("reload")
            origin = find_type(kernel, self._kind)
            code = await read_anew(kernel, origin, self._import_timeout)
            before = await self._health.window(self._window) if self._window else None
            unsubscribe = kernel.bus.subscribe(HookFailed, self._look)
            try:
                await self._prepare(code)
                for replacement in self._swap.replacements:
                    check_replaceable(replacement.old)
                composed = any(cell(replacement.old).group is not None for replacement in self._swap.replacements)
                async with kernel.registry.composing if composed else nullcontext():
                    await self._swap.switch()
                await (self._prove() if before is None else self._prove_healthy(before, str(origin)))
            except BaseException as error:
                await self._take_back(error)
                code.forget()
                raise
            finally:
                unsubscribe()
            code.adopt()
            events = []
            for replacement in self._swap.replacements:
                if (event := replacement.settle()) is not None:
                    events.append(event)
                await asyncio.sleep(0)  # many of them must not hold the loop for long
            for replacement in self._swap.replacements:
                await retire(kernel, replacement.old, replacement.new)
            return Reloaded(str(origin), origin.path, tuple(events))

    # -- making them -----------------------------------------------------------------------------------------------

    async def _prepare(self, code: FreshCode) -> None:
        ready: set[Component] = set()
        while True:
            olds = [
                one for one in self._kernel.components.values() if code.origin.is_of(type(one)) and one not in ready
            ]
            if not olds:
                return
            for old in olds:
                check_replaceable(old)
                ready.add(old)
                replacement = Replacement(self._kernel, old, code)
                self._swap.replacements.append(replacement)
                await replacement.prepare(self._timeout)
                await asyncio.sleep(0)  # many of them must not hold the loop for long
                self._kernel.check_open("reload")

    # -- the first cycles ------------------------------------------------------------------------------------------

    def _look(self, event: HookFailed) -> None:
        """A hook failed: one of a new instance takes everything back, before anything else follows from it."""
        if self._swap.failure is not None:
            return
        for replacement in self._swap.replacements:
            if replacement.switched and self._kernel.components.get(event.component) is replacement.new:
                if event.hook == "task" and not event.context and cell(replacement.new).members:
                    return  # one of the old instance's, which is being ended
                self._swap.fail(self._swap.blamed(replacement, event.hook, event.error))
                return

    async def _prove(self) -> None:
        """Wait until each has done its first cycles."""
        while not all(map(self._has_proved, self._swap.replacements)):
            self._swap.check()
            woken: asyncio.Future[None] = self._kernel.loop.create_future()
            timer = self._kernel.call_later(self._seconds / _LOOKS, partial(resolve, woken))
            waited: list[asyncio.Future[Any]] = [woken, self._swap.failed, self._kernel.closing]
            try:
                await asyncio.wait(waited, return_when=asyncio.FIRST_COMPLETED)
            finally:
                timer.cancel()
                woken.cancel()
        self._swap.check()

    def _has_proved(self, replacement: Replacement) -> bool:
        if self._kernel.clock.monotonic_ns() - replacement.began_ns >= self._seconds * 1e9:
            return True
        return all(
            context.ticks - began >= self._cycles or context not in replacement.new.contexts
            for context, began in replacement.began.items()
        )

    async def _prove_healthy(self, before: Window, origin: str) -> None:
        """Wait, too, for a window from now on, and raise ComponentError when it is worse than the one before."""
        measured = kernel_task(self._kernel.loop, self._health.window(self._window), "aiorts health")
        measured.add_done_callback(lambda task: None if task.cancelled() else task.exception())
        try:
            await self._prove()
            waited: list[asyncio.Future[Any]] = [measured, self._swap.failed]
            await asyncio.wait(waited, return_when=asyncio.FIRST_COMPLETED)
            self._swap.check()
            found = verdict(before, measured.result(), [one.old.name for one in self._swap.replacements])
        finally:
            measured.cancel()
        if found is not None:
            raise ComponentError(f"{origin}: the new code does worse: {found}; the old code is in force again")

    # -- as it was -------------------------------------------------------------------------------------------------

    async def _take_back(self, error: BaseException) -> None:
        """Every old instance in its place, and the new ones ended."""
        kernel = self._kernel
        if self._swap.failure is None:
            self._swap.failure = error
        self._swap.go_back()
        for group in self._swap.groups:
            # One whose hook never returns in its thread takes itself back when it does; nobody waits for that.
            waited = [one for one in (group.came, group.back) if one is not None and not kernel.closed]
            if waited:
                await asyncio.wait(waited, timeout=_GOING_BACK)
            self._take_back_stopped(group)
        self._leave_late(error)
        for replacement in self._swap.replacements:
            if not replacement.late:
                await self._end_one(replacement)
            if replacement.tasks and not replacement.homeless:
                anew = "on_deactivated and on_activated of the old code are run, to start them anew"
                ended = ", ".join(replacement.tasks)
                _add_text(error, f"these tasks of {replacement.old.name} had been ended: {ended}; {anew}")
        await self._start_anew([replacement for replacement in self._swap.replacements if not replacement.late])

    async def _start_anew(self, replacements: Iterable[Replacement]) -> None:
        """What the old code had started was ended for the new code's sake: it starts it again, without a gap."""
        waited = []
        for replacement in replacements:
            old = replacement.old
            if replacement.tasks and not replacement.homeless and self._kernel.components.get(old.name) is old:
                for member in cell(old).members:
                    if member.active and member.context.running:
                        done = self._kernel.loop.create_future()
                        notify = partial(self._swap.report, done)
                        member.context.runner.submit(Action(partial(_anew, member, notify), notify))
                        waited.append(done)
        if waited:
            await asyncio.wait(waited, timeout=_GOING_BACK)

    def _take_back_stopped(self, group: Group) -> None:
        for replacement in reversed(group.replacements):
            if not cell(replacement.new).members:
                replacement.undo()  # its context has stopped meanwhile
                self._swap.pass_back(group)

    async def _end_one(self, replacement: Replacement) -> None:
        """The one of the two that has no place."""
        if replacement.switched or replacement.homeless:
            await retire(self._kernel, replacement.old, replacement.new)
        elif replacement.made is not None:
            await retire(self._kernel, replacement.made, finalize=replacement.initialized)

    def _leave_late(self, error: BaseException) -> None:
        """Where a hook of the new code has not returned, the old one comes back when it does: none is ended before."""
        registry, names = self._kernel.registry, []
        for group in self._swap.groups:
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
            task.add_done_callback(_log_error)
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
    """Stays active: the ports take samples all the while."""
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
