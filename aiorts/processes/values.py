"""What a process may use, and how one ended: values, which do nothing."""

from __future__ import annotations

import signal as signals

from aiorts.late import dataclass
from aiorts.model.declared import check_declared, option


@dataclass(frozen=True, slots=True)
class Limits:
    """The limits of a process; None is without a limit.

    Raises:
        ConfigurationError: a value is out of range; it is named.
    """

    memory: int | None = option(
        None, "The address space above what the process has after its imports.", unit="bytes", low=1
    )
    cpu: float | None = option(
        None,
        "The share of one processor: a bound where cgroup v2 is delegated, else nice, which yields to others only.",
        unit="processors",
        above=0,
    )
    processes: int | None = option(
        None,
        "The number of processes and threads, its own included; refused where cgroup v2 is not delegated.",
        low=1,
    )

    def __post_init__(self) -> None:
        check_declared(self)


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
