"""What becomes of a hook that did not simply return: its error, or nothing; this file only decides and words."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from aiorts.errors import HookAbandoned, HookTimeout

if TYPE_CHECKING:
    from aiorts.kernel.member import Member
    from aiorts.kernel.watch import Watch

__all__ = ("judged", "left_behind", "not_let_in")


def judged(
    member: Member, hook: str, error: BaseException | None, watch: Watch | None, *, wanted: bool
) -> BaseException | None:
    """The error of a hook that raised or was cancelled by its watch; `wanted`: the host wanted its cancellation."""
    if watch is None or not watch.cancels:
        return None if wanted and isinstance(error, asyncio.CancelledError) else error
    where = f"{member.component.name}.{hook}"
    if watch.stopping and error is None:
        return None
    if error is not None and not isinstance(error, asyncio.CancelledError):
        return error
    late = HookTimeout(
        f"{where}: still ran when the time its context had to stop was over; it was cancelled"
        if watch.stopping
        else f"{where}: did not return within {watch.limit} s; it was cancelled"
    )
    late.__cause__ = error
    return late


def left_behind(member: Member, hook: str, cancels: int) -> BaseException:
    """The error of a hook that ignored every cancellation."""
    return HookAbandoned(
        f"{member.component.name}.{hook}: ignored {cancels} cancellations; it was left behind and never runs again"
    )


def not_let_in(member: Member, hook: str) -> BaseException:
    """The error of a hook that did not run, since another context was in its component too long."""
    inside = member.gate.inside
    where = "another context" if inside is None else inside.where
    return HookTimeout(f"{member.component.name}.{hook}: did not run: the component was busy in {where}")
