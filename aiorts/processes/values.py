"""What a process may use, and how one ended: values, which do nothing."""

from __future__ import annotations

import math
import signal as signals

from aiorts.errors import ConfigurationError
from aiorts.late import dataclass


@dataclass(frozen=True, slots=True)
class Limits:
    """What a process may use; None is without a limit."""

    memory: int | None = None
    """Bytes of address space above what the process has when it calls `limit_memory`: after its imports."""
    cpu: float | None = None
    """Share of one processor: a bound where cgroup v2 is delegated, else nice, which yields to others only."""
    processes: int | None = None
    """Processes and threads, its own included; refused where cgroup v2 is not delegated."""

    def __post_init__(self) -> None:
        for name in ("memory", "processes"):
            value = getattr(self, name)
            if value is not None and (type(value) is not int or value < 1):
                raise ConfigurationError(f"{name} = {value!r:.80}: expected a whole number from 1")
        if self.cpu is not None and (type(self.cpu) not in (int, float) or not 0 < self.cpu < math.inf):
            raise ConfigurationError(f"cpu = {self.cpu!r:.80}: expected a share of one processor above 0, such as 0.5")


@dataclass(frozen=True, slots=True)
class Ending:
    """How a process ended: by its exit status or by a signal; neither where the helper was lost, too."""

    status: int | None
    signal: int | None
    out_of_memory: bool = False
    """The system killed it since memory was short, as far as its counters say."""
    last_lines: tuple[str, ...] = ()
    """The last lines that it wrote, also those that were left out."""

    @property
    def text(self) -> str:
        """ "exit status 3", "killed by SIGSEGV (signal 11)", "killed by SIGKILL, out of memory"."""
        if self.signal is None:
            return (
                "end not seen: the helper process was killed" if self.status is None else f"exit status {self.status}"
            )
        if self.out_of_memory:
            return "killed by SIGKILL, out of memory"
        try:
            return f"killed by {signals.Signals(self.signal).name} (signal {self.signal})"
        except ValueError:  # a real-time signal
            return f"killed by signal {self.signal}"
