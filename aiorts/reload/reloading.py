"""Hot reload: the code of a component type is replaced while the system runs, or everything is as it was.

In this order: the file is read and run aside (`fresh_code.py`); a new instance of each component of the type is made
beside the old one (`replacement.py`); in each context all of them are put in place between two cycles, one
after the other with nothing in between (`swap.py`), and `on_reload` gets the old one; the new instances have to
do a few cycles without a failure, and a window of time no worse than that of the old ones; then the old ones are ended.
A failure on the way takes all of it back. One reload at a time.
"""

from __future__ import annotations

import asyncio
import math
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from aiorts.errors import ComponentError, ConfigurationError, StateError
from aiorts.health import Health
from aiorts.kernel.declarations import kinds_of
from aiorts.kernel.execution.cell import cell
from aiorts.kernel.loop.tasks import current_task, kernel_task, owner_of
from aiorts.kernel.service import stand_in_reason
from aiorts.late import dataclass
from aiorts.model.health.verdict import verdict
from aiorts.reload.fresh_code import FreshCode, find_type, read_anew
from aiorts.reload.reload_events import Reloaded
from aiorts.reload.replacement import Replacement
from aiorts.reload.swap import resolve
from aiorts.reload.trial import Trial, log_error

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.model.health.windows import Window

_LOOKS: Final = 50
"""The number of checks, within `seconds`, whether enough cycles were done."""


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
    trial = Trial(kernel, timeout)
    one = _Reload(kernel, kind, cycles, seconds, import_timeout, window, trial, Health(kernel))
    task = kernel_task(kernel.loop, one.run(), f"aiorts reload {origin}")
    renewing = kernel.registry.renewing
    renewing.add(task)
    task.add_done_callback(renewing.discard)
    try:
        return await asyncio.shield(task)
    except asyncio.CancelledError:
        task.add_done_callback(log_error)
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
        why = stand_in_reason(component.kernel.services, name)
        why = why or next(filter(None, (kind.keeps_code(component) for kind in kinds_of(component))), "")
    if why:
        raise StateError(f"{name}: cannot be reloaded: {why}")


@dataclass(slots=True)
class _Reload:
    """One reload, from the file to the end of the old instances."""

    _kernel: Microkernel
    _kind: type[Component] | str
    _cycles: int
    _seconds: float
    _import_timeout: float
    _window: float
    _trial: Trial
    _health: Health

    async def run(self) -> Reloaded:
        """Carry out the reload; its result."""
        kernel = self._kernel
        async with kernel.registry.renewal:
            kernel.check_open("reload")
            origin = find_type(kernel, self._kind)
            code = await read_anew(kernel, origin, self._import_timeout)
            before = await self._health.window(self._window) if self._window else None
            trial = self._trial
            try:
                await self._prepare(code)
                for replacement in trial.swap.replacements:
                    check_replaceable(replacement.old)
                await trial.switch()
                await (self._prove() if before is None else self._prove_healthy(before, str(origin)))
            except BaseException as error:
                await trial.take_back(error)
                code.forget()
                raise
            code.adopt()
            return Reloaded(str(origin), origin.path, await trial.settle())

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
                await self._trial.prepare(old, code)
                await asyncio.sleep(0)  # many of them must not hold the loop for long
                self._kernel.check_open("reload")

    # -- the first cycles ------------------------------------------------------------------------------------------

    async def _prove(self) -> None:
        """Wait until each new instance has done its first cycles."""
        while not all(map(self._has_proved, self._trial.swap.replacements)):
            self._trial.swap.check()
            woken: asyncio.Future[None] = self._kernel.loop.create_future()
            timer = self._kernel.call_later(self._seconds / _LOOKS, partial(resolve, woken))
            waited: list[asyncio.Future[Any]] = [woken, self._trial.swap.failed, self._kernel.closing]
            try:
                await asyncio.wait(waited, return_when=asyncio.FIRST_COMPLETED)
            finally:
                timer.cancel()
                woken.cancel()
        self._trial.swap.check()

    def _has_proved(self, replacement: Replacement) -> bool:
        if self._kernel.clock.monotonic_ns() - replacement.began_ns >= self._seconds * 1e9:
            return True
        return all(
            context.ticks - began >= self._cycles or context not in replacement.new.contexts
            for context, began in replacement.began.items()
        )

    async def _prove_healthy(self, before: Window, origin: str) -> None:
        """Wait for a window from now on; raise ComponentError if it is worse than the window before."""
        measured = kernel_task(self._kernel.loop, self._health.window(self._window), "aiorts health")
        measured.add_done_callback(lambda task: None if task.cancelled() else task.exception())
        try:
            await self._prove()
            waited: list[asyncio.Future[Any]] = [measured, self._trial.swap.failed]
            await asyncio.wait(waited, return_when=asyncio.FIRST_COMPLETED)
            self._trial.swap.check()
            found = verdict(before, measured.result(), [one.old.name for one in self._trial.swap.replacements])
        finally:
            measured.cancel()
        if found is not None:
            raise ComponentError(f"{origin}: the new code does worse: {found}; the old code is in force again")
