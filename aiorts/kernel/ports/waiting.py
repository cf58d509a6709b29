"""Waiting for several in-ports at once."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from typing import Any, TypeVar

from aiorts.errors import ConfigurationError, ReadTimeout
from aiorts.kernel.ports.in_port import InPort, receiver_of
from aiorts.kernel.ports.port import UNSUSPENDED, give_turn
from aiorts.model.values import shown

T = TypeVar("T")


class Looking(asyncio.Future[None]):
    """The future of a task that waits for a sample without taking it: a writer hands no sample to such a task."""


async def wait_any(*ports: InPort[Any], timeout: float | None = None) -> tuple[InPort[Any], ...]:
    """The ports with unread data, in the order of the arguments; waits for a sample while no port has one.

    No sample is taken. `timeout` is in seconds of the kernel's clock; 0 checks once, None waits forever. A cancelled
    wait changes nothing.

    Raises:
        ReadTimeout: no sample arrived in time.
        BusyError: another task waits on one of the ports.
        ClosedError: one of the ports was removed, and no other has data.
        ConfigurationError: no port is given, one is no in-port of a component, or `timeout` is no number of seconds.
        ThreadError: called in another thread than that of the kernel's loop.
    """
    ports = _checked(ports)

    def ready() -> tuple[InPort[Any], ...] | None:
        return tuple(port for port in ports if port.is_new) or None

    return await wait_until(ports, ready, "wait_any", "no sample", timeout)


async def wait_until(
    ports: tuple[InPort[Any], ...], look: Callable[[], T | None], where: str, missing: str, timeout: float | None
) -> T:
    """The first result of `look` that is not None; `look` is called at once and whenever a sample comes to a port.

    `where` and `missing` are for messages. For the rest see `wait_any`.
    """
    limit = _limit(where, timeout)
    for port in ports:
        port._bound().check_loop_thread(f"{port.path}: {where}")
    host = ports[0]._bound()
    turns = ports[0]._turns
    if turns.left:
        turns.left -= 1
    else:
        turns.left = UNSUSPENDED
        await give_turn()
    waiter = Looking(loop=host.loop)
    over = limit == 0

    def expire() -> None:
        nonlocal over
        over = True
        if not waiter.done():
            waiter.set_result(None)

    timer = None if over or limit is None else host.call_later(limit, expire)
    try:
        while (found := look()) is None:
            for port in ports:
                port._open_host()
            if over:
                _gave_up(ports)
                names = ", ".join(port.path for port in ports)
                raise ReadTimeout(f"{names}: {missing} within {timeout} s")
            waiter = Looking(loop=host.loop)
            await _first(ports, waiter)
    finally:
        if timer is not None:
            timer.cancel()
    return found


async def _first(ports: tuple[InPort[Any], ...], waiter: asyncio.Future[None]) -> None:
    """Return at once if a port has a sample; else wait until one gets a sample or is removed, or `waiter` is done."""
    try:
        there = False
        for port in ports:
            there = receiver_of(port).stand_by(waiter) or there
        if not there:
            await waiter
    except asyncio.CancelledError:
        _gave_up(ports)
        raise
    finally:
        for port in ports:
            receiver_of(port).stand_down(waiter)


def _gave_up(ports: tuple[InPort[Any], ...]) -> None:
    for port in ports:
        receiver_of(port).gave_up()


def _checked(ports: tuple[object, ...]) -> tuple[InPort[Any], ...]:
    """The ports, checked and without repetition."""
    found: dict[InPort[Any], None] = {}
    for port in ports:
        if not isinstance(port, InPort):
            raise ConfigurationError(f"wait_any: {shown(port)}: expected in-ports of components, such as self.command")
        found[port] = None
    if not found:
        raise ConfigurationError("wait_any: no in-port given; give at least one, such as wait_any(self.command)")
    return tuple(found)


def _limit(where: str, timeout: object) -> float | None:
    if timeout is None:
        return None
    if isinstance(timeout, bool) or not isinstance(timeout, int | float) or not timeout >= 0:
        raise ConfigurationError(f"{where}: timeout = {shown(timeout)}: expected seconds, 0 or more, or None")
    return None if timeout == math.inf else timeout
