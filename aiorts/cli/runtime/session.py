"""The run of a system to its end, for `aiorts run` and the filters: signals, log and exit status."""

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
from collections.abc import Callable, Coroutine, Mapping, Sequence
from typing import Any, TypeAlias

import click

import aiorts
from aiorts import Catalogue, Connector, Kernel, LifecycleState, ScaledClock, exits
from aiorts.cli.console.report import ADVICE, cause_of
from aiorts.cli.runtime.failures import Failures
from aiorts.cli.runtime.hints import Drops, unawaited_reported, unfed
from aiorts.cli.runtime.log import Log
from aiorts.cli.runtime.options import Options, checked
from aiorts.cli.runtime.stopping import Stopper
from aiorts.cli.runtime.terminal import on_terminal
from aiorts.cli.runtime.watching import Watch
from aiorts.errors import (
    ComponentError,
    ConfigurationError,
    DeclarationError,
    HookAbandoned,
    InvalidNameError,
    PluginError,
    UnknownTypeError,
    WiringError,
)
from aiorts.events import ComponentAdded, ContextStarted, HookFailed
from aiorts.kernel.loop.line_stream import OutputError
from aiorts.kernel.loop.origins import in_brackets, origin_of
from aiorts.late import dataclass
from aiorts.system import Ending, Finding

__all__ = ("Construct", "Options", "Run", "checked", "execute", "log_of", "prepared")

Construct: TypeAlias = Callable[[Kernel], Coroutine[Any, Any, None]]
"""A function that makes the system in a kernel."""
_INITIALIZE_SECONDS = 30.0
"""Seconds for a component's on_initialize; one that hangs is reported then, not waited for without end."""
_FULL = (errno.ENOSPC, errno.EIO)
_FILE_FAULTS = (ConfigurationError, DeclarationError, InvalidNameError, PluginError, UnknownTypeError, WiringError)


def _nothing(_error: BaseException) -> None:
    """Do nothing: the default of `Run.refused`."""


@dataclass(frozen=True, slots=True)
class Run:
    """The parts of one run."""

    construct: Construct
    components: int
    """The number of components; once they exist, the garbage collector runs over them for the last time."""
    options: Options
    stopper: Stopper
    log: Log
    """The run's log, which the caller has entered."""
    catalogue: Catalogue | None = None
    """The catalogue of types for the kernel, or None for the default."""
    unfed_advice: str = ""
    """The advice for a component alone that waits for data which cannot come."""
    streams: tuple[str, ...] = ()
    """The names of the components that are the command's own standard streams."""
    errors: Callable[[], Sequence[Finding]] = tuple
    """The function that finds all errors of the file, called when the system cannot be made."""
    watch: Watch | None = None
    """The watch that applies changes in the files while the system runs, or None."""
    refused: Callable[[BaseException], None] = _nothing
    """Called with the error of a system that cannot be made."""

    def warn(self, code: str, message: str) -> None:
        """Log a warning of the command itself, unless only errors are wanted."""
        if self.log.levels.default <= logging.WARNING:
            self.log.tell(code, message, level="warning")


def prepared(make: Construct, *steps: Callable[[Kernel], None]) -> Construct:
    """Compose a function that makes the system after these steps, each of which gives the kernel a service."""

    async def made(kernel: Kernel) -> None:
        for step in steps:
            step(kernel)
        await make(kernel)

    return made


def execute(run: Run) -> int:
    """Open a kernel, make the system in it and run it to its end; returns the exit status."""
    try:
        with unawaited_reported(run.log.tell) as unawaited:
            status = _run(run)
        return status or (exits.FAILED if unawaited and not run.options.lenient else exits.DONE)
    finally:
        gc.unfreeze()


def log_of(options: Options, stopper: Stopper) -> Log:
    """Make the log of a run; a failed write of a component ends the run, or makes it fail."""
    return Log(options, lambda error: _output_error(error, stopper))


def refuse(log: Log, error: BaseException, found: Sequence[Finding], status: int) -> int:
    """Log why a system cannot be made, with all errors of its file; returns the exit status.

    Args:
        status: the exit status where the file has no error; a component that cannot be constructed is none of the file.
    """
    log.refused(error, found)
    return exits.REFUSED if any(one.code != ComponentError.code for one in found) else status


def _run(run: Run) -> int:
    options = run.options
    if options.simulate:
        from aiorts.testing import simulate

        return int(simulate(_session(run)))
    try:
        return aiorts.run(lambda: _session(run), loop=options.loop)
    except ImportError as error:
        raise click.UsageError(f"--loop {options.loop}: {error}; pip install uvloop, or take --loop auto") from None


async def _session(run: Run) -> int:
    options, stopper = run.options, run.stopper
    clock = None if options.speed is None else ScaledClock(options.speed)
    kernel = Kernel(
        clock=clock,
        debug=options.debug,
        contain_interrupts=True,
        initialize_timeout=_INITIALIZE_SECONDS,
        plugins=run.catalogue,
    )
    status, drops = exits.DONE, None
    left: list[HookFailed] = []

    def note(event: HookFailed) -> None:
        if issubclass(type(event.error), HookAbandoned):
            left.append(event)
        elif issubclass(type(event.error), OutputError):
            stopper.request(exits.FAILED)  # a run that ends by the number of written samples would never end

    kernel.bus.subscribe(HookFailed, note)
    _freeze_when_made(kernel, run.components)
    async with contextlib.AsyncExitStack() as stack:
        await stack.enter_async_context(kernel)
        debugger = stack.enter_context(on_terminal(kernel, options, stopper))
        stopper.attach(kernel)
        run.log.attach(kernel)
        failures, ending = Failures(kernel), Ending(kernel, _tells_slow(kernel, run))
        over = _over(kernel, options.duration)
        stack.callback(over.cancel)
        built, error = await _unless_stopped(kernel, run.construct(kernel), over)
        if error is not None:
            found = run.errors() if isinstance(error, (*_FILE_FAULTS, ComponentError)) else ()
            status = exits.REFUSED if isinstance(error, _FILE_FAULTS) else exits.FAILED
            status = refuse(run.log, error, found, status)
            run.refused(error)
            if debugger is not None:
                debugger.look("", error)
        elif built:
            kernel.registry.mark_assembled()
            gc.freeze()  # the objects of activation; without a collection, since contexts run by now
            may_wait = options.duration is None and not failures.in_error
            if run.unfed_advice and may_wait and (hint := unfed(kernel, run.unfed_advice)):
                run.warn("W-UNFED", hint)
            async with contextlib.nullcontext() if run.watch is None else run.watch.beside(kernel, run.log):
                status = await _until_end(kernel, run, over, ending)
            drops = Drops(kernel)
        elif over.done() and not over.cancelled():
            run.warn("W-START", f"--for {options.duration:g}: over before everything was started; {_not_yet(kernel)}")
        failures.end()
        stopper.watch(_status(kernel, status, error, failures, run))
    every = options.tell_drops or run.log.levels.default <= logging.INFO
    # Where the output failed, its own line says that samples are lost.
    cut_off = stopper.output_failed or stopper.status in (exits.FAILED, exits.BROKEN_PIPE)
    for line in () if drops is None or cut_off else drops.lines(every=every):
        run.warn("W-DROPPED", line)
    _report_failed(failures.in_error, run)
    status = _status(kernel, status, error, failures, run)
    status = status if stopper.status is None else stopper.status
    if left:
        stopper.end_now(status)
    return status


def _freeze_when_made(kernel: Kernel, components: int) -> None:
    """Run the garbage collector once over the objects of the system, before any context runs, then exempt them from it.

    A collection of a million live objects takes 20 ms and more, in which no deadline is met. The process is our own.
    """
    left = components

    def freeze() -> None:
        gc.collect()
        gc.freeze()

    def count(event: ComponentAdded) -> None:
        nonlocal left
        left -= 1
        if left == 0:
            asyncio.get_running_loop().call_soon(freeze)  # not in the observer, whose time is monitored

    kernel.bus.subscribe(ComponentAdded, count)


def _over(kernel: Kernel, duration: float | None) -> asyncio.Future[None]:
    """A future that is done `duration` seconds after the first context runs; making the system does not count."""
    running = asyncio.Event()
    unsubscribe = kernel.bus.subscribe(ContextStarted, lambda _event: running.set())

    async def count() -> None:
        try:
            await running.wait()
        finally:
            unsubscribe()
        if duration is None:
            await asyncio.Event().wait()
        else:
            await kernel.sleep(duration)
            kernel.request_stop(kernel.exit_status)  # from now on contexts that are never idle leave turns for the end

    return asyncio.ensure_future(count())


def _not_yet(kernel: Kernel) -> str:
    names = [name for name, one in kernel.components.items() if LifecycleState.INACTIVE in one.states.values()]
    return f"not active: {', '.join(names[:10]) or 'none'}"


async def _unless_stopped(kernel: Kernel, work: Any, over: asyncio.Future[None]) -> tuple[bool, BaseException | None]:
    """Do the work until a stop is requested or the time is over; returns whether it was done, and its error."""
    doing = asyncio.ensure_future(work)
    stopping = asyncio.ensure_future(kernel.wait_stop_requested())
    await asyncio.wait({doing, stopping, over}, return_when=asyncio.FIRST_COMPLETED)
    done = doing.done()
    if stopping.done():
        over.cancel()  # a slow end must not be reported as a slow start
    for task in (doing, stopping):
        task.cancel()
    await asyncio.wait({doing, stopping}, timeout=2.5)
    error = doing.exception() if doing.done() and not doing.cancelled() else None
    return done and error is None, error


async def _until_end(kernel: Kernel, run: Run, over: asyncio.Future[None], ending: Ending) -> int:
    """Wait until the system ends, or a stop is requested; returns FAILED when samples were lost at the end."""
    finishing = asyncio.ensure_future(ending.wait())
    waiting: set[asyncio.Future[Any]] = {finishing, asyncio.ensure_future(kernel.wait_stop_requested()), over}
    done, _ = await asyncio.wait(waiting, return_when=asyncio.FIRST_COMPLETED)
    for task in waiting - done:
        task.cancel()
    await asyncio.wait(waiting)
    if finishing in done and (unread := finishing.result()):
        names = ", ".join(connector.name for connector in unread)
        run.log.tell("E-UNREAD", f"{names}: the reader left samples unread; it is waited for no longer")
        return exits.FAILED
    return exits.DONE


def _tells_slow(kernel: Kernel, run: Run) -> Callable[[Sequence[Connector]], float | None]:
    """Make the function that reports the connectors still waited for; it returns the longest wait in seconds."""

    def tell(waiting: Sequence[Connector]) -> float | None:
        longest = min((one.patience for one in kernel.services if one.patience is not None), default=None)
        counts = [(one, one.statistics) for one in waiting]
        unread = ", ".join(f"{one.name} {found.buffered + found.in_flight}" for one, found in counts)
        most = "" if longest is None else f", for {longest:.0f} s more at the most"
        what = f"every source has ended, and the run waits until the last samples are read{most}"
        run.warn("W-UNREAD", f"{what}: {unread}; Ctrl-C ends it now")
        return longest

    return tell


def _status(kernel: Kernel, status: int, error: BaseException | None, failures: Failures, run: Run) -> int:
    """The exit status of the run so far; a failure at the end counts as much as an earlier one.

    A run that was refused before its start stays refused, whatever a service reports at its end.
    """
    if error is not None and status == exits.REFUSED:
        return status
    if kernel.exit_status:
        return kernel.exit_status
    failed = failures.in_error
    if failed and error is None and not run.options.lenient:
        return exits.IN_ERROR if any(_is_dead(*one, run) for one in failed.items()) else exits.FAILED
    return status or (exits.FAILED if run.stopper.output_failed or failures.unfinished else exits.DONE)


def _is_dead(name: str, error: BaseException | None, run: Run) -> bool:
    """Whether a component itself failed, not a stream of the command or its output."""
    return name not in run.streams and getattr(error, "code", "") != "E-OUTPUT"


def _report_failed(failed: Mapping[str, BaseException | None], run: Run) -> None:
    """Log again each component that ended in error, if its own line was long ago; not for a component alone."""
    for name, error in failed.items():
        if not run.log.has_failed(name, just_now=run.components > 1):
            cause = "" if error is None else f": {cause_of(error)}{in_brackets(origin_of(error, installed=True))}"
            run.log.tell("E-COMPONENT", f"ended in error{cause}{'' if run.options.debug else ADVICE}", component=name)


def _output_error(error: OSError, stopper: Stopper) -> bool:
    """React to a failed write of a component; returns True when it is not to be logged.

    A reader of standard output that has gone ends the run quietly; a full disk is a failure of the run.
    """
    if isinstance(error, BrokenPipeError) and _reader_has_gone():
        stopper.request(exits.BROKEN_PIPE)
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
