"""The dump at SIGUSR1: the stacks of all threads, the state of the system, the tasks; it changes nothing.

The interpreter itself prints the stacks at once, whatever blocks it. The rest follows when Python runs again, between
two instructions of the running code. The dump takes no lock, so the figures of a connector in use at this moment may
be inconsistent.
"""

from __future__ import annotations

import asyncio
import contextlib
import faulthandler
import io
import os
import signal
import sys
import threading
from collections.abc import Iterable, Iterator, Mapping
from types import FrameType
from typing import TYPE_CHECKING, Any

from aiorts.cli.console.report import printed
from aiorts.kernel.execution.member import overdue_hooks
from aiorts.kernel.loop.origins import place
from aiorts.kernel.ports.connector import transport_of
from aiorts.kernel.service import reports
from aiorts.model.lifecycle import state_text
from aiorts.model.plain import plain
from aiorts.model.timing import Spans

if TYPE_CHECKING:
    from aiorts import Component, Connector, Context, Kernel


def dump(kernel: Kernel | None, loop: asyncio.AbstractEventLoop | None) -> None:
    """Write the state to the descriptor of standard error, not its stream: the signal may have interrupted a write."""
    lines = [*_thread_stacks(), *(state_of(kernel) if kernel is not None else ["no system runs yet"])]
    if loop is not None:
        lines += _tasks(loop)
    data = "".join(f"aiorts: {printed(line)}\n" for line in lines).encode("utf-8", "backslashreplace")
    with contextlib.suppress(OSError, ValueError, AttributeError):
        descriptor = sys.stderr.fileno()
        while data:
            data = data[os.write(descriptor, data) :]


@contextlib.contextmanager
def dumping_stacks() -> Iterator[None]:
    """Let the interpreter print every thread's stack at SIGUSR1, before Python's own handler is called."""
    try:
        if not hasattr(faulthandler, "register"):
            raise ValueError
        faulthandler.register(signal.SIGUSR1, sys.stderr, all_threads=True, chain=True)
    except (OSError, ValueError, AttributeError, RuntimeError):  # no such signal, or no real standard error
        yield
        return
    try:
        yield
    finally:
        faulthandler.unregister(signal.SIGUSR1)


def state_of(kernel: Kernel) -> list[str]:
    """The components, contexts, connectors and services of a kernel, a line each."""
    return [
        repr(kernel),
        *map(_component, tuple(kernel.components.values())),
        *map(_context, tuple(kernel.contexts.values())),
        *(_connector(kernel, connector) for connector in tuple(kernel.connectors.values())),
        *(f"service {name}: {_listed(told)}" for name, told in reports(kernel.services).items()),
    ]


def _listed(told: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} {value}" for name, value in told.items())


def _component(component: Component) -> str:
    said = {context: f"{state} in {context}" for context, state in component.states.items()}
    states = state_text(said, plain(overdue_hooks(component)))
    error = component.last_error
    last = "" if error is None else f"; last error {type(error).__name__}: {error}"
    return f"component {component.name} ({type(component).__name__}): {states}{last}"


def _context(context: Context) -> str:
    figures = context.statistics
    rate = "" if context.rate is None else f" {context.rate:g} Hz"
    late = (
        ""
        if not figures.policy
        else f", {figures.overruns} overruns, {figures.skipped} ticks left out, "
        f"late {figures.lateness_max_ns / 1e6:.3f} ms at worst"
    )
    blame = "" if figures.last_blame is None else f"; last blame: {figures.last_blame}"
    return f"context {context.name} ({context.kind}{rate}): {figures.cycles} cycles{late}{blame}"


def _connector(kernel: Kernel, connector: Connector) -> str:
    transport = transport_of(connector)
    written, buffered, dropped = transport.glance()
    drops = ", ".join(f"{count} dropped {reason}" for reason, count in dropped.items()) or "0 dropped"
    delivered = written - buffered - sum(dropped.values())
    how = "sent" if connector.in_.is_far else "delivered"
    counts = f"{written} written, {delivered} {how}, {buffered} buffered, {drops}"
    times = transport.times
    measured = "" if times is None else f"{_spans('latency', times.latencies)}{_spans('age', times.ages)}"
    silent = "; its writer is silent" if kernel.connections.gaps.is_silent(connector) else ""
    return f"connector {connector.name}: {counts}{measured}{silent}"


def _spans(what: str, spans: Iterable[int]) -> str:
    measured = Spans.of(tuple(spans))
    if not measured.count:
        return ""
    return f", {what} {measured.p50_ns / 1e6:.3f} ms (median), {measured.max_ns / 1e6:.3f} ms at worst"


def _thread_stacks() -> Iterable[str]:
    """The names of the threads in the stacks above."""
    for thread in threading.enumerate():
        if thread.ident is not None:
            yield f"thread 0x{thread.ident:016x} is {thread.name}"


def _tasks(loop: asyncio.AbstractEventLoop) -> Iterable[str]:
    try:
        tasks = asyncio.all_tasks(loop)
        running = asyncio.current_task(loop)
    except RuntimeError:  # the set of tasks changes too fast
        return
    for task in sorted(tasks, key=lambda task: task.get_name()):
        if task is running:
            yield f"task {task.get_name()}: runs now, in the main thread"
            continue
        text = io.StringIO()
        task.print_stack(file=text, limit=5)
        lines = [line.strip() for line in text.getvalue().splitlines()[1:]]
        yield f"task {task.get_name()}: {' | '.join(lines) or 'not begun'}"


def where_now() -> str:
    """A text with the line that the main thread runs; empty when it waits for events."""
    found = _outside(sys._current_frames().get(threading.main_thread().ident or 0))
    if found is None:
        return ""
    return f": {place(found.f_code.co_filename, found.f_lineno)}, in {found.f_code.co_name} still runs"


def _outside(frame: FrameType | None) -> FrameType | None:
    """The innermost frame of a component's code, or None."""
    while frame is not None:
        name: Any = frame.f_globals.get("__name__") or ""
        top = str(name).partition(".")[0]
        if top not in sys.stdlib_module_names and top not in ("aiorts", "uvloop", "click", "__main__", "anyio"):
            return frame
        frame = frame.f_back
    return None
