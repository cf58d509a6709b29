"""What is wished of a context: each wish is carried out between two cycles, or withdrawn, and who asked is told which.

Waiting for a wish is for those outside. A hook that waited for its own context, or for one that needs its component,
would wait for itself: its wishes are queued and what becomes of them is logged.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, TypeAlias

from aiorts.errors import ClosedError, StateError, TransitionTimeout
from aiorts.kernel.life import TURN, Action, Done, Steps
from aiorts.kernel.service_visit import visits
from aiorts.kernel.tasks import waiting_driver

if TYPE_CHECKING:
    from aiorts.kernel.context import Context
    from aiorts.kernel.kernel import Kernel
    from aiorts.kernel.member import Member
    from aiorts.model.lifecycle import Event

__all__ = ("Requests", "Wish")

_LOG = logging.getLogger("aiorts.kernel")

Wish: TypeAlias = tuple[str, Callable[[Done], Steps]]
"""What is asked for, in words, and the steps that do it."""


class Requests:
    """The wishes of one context that somebody waits for."""

    __slots__ = ("_context", "_pending")

    def __init__(self, context: Context) -> None:
        self._context = context
        self._pending: dict[_Asked, None] | None = None

    # -- what can be wished for ------------------------------------------------------------------------------------

    def transition(self, member: Member, event: Event) -> Wish:
        """A life-cycle transition of one member."""
        return f"{event} {member.component.name}", partial(self._context._life.request, member, event)

    def joining(self, member: Member) -> Wish:
        """A component joins."""

        def steps(done: Done) -> Steps:
            try:
                # What was true when it was asked for may have changed until its turn came.
                self._context._check_may_join(member.component)
            except StateError as error:
                done(error)
                return
            yield from self._context._life.add(member, done)

        return f"add {member.component.name}", steps

    def leaving(self, member: Member) -> Wish:
        """A component leaves."""
        return f"remove {member.component.name}", partial(self._context._life.remove, member)

    # -- asking ----------------------------------------------------------------------------------------------------

    async def ask(self, kernel: Kernel, wishes: Sequence[Wish], timeout: float | None) -> None:
        """Submit the wishes and wait, at most `timeout` seconds of the kernel's clock, until they are done.

        Raises what became of the first that was not granted. From a hook that would wait for itself: submit only.
        """
        if self.inside():
            for what, steps in wishes:
                logged = _Logged(self._context, what)
                self._context._submit(Action(partial(_after_a_turn, steps, logged), logged))
            return
        asked = self.submit(kernel, wishes)
        try:
            await _settled(kernel, asked, timeout)
        finally:
            for one in asked:
                one.withdraw()
            self.forget(asked)
        for one in asked:
            one.result(self._context.name, timeout)

    def submit(self, kernel: Kernel, wishes: Sequence[Wish]) -> list[_Asked]:
        """Queue the wishes for somebody who waits."""
        asked = [_Asked(what, steps, kernel) for what, steps in wishes]
        if self._pending is None and asked:
            self._pending = {}
        for one in asked:
            self._pending[one] = None  # type: ignore[index] # made above
            self._context._submit(Action(one.steps, one.done))
        return asked

    def forget(self, asked: Sequence[_Asked]) -> None:
        """Nobody waits for these any more."""
        if self._pending is None:
            return
        for one in asked:
            self._pending.pop(one, None)
        if not self._pending:
            self._pending = None

    def close(self) -> None:
        """The context has ended: whatever was not done will not be."""
        pending, self._pending = self._pending, None
        for one in pending or ():
            one.done(ClosedError(f"{self._context.name}: the context has stopped; {one.what} was not done"))

    def inside(self) -> bool:
        """Whether a hook calls that this context would wait for: one of its own, or of a component it shares."""
        task = asyncio.current_task()
        if visits(task, self._context):
            return True
        driver = waiting_driver(task)
        if driver is None:
            return False
        if driver is self._context._driver:
            return True
        member = driver.current
        return member is not None and any(other.context is self._context for other in member.component._rt_members)


def _after_a_turn(steps: Callable[[Done], Steps], done: Done) -> Steps:
    """Hooks that ask for one another's transitions without end must not keep the loop from everything else."""
    yield TURN
    yield from steps(done)


async def _settled(kernel: Kernel, asked: Sequence[_Asked], timeout: float | None) -> None:
    late: asyncio.Future[None] = kernel.loop.create_future()
    timer = None if timeout is None else kernel.call_later(timeout, partial(_resolve, late))
    try:
        for one in asked:
            either: list[asyncio.Future[Any]] = [one.future, late]
            await asyncio.wait(either, return_when=asyncio.FIRST_COMPLETED)
    finally:
        late.cancel()
        if timer is not None:
            timer.cancel()


def _resolve(future: asyncio.Future[None]) -> None:
    if not future.done():
        future.set_result(None)


class _Asked:
    """One wish of somebody who waits for it."""

    __slots__ = ("_chance", "_kernel", "_wish", "_withdrawn", "future", "what")

    def __init__(self, what: str, wish: Callable[[Done], Steps], kernel: Kernel) -> None:
        self.what = what
        self._wish = wish
        self._kernel = kernel
        self._chance = [True]
        self._withdrawn = False
        self.future: asyncio.Future[BaseException | None] = kernel.loop.create_future()

    def steps(self) -> Steps:
        """The steps, unless the one who asked has gone."""
        if self._claim():
            yield from self._wish(self.done)

    def _claim(self) -> bool:
        """True for the first who asks, be it the one who begins or the one who withdraws, from whatever thread."""
        try:
            return self._chance.pop()
        except IndexError:
            return False

    def done(self, error: BaseException | None) -> None:
        """From whatever thread."""
        self._kernel._on_loop(lambda: None if self.future.done() else self.future.set_result(error))

    def withdraw(self) -> None:
        """It is not waited for any more; what has not begun will not begin."""
        self._withdrawn = self._claim()

    def result(self, context: str, timeout: float | None) -> None:
        """Raise what became of it."""
        if not self.future.done():
            how = "it was withdrawn" if self._withdrawn else "it has begun and may still end"
            raise TransitionTimeout(f"{context}: {self.what} did not take effect within {timeout} s; {how}")
        error = self.future.result()
        if error is not None:
            raise error


class _Logged:
    """Who is told of a wish that nobody waits for."""

    def __init__(self, context: Context, what: str) -> None:
        self._context = context
        self._what = what

    def __call__(self, error: BaseException | None) -> None:
        if error is not None:
            _LOG.warning("%s: queued request to %s failed: %s", self._context.name, self._what, error)
