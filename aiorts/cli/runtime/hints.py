"""What a run tells though nothing has failed: samples that were lost unseen, data that cannot come, a missing await."""

from __future__ import annotations

import contextlib
import re
import sys
import traceback
import warnings
from collections.abc import Callable, Iterator
from itertools import islice
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from aiorts import Component, InPort, Kernel
from aiorts.errors import SLOW_READER
from aiorts.kernel.loop.origins import place
from aiorts.model.policy import Dataflow, Subscription

if TYPE_CHECKING:
    from aiorts import Connector

Tell: TypeAlias = Callable[[str, str], None]
"""Takes a code and a message."""
_WHY: Final = {
    "superseded": ".latest takes the newest alone; drain() or read() takes every one",
    "overwritten": f"the reader is slower than the writer; {SLOW_READER}",
    "rejected": f"the reader is slower than the writer; {SLOW_READER}",
}
_NEVER_AWAITED: Final = re.compile(r"coroutine '(.+)' was never awaited")
_FRAMES: Final = 20


def dropped(kernel: Kernel, *, every: bool) -> Iterator[str]:
    """A line for each connector that was to deliver every sample and did not.

    Args:
        every: also where a reader in a context with a rate leaves samples out, and where they are few.
    """
    for connector in kernel.connectors.values():
        profile = connector.profile
        if profile.subscription is not Subscription.FLUSH or profile.dataflow is Dataflow.PULL:
            continue  # newest only, by design
        ledger = connector.statistics
        for reason, why in _WHY.items():
            count = ledger.dropped.get(reason, 0)
            surprising = reason == "superseded" and 2 * count >= ledger.written and _on_events(kernel, connector)
            if count and (every or surprising):
                yield f"{connector.in_.path}: {count} of {ledger.written} samples {reason}: {why}"


def _on_events(kernel: Kernel, connector: Connector) -> bool:
    """Whether the reader runs because a sample came, so that it may be expected to see each."""
    reader = kernel.components.get(connector.in_.path.partition(".")[0])
    return reader is not None and bool(reader.contexts) and all(one.kind == "event" for one in reader.contexts)


def unfed(kernel: Kernel, advice: str) -> str:
    """What to say of a component alone that waits for data which cannot come; empty when it does not.

    Args:
        advice: how it gets data.
    """
    for component in kernel.components.values():
        ports = [port for port in component.ports.values() if isinstance(port, InPort)]
        waits = ports and not any(port.connectors for port in ports)
        if waits and all(context.kind == "event" for context in component.contexts):
            names = ", ".join(port.name for port in ports[:6])
            verb = "in-port {} has" if len(ports) == 1 else "in-ports {} have"
            what = f"{component.name}: {verb.format(names)} no connection, nothing will come"
            return f"{what}; {advice}"
    return ""


@contextlib.contextmanager
def unawaited_reported(tell: Tell) -> Iterator[list[str]]:
    """Meanwhile a coroutine that was never awaited is told in a line that names its component and what to write.

    The list has what was told so.
    """
    before, told = warnings.showwarning, list[str]()

    def show(
        message: Warning | str, category: type[Warning], filename: str, lineno: int, file: Any = None, line: Any = None
    ) -> None:
        found = _NEVER_AWAITED.search(str(message))
        if found is None or not issubclass(category, RuntimeWarning):
            before(message, category, filename, lineno, file, line)
            return
        what = found[1]
        instead = "use write_nowait, or async def and await" if what.endswith(".write") else "use async def and await"
        where = f"{_hook_at(filename, lineno)}{place(filename, lineno)}"
        told.append(f"{where}: {what} was never awaited and did nothing; {instead}")
        tell("E-AWAIT", told[-1])

    warnings.showwarning = show
    try:
        yield told
    finally:
        if warnings.showwarning is show:
            warnings.showwarning = before


def _hook_at(filename: str, lineno: int) -> str:
    """Component and method that run this line now, with a colon behind them, as far as they are known."""
    for frame, line in islice(traceback.walk_stack(sys._getframe(1)), _FRAMES):
        if frame.f_code.co_filename == filename and line == lineno:
            owner = frame.f_locals.get("self")
            return f"{owner.name}.{frame.f_code.co_name}: " if isinstance(owner, Component) else ""
    return ""
