"""Log messages on samples that connectors lose: the first loss with its reason, then counts, ever rarer.

A connector with default options drops the oldest sample when its reader is too slow, and any connector drops samples on
which its converter fails. The count of further losses is logged after 10 s, after twice as long each time while losses
go on, and when the connector ends; after a time without a loss the next loss counts as a first one. Each report names
at most 8 connectors. Losses that the user chose by options of `connect` (`full`, `length`, `push`) or by the
port's own length are not logged: the ledger has every count.

A sample that comes before its reader was ever active is lost silently, and a system may wait for it forever: the first
such loss in a kernel is logged, with a remedy, unless the next samples come through soon.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Final

from aiorts.errors import SLOW_READER
from aiorts.kernel.loop import distances
from aiorts.kernel.loop.bus import ConversionFailed
from aiorts.kernel.loop.guarded import KernelLog
from aiorts.kernel.ports.port import NOTHING

if TYPE_CHECKING:
    from collections.abc import Callable

    from aiorts.kernel.loop.timers import Cancellable
    from aiorts.kernel.ports.connector import Connector
    from aiorts.kernel.ports.host import KernelSide

WHY_DROPPED: Final = {
    "superseded": ".latest takes the newest alone; drain() or read() takes every one",
    "overwritten": f"the reader is slower than the writer; {SLOW_READER}",
    "unconverted": "the connection's convert failed on them; the log has the first one",
    "expired": "no read within the connector's lifespan",
    "rejected": f"the reader is slower than the writer; {SLOW_READER}",
    "inactive": "unread when the reader ended, or written while it was not active",
    "disconnected": "unread when the connection ended",
}
"""The explanation and the remedy, by the reason for which a connector dropped samples."""
_LOG = KernelLog()
_NEXT: Final = 1.0
"""Seconds of the kernel's clock after a sample that came too early: if another gets through by then, no message."""
_MOST_NAMED: Final = 8
_SUMMARISED: Final = "further losses are summarised here, all are counted in connector.statistics"

_EARLY: Final = (
    "W-INACTIVE: %s -> %s: the first sample was dropped, %s was not active yet: connect with keep_last = true%s; "
    "further ones are counted in connector.statistics"
)
_LATER: Final = ', or have the writer start later (start.after = "%s active")'


class Losses:
    """The losses of one kernel's connectors, and the reports of them."""

    reason: ClassVar[str] = "overwritten"
    lost: ClassVar[str] = "lost"

    __slots__ = ("_kernel", "_named", "_reported", "_timer", "_unnamed", "_wait")

    def __init__(self, kernel: KernelSide) -> None:
        self._kernel = kernel
        self._reported: dict[Connector, int] = {}
        """The connectors that lose samples, with the count of reported losses."""
        self._timer: Cancellable | None = None
        self._wait = distances.FIRST
        """Seconds of the kernel's clock to the next report on connectors that lose samples."""
        self._named = self._unnamed = 0

    def listen(self, connector: Connector) -> None:
        """Listen for the next sample that the connector loses."""
        connector._transport.losses = self
        connector.out._refresh()

    def begin(self, connector: Connector) -> None:
        """Let the loop report a connector's first loss soon, and later losses in summary; from any thread."""
        connector._transport.losses = False
        connector.out._refresh()
        self._kernel.loop.call_soon_threadsafe(
            self._begun,
            connector,
            f"the reader is slower than the writer; {_SUMMARISED}; {SLOW_READER}",
        )

    def stop(self, connector: Connector) -> None:
        """Report losses not reported yet, and none from now on: the user has chosen what is lost."""
        connector._transport.losses = None
        connector.out._refresh()
        self.end(connector)

    def end(self, connector: Connector) -> None:
        """Report losses not reported yet: the connector has closed."""
        reported = self._reported.pop(connector, None)
        if reported is not None:
            self._report_more(connector, reported)

    def close(self) -> None:
        """End the reports: all connectors have ended."""
        if self._timer is not None:
            self._timer.cancel()
        self._report_unnamed()

    def _begun(self, connector: Connector, why: str) -> None:
        self._reported[connector] = lost = self._lost(connector)
        self._report(
            "%s -> %s: %s %s so far: %s, %s",
            connector.out.path,
            connector.in_.path,
            _samples(lost),
            self.lost,
            self.reason,
            why,
        )
        if self._is_over(connector):
            self.end(connector)
        elif self._timer is None and not self._kernel.closed:
            self._timer = self._kernel.call_later(self._wait, self._look)

    def _look(self) -> None:
        self._timer = None
        self._report_unnamed()
        for connector, reported in tuple(self._reported.items()):
            lost = self._report_more(connector, reported)
            if lost == reported:
                del self._reported[connector]
                self.listen(connector)
            else:
                self._reported[connector] = lost
        self._wait = distances.longer(self._wait) if self._reported else distances.FIRST
        if self._reported:
            self._timer = self._kernel.call_later(self._wait, self._look)

    def _report_more(self, connector: Connector, reported: int) -> int:
        lost = self._lost(connector)
        if lost > reported:
            more = _samples(lost - reported)
            self._report("%s -> %s: %s more %s", connector.out.path, connector.in_.path, more, self.lost)
        return lost

    def _report(self, line: str, *what: object) -> None:
        if self._named < _MOST_NAMED:
            self._named += 1
            _LOG.warning(line, *what)
        else:
            self._unnamed += 1

    def _report_unnamed(self) -> None:
        unnamed, self._unnamed, self._named = self._unnamed, 0, 0
        if unnamed:
            _LOG.warning("%s: %s more connectors lost samples; kernel.connectors has each", self._kernel.name, unnamed)

    def _lost(self, connector: Connector) -> int:
        return connector._transport.glance()[2].get(self.reason, 0)

    def _is_over(self, connector: Connector) -> bool:
        return connector.closed or connector._transport.losses is None


class Unconverted(Losses):
    """Reports of samples on which converters failed; a connector's first failure is also published as an event."""

    reason = "unconverted"
    lost = "dropped"

    def __init__(self, kernel: KernelSide) -> None:
        super().__init__(kernel)
        self._failing: set[Connector] = set()
        """The connectors whose converter failed, until a check finds no further failure."""

    def listen(self, connector: Connector) -> None:
        self._failing.discard(connector)

    def failed(self, connector: Connector, explain: Callable[[], str]) -> None:
        """Let the loop report a connector's first failed conversion, and later ones in summary; from any thread."""
        if connector not in self._failing:
            self._failing.add(connector)
            self._kernel.loop.call_soon_threadsafe(self._first, connector, explain())

    def end(self, connector: Connector) -> None:
        super().end(connector)
        self._failing.discard(connector)

    def _is_over(self, connector: Connector) -> bool:
        return connector.closed

    def _first(self, connector: Connector, fault: str) -> None:
        self._kernel.bus.publish(ConversionFailed(connector.name, fault))
        self._begun(connector, f"convert = {connector.profile.convert}: {fault}; {_SUMMARISED}")


class Early:
    """The message on a kernel's first sample that came before its reader was ever active, unless others get through."""

    __slots__ = ("_kernel", "_missed", "_said", "_timer")

    def __init__(self, kernel: KernelSide) -> None:
        self._kernel = kernel
        self._said = False
        self._missed: list[Connector] = []
        """Connectors that dropped their first sample since the last check."""
        self._timer: Cancellable | None = None

    def dropped_first(self, connector: Connector) -> None:
        """Note, from any thread, that a connector dropped its first sample because its reader is not active.

        Samples that no component waits for are not reported: those for a reader that was active before or joins a
        stream, and those of a tool. Over a link the reader's kernel reports them, since the writer's end drops none.
        """
        out, host = connector.out, connector.in_._host
        if self._said or self._kernel.closed or host is None or host.was_active or out._saved is not NOTHING:
            return
        if not (connector.profile.keep_last or out.is_tap):
            self._kernel.loop.call_soon_threadsafe(self._begun, connector)

    def close(self) -> None:
        """Report now what waits to be reported: all connectors are about to end."""
        if self._timer is not None:
            self._timer.cancel()
            self._look()

    def _begun(self, connector: Connector) -> None:
        if self._said or self._kernel.closed:
            return
        self._missed.append(connector)
        if self._timer is None:
            self._timer = self._kernel.call_later(_NEXT, self._look)

    def _look(self) -> None:
        missed, self._missed, self._timer = self._missed, [], None
        for connector in missed:
            # A periodic writer has sent more, and a reader that is added to others of a stream has missed nothing.
            if not any(one._transport.delivered() > 0 for one in (connector, *connector.out._connectors)):
                self._report(connector)
                return

    def _report(self, connector: Connector) -> None:
        self._said = True
        reader = connector.in_.path.partition(".")[0]
        later = "" if connector.out.is_far else _LATER % reader
        _LOG.warning(_EARLY, connector.out.path, connector.in_.path, reader, later)


def _samples(count: int) -> str:
    return "1 sample" if count == 1 else f"{count} samples"
