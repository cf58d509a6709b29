"""The terminal of a run besides its lines: the status line, and the debugger where a component failed."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING

from aiorts import LifecycleState
from aiorts.cli.runtime import status
from aiorts.events import StateChanged

if TYPE_CHECKING:
    from aiorts import Kernel
    from aiorts.cli.runtime.options import Options
    from aiorts.cli.runtime.postmortem import PostMortem
    from aiorts.cli.runtime.stopping import Stopper


@contextlib.contextmanager
def on_terminal(kernel: Kernel, options: Options, stopper: Stopper) -> Iterator[PostMortem | None]:
    """Show the status line while a system runs; yields the debugger where one is wanted. On the kernel's loop."""
    with contextlib.ExitStack() as stack:
        quietly: Callable[[], AbstractContextManager[object]] = contextlib.nullcontext
        # A run in virtual time is over too soon for a status line.
        if options.status and not options.simulate and status.is_wanted():
            line = stack.enter_context(status.StatusLine(kernel))
            stopper.last_words.append(line.erase)
            quietly = line.paused
        debugger = _debugger(options, stopper, quietly)
        if debugger is not None:
            stack.callback(_watch(kernel, debugger))
        yield debugger


def _debugger(
    options: Options, stopper: Stopper, quietly: Callable[[], AbstractContextManager[object]]
) -> PostMortem | None:
    if not (options.debug and options.post_mortem):
        return None
    from aiorts.cli.runtime.postmortem import PostMortem, is_possible

    if not is_possible():
        return None
    debugger = PostMortem(quietly)
    stopper.last_words.append(debugger.restore)
    return debugger


def _watch(kernel: Kernel, debugger: PostMortem) -> Callable[[], None]:
    """Open the debugger for every component that goes to error, after its line in the log; returns the unsubscriber."""

    def note(event: StateChanged) -> None:
        component = kernel.components.get(event.component)
        if event.new is LifecycleState.ERROR and component is not None:
            debugger.look(event.component, component.last_error)

    return kernel.bus.subscribe(StateChanged, note)
