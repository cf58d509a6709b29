"""Operations on lifecycles, and on the run as a whole."""

from __future__ import annotations

from typing import Final

from aiorts.control.operation import Operation, Right
from aiorts.control.session import Session
from aiorts.control.values import Done, Member, Stop


async def _activate(session: Session, given: Member) -> Done:
    await session.kernel.activate(given.component, context=given.context, timeout=given.timeout)
    return Done()


async def _deactivate(session: Session, given: Member) -> Done:
    await session.kernel.deactivate(given.component, context=given.context, timeout=given.timeout)
    return Done()


async def _reset(session: Session, given: Member) -> Done:
    await session.kernel.reset(given.component, context=given.context, timeout=given.timeout)
    return Done()


def _stop(session: Session, given: Stop) -> Done:
    session.kernel.request_stop(given.status)
    return Done()


def _one(given: Member, _: Done) -> tuple[str]:
    return (given.component,)


ROWS: Final = (
    Operation("activate", "Activate a component.", Member, Done, Right.OPERATE, _activate, changes=_one),
    Operation("deactivate", "Deactivate a component.", Member, Done, Right.OPERATE, _deactivate, changes=_one),
    Operation("reset", "Take a component out of error.", Member, Done, Right.OPERATE, _reset, changes=_one),
    Operation("stop", "End the run in order.", Stop, Done, Right.OPERATE, _stop, idempotent=True),
)
