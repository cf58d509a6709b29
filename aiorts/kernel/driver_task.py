"""The task of a context, which knows what a cancellation by somebody else means, and its way into a component.

Whoever cancels it: the host, then the context stops in order; a scope or a task of the hook that runs, then it is the
hook's affair; between hooks there is nothing to cancel.
"""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from typing import TYPE_CHECKING, Any

from aiorts.kernel.tasks import current_task, owner_of
from aiorts.kernel.verdict import not_let_in

if TYPE_CHECKING:
    from aiorts.kernel.bulkhead import TaskDriver
    from aiorts.kernel.member import Member

__all__ = ("DriverTask", "wait_for_turn")


class DriverTask(asyncio.Task[None]):
    """The task of a context: it knows what a cancellation by somebody else means."""

    __slots__ = ("_aiorts_driver",)

    def __init__(self, driver: TaskDriver, life: Coroutine[Any, Any, None]) -> None:
        self._aiorts_driver = driver
        super().__init__(life, loop=driver.loop, name=f"aiorts {driver.context.name}")

    def cancel(self, msg: Any | None = None) -> bool:
        """By the host, or because the loop is torn down: the context stops in order. Else it is the hook's affair."""
        driver = self._aiorts_driver
        caller = current_task()
        # A scope entered in the hook is the hook's affair, whoever ends it: anyio says so in the message.
        by_scope = isinstance(msg, str) and "cancel scope" in msg
        by_host = not driver.loop.is_running() or (caller is not None and owner_of(caller) is None and not by_scope)
        if by_host:
            driver.stop_for_host()
        if driver.current is None:
            # Between hooks there is nothing that a component could want to cancel.
            return by_host
        driver.beware_of_cancellation()
        return super().cancel(msg)

    def cancel_hook(self) -> None:
        """The watch's cancellation."""
        super().cancel()


async def wait_for_turn(driver: TaskDriver, member: Member, hook: str) -> BaseException | None:
    """Another context is inside the component: wait for it; while this one stops, no longer than it may."""
    turn = driver.turn = driver.loop.create_future()
    timer = None
    if driver.budget is not None:
        timer = driver.loop.call_later(driver.budget.limit, resolve, turn, False)
    try:
        if await member.gate.wait(turn):
            return None
    finally:
        driver.turn = None
        if timer is not None:
            timer.cancel()
    return not_let_in(member, hook)


def resolve(future: asyncio.Future[bool], outcome: bool) -> None:
    """Unless it has an outcome already."""
    if not future.done():
        future.set_result(outcome)
