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
from aiorts.kernel.commit import claimed
from aiorts.kernel.detached_hook import run_alone
from aiorts.kernel.execution.cell import cell
from aiorts.kernel.execution.cycle import Action, Call
from aiorts.kernel.execution.hooks import HookKind
from aiorts.kernel.execution.member import Visit
from aiorts.kernel.extensions.loading import cause_of
from aiorts.kernel.loop.deadlines import StopBudget
from aiorts.kernel.loop.tasks import kernel_task
from aiorts.reload.references import pass_on_distant_references

if TYPE_CHECKING:
    from aiorts.kernel.execution.context import Context
    from aiorts.kernel.execution.cycle import Steps
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.reload.replacement import Replacement

_HOOK: Final = "on_reload"
_LOOP_PATIENCE: Final = 5.0
"""Real seconds after which a context's thread that waits for the loop looks whether that is still there."""


class Group:
    """The instances that one context runs, which are put in place in one go; or an instance that no context runs."""

    def __init__(self, context: Context | None, kernel: Microkernel) -> None:
        self.context = context
        self.replacements: list[Replacement] = []
        self.came: asyncio.Future[BaseException | None] = kernel.loop.create_future()
        """Done when the instances are in place, or with the reason why they are not."""
        self.begun = self.passed_on = False
        self.back: asyncio.Future[BaseException | None] | None = None
        """Done when the instances are out of their places again."""

    @property
    def bounded(self) -> bool:
        """Whether the change has begun and will end: a hook that takes too long is cancelled, except in a thread."""
        return self.begun and (self.context is None or self.context.suspends)

    def late(self, timeout: float | None) -> str:
        """The step that was not done in time, in words."""
        names = ", ".join(replacement.old.name for replacement in self.replacements)
        where = "" if self.context is None else f" in {self.context.name}"
        what = "on_reload did not return" if self.begun else "no cycle ended"
        return f"{names}{where}: {what} within {timeout} s"


class Swap:
    """The new instances of one reload, by context."""

    def __init__(self, kernel: Microkernel, timeout: float | None) -> None:
        self._kernel = kernel
        self._timeout = timeout
        self.replacements: list[Replacement] = []
        self.groups: list[Group] = []
        self.failure: BaseException | None = None
        """The failure for which all is taken back."""
        self.failed: asyncio.Future[None] = kernel.loop.create_future()

    # -- putting them in place -------------------------------------------------------------------------------------

    async def switch(self) -> None:
        """Put every new instance in its place, between two cycles of its context; what fails is raised.

        Raises:
            TransitionTimeout: no cycle of a context ended in time. Also the error in `failure`.
        """
        kernel = self._kernel
        groups: dict[Context | None, Group] = {}
        for replacement in self.replacements:
            members = cell(replacement.old).members
            context = members[0].context if members else None
            if context is None or context not in groups:
                groups[context] = Group(context, kernel)
                self.groups.append(groups[context])
            groups[context].replacements.append(replacement)
        for group in self.groups:
            if group.context is not None:
                notify = partial(self._came, group)
                group.context.runner.submit(Action(partial(self._steps, group, notify), notify))
            else:
                group.begun = True
                kernel_task(kernel.loop, self._switch_alone(group), "aiorts reload")
        late: asyncio.Future[None] = kernel.loop.create_future()
        timer = None if self._timeout is None else kernel.call_later(self._timeout, lambda: resolve(late))
        try:
            for group in self.groups:
                waited: list[asyncio.Future[Any]] = [group.came, self.failed, kernel.closing]
                await asyncio.wait([*waited, late], return_when=asyncio.FIRST_COMPLETED)
                if late.done() and group.bounded:
                    await asyncio.wait(waited, return_when=asyncio.FIRST_COMPLETED)
                self.check()
                if not group.came.done():
                    raise TransitionTimeout(f"reload: {group.late(self._timeout)}; nothing was changed")
        finally:
            late.cancel()
            if timer is not None:
                timer.cancel()

    def regroup(self) -> None:
        """Group the instances by their present contexts, to be taken back there, if all are in their places."""
        if not all(group.came.done() and group.came.result() is None for group in self.groups):
            return
        groups: dict[Context | None, Group] = {}
        for group in self.groups:
            for replacement in group.replacements:
                members = cell(replacement.new).members
                context = members[0].context if members else None
                if context not in groups:
                    groups[context] = Group(context, self._kernel)
                    groups[context].came.set_result(None)
                    groups[context].begun, groups[context].passed_on = True, group.passed_on
                groups[context].replacements.append(replacement)
        self.groups = list(groups.values())

    async def _may_enter(self, replacement: Replacement) -> bool:
        """Wait for the end of a call that the old instance serves."""
        lock = cell(replacement.old).entry_lock
        if lock.open:
            return True
        turn: asyncio.Future[bool] = self._kernel.loop.create_future()
        timer = None
        if self._timeout is not None:
            timer = self._kernel.call_later(self._timeout, lambda: None if turn.done() else turn.set_result(False))
        try:
            return await lock.wait(turn)
        finally:
            if timer is not None:
                timer.cancel()

    def check(self) -> None:
        """Raise the failure for which all is to be taken back, or ClosedError when the kernel closes."""
        if self.failure is not None:
            raise self.failure
        if self._kernel.closed:
            raise ClosedError(f"{self._kernel.name}: closes; the reload was given up")

    def _came(self, group: Group, error: BaseException | None) -> None:
        """Note, from any thread, that the instances of a group are in their places, or that they will not be."""
        if error is not None:
            self._kernel.call_on_loop(partial(self.fail, error))
        self.report(group.came, error)

    def fail(self, failure: BaseException) -> None:
        """Take all back, in each context, for this failure; the first one counts."""
        if self.failure is None:
            self.failure = failure
            resolve(self.failed)
            self.go_back()

    def report(self, future: asyncio.Future[BaseException | None], error: BaseException | None) -> None:
        """Resolve a future of the loop, from any thread; a resolved future stays as it is."""
        self._kernel.call_on_loop(lambda: None if future.done() else future.set_result(error))

    def _steps(self, group: Group, notify: Callable[[BaseException | None], None]) -> Steps:
        """The steps that put all instances of a group in place between two cycles, or none."""
        context = group.context
        assert context is not None  # noqa: S101 - only groups with one have steps
        group.begun = True
        error: BaseException | None = ClosedError(f"{context.name}: the context has stopped")
        try:
            for replacement in group.replacements:
                outcome = self.failure
                if outcome is None:
                    outcome = yield from self._take_over(context, replacement)
                if outcome is None:
                    outcome = self.failure
                if outcome is not None:
                    error = outcome
                    for other in reversed(group.replacements):
                        _on_loop(self._kernel, other.undo)
                    return
            _on_loop(self._kernel, partial(self._pass_on, group))
            error = None
        finally:
            notify(error)

    def _take_over(self, context: Context, replacement: Replacement) -> Any:
        old = replacement.old
        member = next((member for member in cell(old).members if member.context is context), None)
        if member is None:
            return StateError(f"{old.name}: left {context.name} while its new code was made ready")
        kind = cell(replacement.new).hook_kinds[_HOOK]
        member.hooks[_HOOK] = max(kind, HookKind.PLAIN), partial(self._enter, replacement)
        if context.suspends and self._timeout is not None:
            replacement.limit(self._timeout)
        error = yield Call(member, _HOOK)
        member.hooks.pop(_HOOK, None)
        replacement.unlimit()
        if error is not None:
            return self._refusal(replacement, error)
        if not replacement.switched:
            return StateError(f"{old.name}: did not come to it")
        replacement.note_handed()
        _on_loop(self._kernel, replacement.end_tasks)
        return None

    def _pass_on(self, group: Group) -> None:
        pass_on_distant_references(self._kernel, {one.old: one.new for one in group.replacements})
        group.passed_on = True

    def pass_back(self, group: Group) -> None:
        """Pass the references back to the old instances."""
        if group.passed_on:
            pass_on_distant_references(self._kernel, {one.new: one.old for one in group.replacements})

    def _enter(self, replacement: Replacement) -> Any:
        """Put a new instance in place; runs instead of a hook of the old one, so no other context is inside."""
        _on_loop(self._kernel, replacement.switch)
        kind = cell(replacement.new).hook_kinds[_HOOK]
        if kind == HookKind.ABSENT:
            return None
        if kind == HookKind.ASYNC or not self._kernel.on_loop_thread():
            _on_loop(self._kernel, replacement.end_tasks)  # they would go on, together with those that it starts itself
        return replacement.new.on_reload(replacement.old)

    def _refusal(self, replacement: Replacement, error: BaseException) -> BaseException:
        if not replacement.switched:
            return error
        return self.blamed(replacement, _HOOK, error)

    def blamed(self, replacement: Replacement, hook: str, error: BaseException) -> ComponentError:
        """The error for a hook of the new code that failed."""
        advice = ""
        if type(error) is AttributeError and hook != _HOOK and error.obj is replacement.new:
            advice = "; a reload runs no on_activated: what is made there is taken over in on_reload(self, old)"
        failure = ComponentError(
            f"{replacement.code.origin}: {replacement.old.name}.{hook} of the new code failed: "
            f"{cause_of(error)}{advice}; the old code is in force again"
        )
        failure.__cause__ = error
        return failure

    async def _switch_alone(self, group: Group) -> None:
        """Put instances that no context runs in their places."""
        error: BaseException | None = None
        for replacement in group.replacements:
            error = self.failure
            if error is None:
                error = await self._take_over_alone(replacement)
            if error is not None:
                for other in group.replacements:
                    other.undo()
                break
        else:
            self._pass_on(group)
        self._came(group, error)

    async def _take_over_alone(self, replacement: Replacement) -> BaseException | None:
        kernel, old, new = self._kernel, replacement.old, replacement.new
        if cell(old).members:
            return StateError(f"{old.name}: came into {old.contexts[0].name} while its new code was made ready")
        lock = cell(old).entry_lock
        if not await self._may_enter(replacement):
            return StateError(f"{old.name}: the call that it serves did not end within {self._timeout} s")
        try:
            replacement.switch()
        except AiortsError as refused:
            replacement.undo()
            lock.pass_on()
            return refused
        lock.inside = Visit(new, _HOOK)
        try:
            budget = None if self._timeout is None else StopBudget(kernel.loop, self._timeout)
            error = await run_alone(kernel, new, _HOOK, budget, old)
        finally:
            lock.inside = None
            lock.pass_on()
        if error is not None:
            return self._refusal(replacement, error)
        replacement.note_handed()
        replacement.end_tasks()
        return None

    def go_back(self) -> None:
        """Put the old instances back; requested at once in each context, so before what follows from a failure."""
        for group in self.groups:
            context = group.context
            if group.back is None and context is not None and any(one.switched for one in group.replacements):
                group.back = self._kernel.loop.create_future()
                notify = partial(self.report, group.back)
                if not context.running or context.runner.stopping:
                    notify(None)
                else:
                    context.runner.submit(Action(partial(self._back_steps, group, notify), notify))

    def _back_steps(self, group: Group, notify: Callable[[BaseException | None], None]) -> Steps:
        try:
            for replacement in reversed(group.replacements):
                lock, members = cell(replacement.new).entry_lock, cell(replacement.new).members
                member = next((member for member in members if member.context is group.context), None)
                # A context that only waits comes in later, and finds the old code.
                if member is not None and lock.inside is not None:
                    member.hooks[_HOOK] = HookKind.PLAIN, partial(_on_loop, self._kernel, replacement.undo)
                    yield Call(member, _HOOK)
                    member.hooks.pop(_HOOK, None)
                _on_loop(self._kernel, replacement.undo)
            _on_loop(self._kernel, partial(self.pass_back, group))
        finally:
            notify(None)


def resolve(future: asyncio.Future[None]) -> None:
    if not future.done():
        future.set_result(None)


def _on_loop(kernel: Microkernel, change: Callable[[], None]) -> None:
    """Do `change` on the kernel's loop, for which a context's thread waits; what it raises is raised here."""
    if kernel.on_loop_thread():
        change()
        return
    done, chance = threading.Event(), [True]
    raised: list[BaseException] = []

    def on_loop() -> None:
        if claimed(chance):
            try:
                change()
            except AiortsError as error:
                raised.append(error)
            finally:
                done.set()

    kernel.call_on_loop(on_loop)
    while not done.wait(_LOOP_PATIENCE):
        if kernel.loop.is_closed() and claimed(chance):
            raise ClosedError("reload: the loop is closed")
    if raised:
        raise raised[0]
