"""Connectors that time their publisher, for those who asked for it: the others ask no clock for a sample.

What is timed is the sending itself: a sample's way into the reader's buffer, or with subscription periodic all that
one period sends. A sample that was skipped or rejected was not sent.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from aiorts.kernel.backlog import PeriodicConnector
from aiorts.kernel.connector import Connector
from aiorts.model.timing import PublisherTiming, SendTimes

if TYPE_CHECKING:
    from aiorts.model.profile import ConnectorProfile

__all__ = ("MeasuredConnector", "MeasuredPeriodicConnector")


class MeasuredConnector(Connector):
    """A connector that times each send. See `Connector`."""

    __slots__ = ("_monotonic_ns", "_times")
    _plain = False

    def __init__(self, profile: ConnectorProfile, *rest: Any, monotonic_ns: Callable[[], int]) -> None:
        super().__init__(profile, *rest)
        self._monotonic_ns = monotonic_ns
        self._times = SendTimes(profile.measure)

    @property
    def direct(self) -> bool:
        return False

    @property
    def timing(self) -> PublisherTiming:
        with self._guard():
            return self._times.timing

    def _push_in(self, sample: Any, *, counted: bool = False) -> None:
        began_ns = self._monotonic_ns()
        super()._push_in(sample, counted=counted)
        self._times.add(began_ns, self._monotonic_ns())


class MeasuredPeriodicConnector(PeriodicConnector):
    """A connector with a backlog that times each period in which it sent something. See `PeriodicConnector`."""

    __slots__ = ("_sent", "_times")

    def __init__(self, profile: ConnectorProfile, *rest: Any, **clocks: Any) -> None:
        super().__init__(profile, *rest, **clocks)
        self._times = SendTimes(profile.measure)
        self._sent = False

    @property
    def timing(self) -> PublisherTiming:
        with self._guard():
            return self._times.timing

    def _push_in(self, sample: Any, *, counted: bool = False) -> None:
        super()._push_in(sample, counted=counted)
        self._sent = True

    def _move_all(self) -> None:
        self._sent = bool(self._backlog)
        super()._move_all()

    def _period_over(self) -> None:
        began_ns = self._now_ns()
        self._sent = False
        super()._period_over()
        if self._sent:
            with self._guard():
                self._times.add(began_ns, self._now_ns())
