"""Running a system to its end: what `aiorts run` and the filters have in common, signals, log and exit status."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import gc
import logging
import os
import select
import stat
import sys
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from typing import Any, TypeAlias

import click

import aiorts
from aiorts import Catalogue, Component, Composite, Kernel, LifeCycleState, ScaledClock
from aiorts.cli.hints import dropped, unawaited_told, unfed
from aiorts.cli.log import Log
from aiorts.cli.options import Options, checked
from aiorts.cli.report import cause_of
from aiorts.cli.stopping import Stopper
from aiorts.cli.terminal import on_terminal
from aiorts.cli.watched import Watched
from aiorts.errors import (
    ConfigurationError,
    DeclarationError,
    HookAbandoned,
    InvalidNameError,
    PluginError,
    UnknownTypeError,
    WiringError,
)
from aiorts.events import ComponentAdded, ContextStarted, HookFailed
from aiorts.system import wait_finished

__all__ = ("Construct", "Options", "checked", "execute", "log_of")

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
class _Run:
    """What belongs to one run."""

    construct: Construct
    components: int
    options: Options
    stopper: Stopper
    log: Log
    catalogue: Catalogue | None
    unfed_advice: str
    watched: Watched | None

    def warn(self, code: str, message: str) -> None:
        """A line of the command itself, unless only errors are asked for."""
        if self.log.levels.default <= logging.WARNING:
            self.log.tell(code, message, level="warning")


def execute(
    construct: Construct,
    components: int,
    options: Options,
    stopper: Stopper,
    *,
    log: Log | None = None,
    catalogue: Catalogue | None = None,
    unfed_advice: str = "",
    watched: Watched | None = None,
) -> int:
    """Open a kernel, have the system made in it, run it to its end; the exit status.

    Args:
        components: how many there will be: once they are there the garbage collector looks at them for the last time.
        log: the run's log, which its caller has begun; by default it has one of its own.
        catalogue: where the kernel has types from that are asked for by name.
        unfed_advice: for a component alone, what to do when it waits for data that cannot come.
        watched: who watches the run, in real time.
    """
    with contextlib.ExitStack() as stack:
        if log is None:
            log = stack.enter_context(log_of(options, stopper))
        try:
            run = _Run(
                construct,
                components,
                options,
                stopper,
                log,
                catalogue,
                unfed_advice,
                None if options.simulate else watched,
            )
            with unawaited_told(run.warn):
                return _run(run)
        finally:
            gc.unfreeze()


def log_of(options: Options, stopper: Stopper) -> Log:
    """The log of a run; what a component could not write ends it, or makes it fail."""
    return Log(options, lambda error: _output_error(error, stopper))


def _run(run: _Run) -> int:
    options = run.options
    if options.simulate:
        from aiorts.testing import simulate

        return int(simulate(_session(run)))
    try:
        return aiorts.run(lambda: _session(run), loop=options.loop)
    except ImportError as error:
        raise click.UsageError(f"--loop {options.loop}: {error}; pip install uvloop, or take --loop auto") from None


async def _session(run: _Run) -> int:
    options, stopper = run.options, run.stopper
    clock = None if options.speed is None else ScaledClock(options.speed)
    kernel = Kernel(clock=clock, debug=options.debug, contain_interrupts=True, plugins=run.catalogue)
    status = 0
    left: list[HookFailed] = []
    unfinished: list[HookFailed] = []

    def note(event: HookFailed) -> None:
        if event.hook == "on_finalize":
            unfinished.append(event)  # what it was to do in the end was not done
        if isinstance(event.error, HookAbandoned):
            left.append(event)

    kernel.bus.subscribe(HookFailed, note)
    _freeze_when_made(kernel, run.components)
    async with contextlib.AsyncExitStack() as stack:
        await stack.enter_async_context(kernel)
        debugger = stack.enter_context(on_terminal(kernel, options, stopper))
        stopper.attach(kernel)
        run.log.attach(kernel)
        if run.watched is not None:
            run.watched.begin(kernel)
        over = _over(kernel, options.duration)
        stack.callback(over.cancel)
        built, error = await _unless_stopped(kernel, run.construct(kernel), over)
        if error is not None:
            run.log.failed(error)
            if debugger is not None:
                debugger.look("", error)
            status = 2 if isinstance(error, _FAULTS_OF_THE_FILE) else 1
        elif built:
            gc.freeze()  # what activation made; without a collection, since contexts run by now
            if run.watched is not None:
                run.watched.made(kernel)
            if run.unfed_advice and options.duration is None and (hint := unfed(kernel, run.unfed_advice)):
                run.warn("W-UNFED", hint)
            status = await _until_end(kernel, run, over)
            for line in dropped(kernel, every=options.tell_drops or run.log.levels.default <= logging.INFO):
                run.warn("W-DROPPED", line)
        elif over.done() and not over.cancelled():
            run.warn("W-START", f"--for {options.duration:g}: over before everything was started; {_not_yet(kernel)}")
        failed = _failed(kernel)
        if failed and status == 0 and options.strict:
            status = 3
        stopper.watch(status or kernel.exit_status)
    _tell_failed(failed, run)
    status = kernel.exit_status or status or int(stopper.output_failed or bool(unfinished))
    status = status if stopper.status is None else stopper.status
    if left:
        stopper.end_now(status)
    return status


def _freeze_when_made(kernel: Kernel, components: int) -> None:
    """Have the garbage collector look once at what the system is made of, before any context runs, and never again.

    A collection of a million live objects takes 20 ms and more, in which no deadline is met. The process is ours.
    """
    left = components

    def freeze() -> None:
        gc.collect()
        gc.freeze()

    def count(event: ComponentAdded) -> None:
        nonlocal left
        left -= 1
        if left == 0:
            asyncio.get_running_loop().call_soon(freeze)  # not an observer's time, which is looked at

    kernel.bus.subscribe(ComponentAdded, count)


def _over(kernel: Kernel, duration: float | None) -> asyncio.Future[None]:
    """Done `duration` seconds after the first context runs: what a start waits for counts, what is made before not."""
    running = asyncio.Event()
    unsubscribe = kernel.bus.subscribe(ContextStarted, lambda _event: running.set())

    async def count() -> None:
        try:
            await running.wait()
        finally:
            unsubscribe()
        await (asyncio.Event().wait() if duration is None else kernel.sleep(duration))

    return asyncio.ensure_future(count())


def _not_yet(kernel: Kernel) -> str:
    names = [name for name, one in kernel.components.items() if LifeCycleState.INACTIVE in one.states.values()]
    return f"not active: {', '.join(names[:10]) or 'none'}"


async def _unless_stopped(kernel: Kernel, work: Any, over: asyncio.Future[None]) -> tuple[bool, BaseException | None]:
    """Whether the work was done before the end was asked for or the time was over, and what it raised."""
    doing = asyncio.ensure_future(work)
    stopping = asyncio.ensure_future(kernel.wait_stop_requested())
    await asyncio.wait({doing, stopping, over}, return_when=asyncio.FIRST_COMPLETED)
    done = doing.done()
    if stopping.done():
        over.cancel()  # that the end takes a while is not told as a start that did
    for task in (doing, stopping):
        task.cancel()
    await asyncio.wait({doing, stopping}, timeout=2.5)
    error = doing.exception() if doing.done() and not doing.cancelled() else None
    return done and error is None, error


async def _until_end(kernel: Kernel, run: _Run, over: asyncio.Future[None]) -> int:
    """Wait until it ends, or is to end; 1 when samples were lost at its end."""
    finishing = asyncio.ensure_future(wait_finished(kernel))
    waiting: set[asyncio.Future[Any]] = {finishing, asyncio.ensure_future(kernel.wait_stop_requested()), over}
    done, _ = await asyncio.wait(waiting, return_when=asyncio.FIRST_COMPLETED)
    for task in waiting - done:
        task.cancel()
    await asyncio.wait(waiting)
    if finishing in done and (unread := finishing.result()):
        names = ", ".join(connector.name for connector in unread)
        run.log.tell("E-UNREAD", f"{names}: the reader left samples unread for a second; it is waited for no longer")
        return 1
    return 0


def _failed(kernel: Kernel) -> list[Component]:
    """Of a composite its members are told."""
    those = [c for c in kernel.components.values() if not isinstance(c, Composite)]
    return [c for c in those if LifeCycleState.ERROR in c.states.values()]


def _tell_failed(components: list[Component], run: _Run) -> None:
    """Name each that ended in error once more, if its own line was long ago."""
    for component in components:
        if not run.log.failed_just_now(component.name):
            cause = "" if component.last_error is None else f": {cause_of(component.last_error)}"
            advice = "" if run.options.strict else "; --strict makes the exit status 3"
            run.log.tell("E-COMPONENT", f"ended in error{cause}{advice}", component=component.name)


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
