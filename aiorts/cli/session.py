"""Running a system to its end: what `aiorts run` and the filters have in common, signals, log and exit status."""

from __future__ import annotations

import asyncio
import errno
import gc
import logging
import os
import select
import stat
import sys
from collections.abc import Callable, Coroutine
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import click

import aiorts
from aiorts import ComponentAdded, HookFailed, Kernel, LifeCycleState, ScaledClock
from aiorts.cli.report import LineHandler, report, report_error
from aiorts.cli.stopping import Stopper
from aiorts.errors import (
    ConfigurationError,
    DeclarationError,
    HookAbandoned,
    InvalidNameError,
    PluginError,
    UnknownTypeError,
    WiringError,
)
from aiorts.system import ClockEntry, wait_finished

__all__ = ("Construct", "Logging", "Options", "checked", "execute", "with_clock")

Construct: TypeAlias = Callable[[Kernel], Coroutine[Any, Any, None]]
"""Makes the system in a kernel."""
_BROKEN_PIPE = 141
_FULL = (errno.ENOSPC, errno.EIO)
_FAULTS_OF_THE_FILE = (
    ConfigurationError,
    DeclarationError,
    InvalidNameError,
    PluginError,
    UnknownTypeError,
    WiringError,
)


@dataclass(frozen=True, slots=True)
class Options:
    """How a system is run."""

    loop: str
    duration: float | None
    verbose: bool
    debug: bool
    simulate: bool = False
    speed: float | None = None
    strict: bool = False


def checked(options: Options) -> Options:
    """The options, or click's error for one that has no meaning."""
    for name in ("speed", "duration"):
        value = getattr(options, name)
        if value is not None and not 0.0 < value < float("inf"):
            raise click.BadParameter(f"{value!r}: expected a number above 0", param_hint=f"--{name}")
    if options.simulate and options.speed is not None:
        raise click.UsageError("--speed has no meaning with --simulate, which runs as fast as it can")
    return options


def with_clock(options: Options, clock: ClockEntry) -> Options:
    """The options with the clock of a system file, where the command line says nothing of it."""
    if options.simulate or options.speed is not None:
        return options
    return replace(options, simulate=clock.kind == "simulated", speed=clock.speed)


def execute(construct: Construct, components: int, options: Options, stopper: Stopper) -> int:
    """Open a kernel, have the system made in it, run it to its end; the exit status.

    Args:
        components: how many there will be: once they are there the garbage collector looks at them for the last time.
    """
    with Logging(options, stopper):
        try:
            return _run(construct, components, options, stopper)
        finally:
            gc.unfreeze()


def _run(construct: Construct, components: int, options: Options, stopper: Stopper) -> int:
    if options.simulate:
        from aiorts.testing import simulate

        return int(simulate(_session(construct, components, options, stopper)))
    try:
        return aiorts.run(lambda: _session(construct, components, options, stopper), loop=options.loop)
    except ImportError as error:
        raise click.UsageError(f"--loop {options.loop}: {error}; pip install uvloop, or take --loop auto") from None


async def _session(construct: Construct, components: int, options: Options, stopper: Stopper) -> int:
    clock = None if options.speed is None else ScaledClock(options.speed)
    kernel = Kernel(clock=clock, debug=options.debug, contain_interrupts=True)
    status = 0
    left: list[HookFailed] = []

    def note(event: HookFailed) -> None:
        if isinstance(event.error, HookAbandoned):
            left.append(event)

    kernel.bus.subscribe(HookFailed, note)
    _freeze_when_made(kernel, components)
    async with kernel:
        stopper.attach(kernel)
        built, error = await _unless_stopped(kernel, construct(kernel))
        if error is not None:
            report_error(error, verbose=options.verbose or options.debug)
            status = 2 if isinstance(error, _FAULTS_OF_THE_FILE) else 1
        elif built:
            gc.freeze()  # what activation made; without a collection, since contexts run by now
            await _until_end(kernel, options)
        if status == 0 and options.strict and _in_error(kernel):
            status = 3
        stopper.watch(status or kernel.exit_status)
    status = kernel.exit_status or status or int(stopper.output_failed)
    status = status if stopper.status is None else stopper.status
    if left:
        stopper.end_now(status)
    return status


def _freeze_when_made(kernel: Kernel, components: int) -> None:
    """Have the garbage collector look once at what the system is made of, before any context runs, and never again.

    A collection of a million live objects takes 20 ms and more, in which no deadline is met. The process is ours.
    """
    left = components

    def count(event: ComponentAdded) -> None:
        nonlocal left
        left -= 1
        if left == 0:
            gc.collect()
            gc.freeze()

    kernel.bus.subscribe(ComponentAdded, count)


async def _unless_stopped(kernel: Kernel, work: Any) -> tuple[bool, BaseException | None]:
    """Whether the work was done before somebody asked for the end, and what it raised."""
    doing = asyncio.ensure_future(work)
    stopping = asyncio.ensure_future(kernel.wait_stop_requested())
    await asyncio.wait({doing, stopping}, return_when=asyncio.FIRST_COMPLETED)
    done = doing.done()
    for task in (doing, stopping):
        task.cancel()
    await asyncio.wait({doing, stopping}, timeout=2.5)
    error = doing.exception() if doing.done() and not doing.cancelled() else None
    return done and error is None, error


async def _until_end(kernel: Kernel, options: Options) -> None:
    finishing = asyncio.ensure_future(wait_finished(kernel))
    waiting = {finishing, asyncio.ensure_future(kernel.wait_stop_requested())}
    if options.duration is not None:
        waiting.add(asyncio.ensure_future(kernel.sleep(options.duration)))
    done, _ = await asyncio.wait(waiting, return_when=asyncio.FIRST_COMPLETED)
    for task in waiting - done:
        task.cancel()
    await asyncio.wait(waiting)
    if finishing in done and (unread := finishing.result()):
        names = ", ".join(connector.name for connector in unread)
        report("E-UNREAD", f"{names}: the reader left samples unread for a second; it is not waited for any longer")


def _in_error(kernel: Kernel) -> bool:
    return any(LifeCycleState.ERROR in component.states.values() for component in kernel.components.values())


class Logging:
    """The logging of this command while it runs: lines on standard error, and nothing of it left afterwards."""

    def __init__(self, options: Options, stopper: Stopper) -> None:
        verbose = options.verbose or options.debug
        self._handler = LineHandler(verbose=verbose, on_output_error=lambda error: _output_error(error, stopper))
        self._level = logging.DEBUG if options.debug else logging.INFO if options.verbose else logging.WARNING

    def __enter__(self) -> None:
        root = logging.getLogger()
        self._before = root.level
        root.addHandler(self._handler)
        root.setLevel(self._level)

    def __exit__(self, *error: object) -> None:
        root = logging.getLogger()
        root.removeHandler(self._handler)
        root.setLevel(self._before)


def _output_error(error: OSError, stopper: Stopper) -> bool:
    """What is to be done when a component could not write; True when there is nothing to say of it.

    A reader of standard output that has gone ends the run quietly; a full disk is a failure of the run.
    """
    if isinstance(error, BrokenPipeError) and _reader_has_gone():
        stopper.request(_BROKEN_PIPE)
        return True
    if error.errno in _FULL and error.filename is None:
        stopper.output_failed = True
    return False


def _reader_has_gone() -> bool:
    if sys.stdout is None:
        return False
    try:
        descriptor = sys.stdout.fileno()
        if not hasattr(select, "poll"):
            return True
        if not (stat.S_ISFIFO(os.fstat(descriptor).st_mode) or stat.S_ISSOCK(os.fstat(descriptor).st_mode)):
            return False
    except (OSError, ValueError):
        return True
    poll = select.poll()
    poll.register(descriptor, select.POLLOUT)
    return any(events & (select.POLLERR | select.POLLHUP) for _, events in poll.poll(0))
