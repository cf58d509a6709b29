"""With `measure` a connector tells how old its samples are when they are read, and how long they were on the way."""

from __future__ import annotations

from typing import Any

from aiorts.kernel.ports.port_types import port_type
from aiorts.kernel.quality.dated import Dated, DatedPeriodic, times_of


class Measured(Dated):
    """A transport that measures its samples as they are read. See `Transport`."""

    __slots__ = ()

    def take(self) -> Any:
        self._read(self.queue[0], times_of(self.moments.queue, self.queue)[0])
        return super().take()

    def take_newest(self) -> Any:
        self._read(self.queue[-1], times_of(self.moments.queue, self.queue)[-1])
        return super().take_newest()

    def _read(self, sample: Any, written_ns: int) -> None:
        times = self.times
        assert times is not None  # noqa: S101 - it is why this class was chosen
        times.latencies.append(self.clock.monotonic_ns() - written_ns)
        if port_type(self.connector.in_.type).has_tm:
            tm = sample.tm if isinstance(sample.tm, int) else sample.tm.ns
            if tm:
                times.ages.append(self.clock.time_ns() - tm)


class MeasuredPeriodic(Measured, DatedPeriodic):
    """A periodic transport that measures its samples as they are read. See `PeriodicTransport`."""

    __slots__ = ()
