"""How new instances come into their places in every context, and out again: between two cycles, a context at once.

A context with several instances of the type changes all of them with nothing in between. Contexts do not wait for each
other: each changes at the end of its own cycle. A thread of a context hands what is to be changed to the loop.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from aiorts.errors import AiortsError, ClosedError, ComponentError, StateError, TransitionTimeout
from aiorts.kernel.commit import _claimed
from aiorts.kernel.deadlines import StopBudget
from aiorts.kernel.hooks import HookKind
from aiorts.kernel.life import Action, Call
from aiorts.kernel.plugins import cause_of
from aiorts.kernel.references import pass_on_distant_references
from aiorts.kernel.service_visit import Visit
from aiorts.kernel.solo import run_alone
from aiorts.kernel.tasks import kernel_task

if TYPE_CHECKING:
    from aiorts.kernel.context import Context
    from aiorts.kernel.kernel import Kernel
    from aiorts.kernel.life import Steps
    from aiorts.kernel.succession import Succession

__all__ = ("Changeover", "Group", "resolve")

_HOOK: Final = "on_reload"
_LOOP_PATIENCE: Final = 5.0
"""Real seconds after which a context's thread that waits for the loop looks whether that is still there."""


class Group:
    """The instances that one context runs, which are put in place in one go; or one that none runs."""

    def __init__(self, context: Context | None, kernel: Kernel) -> None:
        self.context = context
        self.heirs: list[Succession] = []
        self.came: asyncio.Future[BaseException | None] = kernel.loop.create_future()
        """Done when they are in place, with why not if not."""
        self.begun = self.passed_on = False
        self.back: asyncio.Future[BaseException | None] | None = None
        """Done when they are out of it again."""

    @property
    def bounded(self) -> bool:
        """Whether it has begun and will end: a hook that takes too long is cancelled, but for one in a thread."""
        return self.begun and (self.context is None or self.context.suspends)

    def late(self, timeout: float | None) -> str:
        """What has not happened in time."""
        names = ", ".join(heir.old.name for heir in self.heirs)
        where = "" if self.context is None else f" in {self.context.name}"
        what = "on_reload did not return" if self.begun else "no cycle ended"
        return f"{names}{where}: {what} within {timeout} s"


class Changeover:
    """The new instances of one reload, by context."""

    def __init__(self, kernel: Kernel, timeout: float | None) -> None:
        self._kernel = kernel
        self._timeout = timeout
        self._heirs: list[Succession] = []
        self._groups: list[Group] = []
        self._failure: BaseException | None = None
        """Why all is taken back."""
        self._failed: asyncio.Future[None] = kernel.loop.create_future()

    # -- putting them in place -------------------------------------------------------------------------------------

    async def _switch(self) -> None:
        kernel = self._kernel
        groups: dict[Context | None, Group] = {}
        for heir in self._heirs:
            members = heir.old._rt_members
            context = members[0].context if members else None
            if context is None or context not in groups:
                groups[context] = Group(context, kernel)
                self._groups.append(groups[context])
            groups[context].heirs.append(heir)
        for group in self._groups:
            if group.context is not None:
                told = partial(self._came, group)
                group.context._submit(Action(partial(self._steps, group, told), told))
            else:
                group.begun = True
                kernel_task(kernel.loop, self._switch_alone(group), "aiorts reload")
        late: asyncio.Future[None] = kernel.loop.create_future()
        timer = None if self._timeout is None else kernel.call_later(self._timeout, lambda: resolve(late))
        try:
            for group in self._groups:
                waited: list[asyncio.Future[Any]] = [group.came, self._failed, kernel._closing_begun]
                await asyncio.wait([*waited, late], return_when=asyncio.FIRST_COMPLETED)
                if late.done() and group.bounded:
                    await asyncio.wait(waited, return_when=asyncio.FIRST_COMPLETED)
                self._check()
                if not group.came.done():
                    raise TransitionTimeout(f"reload: {group.late(self._timeout)}; nothing was changed")
        finally:
            late.cancel()
            if timer is not None:
                timer.cancel()

    async def _may_enter(self, heir: Succession) -> bool:
        """Wait for the end of a call that the old one serves."""
        gate = heir.old._rt_gate
        if gate.open:
            return True
        turn: asyncio.Future[bool] = self._kernel.loop.create_future()
        timer = None
        if self._timeout is not None:
            timer = self._kernel.call_later(self._timeout, lambda: None if turn.done() else turn.set_result(False))
        try:
            return await gate.wait(turn)
        finally:
            if timer is not None:
                timer.cancel()

    def _check(self) -> None:
        if self._failure is not None:
            raise self._failure
        if self._kernel._closed:
            raise ClosedError(f"{self._kernel.name}: closes; the reload was given up")

    def _came(self, group: Group, error: BaseException | None) -> None:
        """From whatever thread: the instances of a group are in their places, or will not be."""
        if error is not None:
            self._kernel._on_loop(partial(self._fail, error))
        self._tell(group.came, error)

    def _fail(self, failure: BaseException) -> None:
        """All is to be taken back."""
        if self._failure is None:
            self._failure = failure
            resolve(self._failed)
            self._go_back()

    def _tell(self, future: asyncio.Future[BaseException | None], error: BaseException | None) -> None:
        """From whatever thread."""
        self._kernel._on_loop(lambda: None if future.done() else future.set_result(error))

    def _steps(self, group: Group, told: Callable[[BaseException | None], None]) -> Steps:
        """Between two cycles of the context: all of its instances, or none."""
        context = group.context
        assert context is not None  # noqa: S101 - only groups with one have steps
        group.begun = True
        error: BaseException | None = ClosedError(f"{context.name}: the context has stopped")
        try:
            for heir in group.heirs:
                outcome = self._failure or (yield from self._take_over(context, heir)) or self._failure
                if outcome is not None:
                    error = outcome
                    for other in reversed(group.heirs):
                        _on_loop(self._kernel, other.undo)
                    return
            _on_loop(self._kernel, partial(self._pass_on, group))
            error = None
        finally:
            told(error)

    def _take_over(self, context: Context, heir: Succession) -> Any:
        old = heir.old
        member = next((member for member in old._rt_members if member.context is context), None)
        if member is None:
            return StateError(f"{old.name}: left {context.name} while its new code was made ready")
        kind = heir.new._rt_hook_kinds[_HOOK]
        member.hooks[_HOOK] = max(kind, HookKind.PLAIN), partial(self._enter, heir)
        if context.suspends and self._timeout is not None:
            heir.limit(self._timeout)
        error = yield Call(member, _HOOK)
        member.hooks.pop(_HOOK, None)
        heir.unlimit()
        if error is not None:
            return self._refusal(heir, error)
        if not heir.switched:
            return StateError(f"{old.name}: did not come to it")
        heir.note_handed()
        _on_loop(self._kernel, heir.end_tasks)
        return None

    def _pass_on(self, group: Group) -> None:
        pass_on_distant_references(self._kernel, {heir.old: heir.new for heir in group.heirs})
        group.passed_on = True

    def _pass_back(self, group: Group) -> None:
        if group.passed_on:
            pass_on_distant_references(self._kernel, {heir.new: heir.old for heir in group.heirs})

    def _enter(self, heir: Succession) -> Any:
        """In the place of a hook of the old one: nobody else is inside."""
        _on_loop(self._kernel, heir.switch)
        kind = heir.new._rt_hook_kinds[_HOOK]
        if kind == HookKind.ABSENT:
            return None
        if kind == HookKind.ASYNC or not self._kernel.on_loop_thread():
            _on_loop(self._kernel, heir.end_tasks)  # they would go on meanwhile, beside what it starts itself
        return heir.new.on_reload(heir.old)

    def _refusal(self, heir: Succession, error: BaseException) -> BaseException:
        if not heir.switched:
            return error
        return self._blamed(heir, _HOOK, error)

    def _blamed(self, heir: Succession, hook: str, error: BaseException) -> ComponentError:
        advice = ""
        if isinstance(error, AttributeError) and hook != _HOOK and error.obj is heir.new:
            advice = "; a reload runs no on_activated: what is made there is taken over in on_reload(self, old)"
        told = ComponentError(
            f"{heir.code.origin}: {heir.old.name}.{hook} of the new code failed: {cause_of(error)}{advice}; "
            "the old code is in force again"
        )
        told.__cause__ = error
        return told

    async def _switch_alone(self, group: Group) -> None:
        """Instances that no context runs."""
        error: BaseException | None = None
        for heir in group.heirs:
            error = self._failure or await self._take_over_alone(heir)
            if error is not None:
                for other in group.heirs:
                    other.undo()
                break
        else:
            self._pass_on(group)
        self._came(group, error)

    async def _take_over_alone(self, heir: Succession) -> BaseException | None:
        kernel, old, new = self._kernel, heir.old, heir.new
        if old._rt_members:
            return StateError(f"{old.name}: came into {old.contexts[0].name} while its new code was made ready")
        if not await self._may_enter(heir):
            return StateError(f"{old.name}: the call that it serves did not end within {self._timeout} s")
        try:
            heir.switch()
        except AiortsError as refused:
            heir.undo()
            old._rt_gate.pass_on()
            return refused
        new._rt_gate.inside = Visit(new, _HOOK)
        try:
            budget = None if self._timeout is None else StopBudget(kernel.loop, self._timeout)
            error = await run_alone(kernel, new, _HOOK, budget, old)
        finally:
            new._rt_gate.inside = None
            new._rt_gate.pass_on()
        if error is not None:
            return self._refusal(heir, error)
        heir.note_handed()
        heir.end_tasks()
        return None

    def _go_back(self) -> None:
        """Asked for at once in each context: it comes before what follows from a failure."""
        for group in self._groups:
            context = group.context
            if group.back is None and context is not None and any(heir.switched for heir in group.heirs):
                group.back = self._kernel.loop.create_future()
                told = partial(self._tell, group.back)
                if context._driver is None or context._stopping:
                    told(None)
                else:
                    context._submit(Action(partial(self._back_steps, group, told), told))

    def _back_steps(self, group: Group, told: Callable[[BaseException | None], None]) -> Steps:
        try:
            for heir in reversed(group.heirs):
                gate, members = heir.old._rt_gate, heir.new._rt_members
                member = next((member for member in members if member.context is group.context), None)
                # Who only waits comes in later, and finds the old code.
                if member is not None and gate.inside is not None:
                    member.hooks[_HOOK] = HookKind.PLAIN, partial(_on_loop, self._kernel, heir.undo)
                    yield Call(member, _HOOK)
                    member.hooks.pop(_HOOK, None)
                _on_loop(self._kernel, heir.undo)
            _on_loop(self._kernel, partial(self._pass_back, group))
        finally:
            told(None)


def resolve(future: asyncio.Future[None]) -> None:
    if not future.done():
        future.set_result(None)


def _on_loop(kernel: Kernel, change: Callable[[], None]) -> None:
    """Do `change` on the kernel's loop, for which a context's thread waits; what it raises is raised here."""
    if kernel.on_loop_thread():
        change()
        return
    done, chance = threading.Event(), [True]
    raised: list[BaseException] = []

    def on_loop() -> None:
        if _claimed(chance):
            try:
                change()
            except AiortsError as error:
                raised.append(error)
            finally:
                done.set()

    kernel._on_loop(on_loop)
    while not done.wait(_LOOP_PATIENCE):
        if kernel.loop.is_closed() and _claimed(chance):
            raise ClosedError("reload: the loop is closed")
    if raised:
        raise raised[0]
