"""Hints of a run in which nothing has failed: samples that were lost unseen, data that cannot come, a missing await."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Final, TypeAlias

from aiorts import Component, InPort, Kernel
from aiorts.diagnostics import unawaited_told
from aiorts.kernel.ports.losses import WHY_DROPPED
from aiorts.model.buffer import DEFAULT_LENGTH
from aiorts.model.policy import Dataflow, Push, Subscription

if TYPE_CHECKING:
    from aiorts import Connector
    from aiorts.model.profile import ConnectorProfile

Tell: TypeAlias = Callable[[str, str], None]
"""A function that takes a code and a message."""
_LEFT: Final = ("inactive", "disconnected")
"""The drop reasons of samples that wait when the reader or the connection ends."""


class Drops:
    """The losses of connectors that should deliver every sample: noted before the kernel's end, reported after it."""

    def __init__(self, kernel: Kernel) -> None:
        self._before = [
            (connector, connector.statistics.dropped, _on_events(kernel, connector))
            for connector in kernel.connectors.values()
            if _is_for_all(connector.profile)
        ]

    def lines(self, *, every: bool) -> Iterator[str]:
        """A line for each connector and reason.

        Args:
            every: whether to include a reader in a context with a rate that skips samples, and small numbers.
        """
        for connector, before, on_events in self._before:
            ledger = connector.statistics
            for reason, why in WHY_DROPPED.items():
                count = ledger.dropped.get(reason, 0)
                if reason in _LEFT:  # a buffer's usual length may be left by the last cycle; more is a loss
                    surprising = count - before.get(reason, 0) > DEFAULT_LENGTH
                else:
                    surprising = reason == "superseded" and 2 * count >= ledger.written and on_events
                if count and (every or surprising):
                    yield f"{connector.in_.path}: {count} of {ledger.written} samples {reason}: {why}"


def _is_for_all(profile: ConnectorProfile) -> bool:
    """Whether a connector is to deliver every sample, not only the newest."""
    if profile.dataflow is Dataflow.PULL:
        return False
    return profile.subscription is Subscription.FLUSH or profile.push in (Push.ALL, Push.FIFO)


def _on_events(kernel: Kernel, connector: Connector) -> bool:
    """Whether the reader runs in event contexts, so that it is expected to see each sample."""
    reader = kernel.components.get(connector.in_.path.partition(".")[0])
    return reader is not None and bool(reader.contexts) and all(one.kind == "event" for one in reader.contexts)


def unfed(kernel: Kernel, advice: str) -> str:
    """The hint for a component alone that waits for data which cannot come; empty for any other system.

    Args:
        advice: the text that says how the component gets data.
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
    """Report each coroutine that was never awaited in a line that names its component and what to write.

    The yielded list has these lines.
    """
    told = list[str]()

    def take(line: str, _owner: Component | None) -> bool:
        told.append(line)
        tell("E-AWAIT", line)
        return True

    with unawaited_told(take):
        yield told
