"""Hot reload: the code of a component type is replaced while the system runs, or everything is as it was.

In this order: the file is read and run aside (`fresh_code.py`); a new instance of each component of the type is made
beside the old one (`heir.py`); in each context all of them are put in place between two cycles, one after the other
with nothing in between (`succession.py`), and `on_reload` is told the old one; they have to do a few cycles without a
failure; then the old ones are ended. What fails on the way takes all of it back. One reload at a time.
"""

from __future__ import annotations

import asyncio
import logging
import math
import sys
from collections.abc import Callable, Iterable
from contextlib import nullcontext
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from aiorts.errors import AiortsError, ConfigurationError, StateError
from aiorts.kernel.bus import HookFailed
from aiorts.kernel.changeover import Changeover, Group, resolve
from aiorts.kernel.fresh_code import FreshCode, find_type, read_anew
from aiorts.kernel.life import Action, Call
from aiorts.kernel.reload_events import Reloaded
from aiorts.kernel.succession import Succession, retire
from aiorts.kernel.tasks import current_task, kernel_task, owner_of
from aiorts.model.lifecycle import LifeCycleState

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.kernel import Kernel
    from aiorts.kernel.life import Steps
    from aiorts.kernel.member import Member

__all__ = ("reload",)

_LOG = logging.getLogger("aiorts.kernel")
_GOING_BACK: Final = 10.0
"""Seconds that are waited until the old instances of a context are in their places again."""
_LOOKS: Final = 50
"""How often within `seconds` it is looked whether enough cycles were done."""


async def reload(
    kernel: Kernel,
    kind: type[Component] | str,
    *,
    cycles: int,
    seconds: float,
    timeout: float | None,
    import_timeout: float,
) -> Reloaded:
    """See `Kernel.reload`."""
    for name, value in (("cycles", cycles), ("seconds", seconds), ("timeout", timeout), ("limit", import_timeout)):
        if value is not None and not (isinstance(value, int | float) and 0 <= value < math.inf):
            raise ConfigurationError(f"reload: {name} = {value!r}: expected a number from 0 on")
    origin = find_type(kernel, kind)
    caller = owner_of(current_task())
    for component in kernel.components.values():
        if origin.is_of(type(component)):
            check_replaceable(component)
            if caller is component or any(context._inside() for context in component.contexts):
                raise StateError(
                    f"reload({origin}): called by a hook, or a task, that it would wait for or end; call it from "
                    "outside of the component's contexts"
                )
    one = _Reload(kernel, kind, cycles, seconds, timeout, import_timeout)
    task = kernel_task(kernel.loop, one.run(), f"aiorts reload {origin}")
    renewing = kernel._roster.renewing
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
    component.kernel._roster.check_settled(component)
    if component._rt_abandoned is not None:
        why = "one of its hooks was left behind and still runs the old code; remove it"
    elif component in component.kernel._roster.taken_back:
        why = "its code was taken back, and a hook of it has not returned; wait for that"
    elif component._rt_composes:
        why = "is a composite; reload its members"
    elif component._rt_host.realtime:
        why = (
            "is in a real-time context, whose thread waits for nobody; take it out with `context.remove`, reload, and "
            "add it again"
        )
    elif _runs_machine(component):
        why = "is a state machine that runs; deactivate it first"
    else:
        return
    raise StateError(f"{name}: cannot be reloaded: {why}")


def _runs_machine(component: Component) -> bool:
    machine = sys.modules.get("aiorts.kernel.machine")
    if machine is None or not isinstance(component, machine.StateMachineComponent):
        return False
    return any(member.state is LifeCycleState.ACTIVE for member in component._rt_members)


def _log_error(task: asyncio.Task[Any]) -> None:
    error = None if task.cancelled() else task.exception()
    if error is not None:
        _LOG.warning("%s failed: %s", task.get_name().removeprefix("aiorts "), error)


class _Reload(Changeover):
    """One reload, from the file to the end of the old instances."""

    def __init__(
        self,
        kernel: Kernel,
        kind: type[Component] | str,
        cycles: int,
        seconds: float,
        timeout: float | None,
        import_timeout: float,
    ) -> None:
        super().__init__(kernel, timeout)
        self._kind = kind
        self._cycles = cycles
        self._seconds = seconds
        self._import_timeout = import_timeout

    async def run(self) -> Reloaded:
        """All of it."""
        kernel = self._kernel
        async with kernel._roster.renewal:
            kernel._require_open("reload")
            origin = find_type(kernel, self._kind)
            code = await read_anew(kernel, origin, self._import_timeout)
            unsubscribe = kernel.bus.subscribe(HookFailed, self._look)
            try:
                await self._prepare(code)
                for heir in self._heirs:
                    check_replaceable(heir.old)
                composed = any(heir.old._rt_composite is not None for heir in self._heirs)
                async with kernel._roster.composing if composed else nullcontext():
                    await self._switch()
                await self._prove()
            except BaseException as error:
                await self._take_back(error)
                code.forget()
                raise
            finally:
                unsubscribe()
            code.adopt()
            events = []
            for heir in self._heirs:
                if (event := heir.settle()) is not None:
                    events.append(event)
                await asyncio.sleep(0)  # many of them must not hold the loop for long
            for heir in self._heirs:
                await retire(kernel, heir.old, heir.new)
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
                heir = Succession(self._kernel, old, code)
                self._heirs.append(heir)
                await heir.prepare(self._timeout)
                await asyncio.sleep(0)  # many of them must not hold the loop for long
                self._kernel._require_open("reload")

    # -- the first cycles ------------------------------------------------------------------------------------------

    def _look(self, event: HookFailed) -> None:
        """A hook failed: one of a new instance takes everything back, before anything else follows from it."""
        if self._failure is not None:
            return
        for heir in self._heirs:
            if heir.switched and self._kernel.components.get(event.component) is heir.new:
                if event.hook == "task" and not event.context and heir.new._rt_members:
                    return  # one of the old instance's, which is being ended
                self._fail(self._blamed(heir, event.hook, event.error))
                return

    async def _prove(self) -> None:
        """Wait until each has done its first cycles."""
        while not all(map(self._has_proved, self._heirs)):
            self._check()
            woken: asyncio.Future[None] = self._kernel.loop.create_future()
            timer = self._kernel.call_later(self._seconds / _LOOKS, partial(resolve, woken))
            waited: list[asyncio.Future[Any]] = [woken, self._failed, self._kernel._closing_begun]
            try:
                await asyncio.wait(waited, return_when=asyncio.FIRST_COMPLETED)
            finally:
                timer.cancel()
                woken.cancel()
        self._check()

    def _has_proved(self, heir: Succession) -> bool:
        if self._kernel.clock.monotonic_ns() - heir.began_ns >= self._seconds * 1e9:
            return True
        return all(
            context.ticks - began >= self._cycles or context not in heir.new.contexts
            for context, began in heir.began.items()
        )

    # -- as it was -------------------------------------------------------------------------------------------------

    async def _take_back(self, error: BaseException) -> None:
        """Every old instance in its place, and the new ones ended."""
        kernel = self._kernel
        if self._failure is None:
            self._failure = error
        self._go_back()
        for group in self._groups:
            # One whose hook never returns in its thread takes itself back when it does; nobody waits for that.
            waited = [one for one in (group.came, group.back) if one is not None and not kernel._closed]
            if waited:
                await asyncio.wait(waited, timeout=_GOING_BACK)
            self._take_back_stopped(group)
        self._leave_late(error)
        for heir in self._heirs:
            if not heir.late:
                await self._end_one(heir)
            if heir.tasks and not heir.homeless:
                anew = "on_deactivated and on_activated of the old code are run, to start them anew"
                _say_more(error, f"these tasks of {heir.old.name} had been ended: {', '.join(heir.tasks)}; {anew}")
        await self._start_anew([heir for heir in self._heirs if not heir.late])

    async def _start_anew(self, heirs: Iterable[Succession]) -> None:
        """What the old code had started was ended for the new code's sake: it starts it again, without a gap."""
        waited = []
        for heir in heirs:
            if heir.tasks and not heir.homeless and self._kernel.components.get(heir.old.name) is heir.old:
                for member in heir.old._rt_members:
                    if member.active and member.context.running:
                        done = self._kernel.loop.create_future()
                        told = partial(self._tell, done)
                        member.context._submit(Action(partial(_anew, member, told), told))
                        waited.append(done)
        if waited:
            await asyncio.wait(waited, timeout=_GOING_BACK)

    def _take_back_stopped(self, group: Group) -> None:
        for heir in reversed(group.heirs):
            if not heir.new._rt_members:
                heir.undo()  # its context has stopped meanwhile
                self._pass_back(group)

    async def _end_one(self, heir: Succession) -> None:
        """The one of the two that has no place."""
        if heir.switched or heir.homeless:
            await retire(self._kernel, heir.old, heir.new)
        elif heir.made is not None:
            await retire(self._kernel, heir.made, finalize=heir.initialized)

    def _leave_late(self, error: BaseException) -> None:
        """Where a hook of the new code has not returned, the old one comes back when it does: none is ended before."""
        roster, names = self._kernel._roster, []
        for group in self._groups:
            driver = None if group.context is None else group.context._driver
            if driver is None or not any(heir.switched for heir in group.heirs):
                continue
            for heir in group.heirs:
                heir.late = True
                roster.taken_back.add(heir.new)
                names.append(heir.old.name)
            task = kernel_task(self._kernel.loop, self._end_late(group, driver.ended), "aiorts reload")
            roster.renewing.add(task)
            task.add_done_callback(roster.renewing.discard)
            task.add_done_callback(_log_error)
        if names:
            _say_more(error, f"but {', '.join(names)} still runs the new code until its hook returns")

    async def _end_late(self, group: Group, stopped: asyncio.Future[None]) -> None:
        for moved in (group.came, group.back):
            if moved is not None:
                waited: list[asyncio.Future[Any]] = [moved, stopped]
                await asyncio.wait(waited, return_when=asyncio.FIRST_COMPLETED)
        self._take_back_stopped(group)
        for heir in group.heirs:
            self._kernel._roster.taken_back.discard(heir.new)
            await self._end_one(heir)
        await self._start_anew(group.heirs)


def _anew(member: Member, told: Callable[[BaseException | None], None]) -> Steps:
    """Stays active: the ports take samples all the while."""
    try:
        for hook in ("on_deactivated", "on_activated"):
            if not member.active or member.left:
                return
            error = yield Call(member, hook)
            if error is not None:
                member.context._life.failed(member, hook, error)
    finally:
        told(None)


def _say_more(error: BaseException, text: str) -> None:
    if isinstance(error, AiortsError):
        error.args = (f"{error}; {text}",)
