"""Settings of the whole process while at least one real-time context runs: collector, switch interval, memory lock.

These settings belong to the process, so there is one `SETTINGS`, which counts its users: the first context sets them,
the last one puts the former ones back, unless other code has changed them meanwhile. While they are set, garbage is
collected when a context has slack: `collect` decides which generation fits, from the cost of each so far. A generation
that is long overdue is collected all the same, so that memory stays flat.
"""

from __future__ import annotations

import gc
import os
import sys
import threading
import time
from typing import Any, Final

SWITCH_INTERVAL: Final = 100e-6
_OVERDUE: Final = 20
"""Multiple of its threshold at which a generation is collected, slack or not."""
_GUESS_NS: Final[tuple[int, ...]] = (50_000, 100_000, 300_000)
"""The assumed cost of each generation's collection before one was measured; objects of the start are frozen."""
_LOCK_FLAGS: Final = 1 | 2 | 4
"""MCL_CURRENT, MCL_FUTURE, MCL_ONFAULT: pages that were used once stay; others take no memory."""
_OF_THE_INTERPRETER: Final = 2000
"""More objects than CPython 3.12 has frozen before any code runs: those are a few hundred."""
_CAP_IPC_LOCK: Final = 1 << 14


class ProcessSettings:
    """The settings of this process; safe to use from several threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._users = 0
        self._lockers = 0
        self._cost_ns: list[int] = list(_GUESS_NS)
        self._froze = False
        self._unlocks = False
        self._interval_before = self._interval_set = 0.0
        self.collects = False
        """Whether garbage is collected by `collect` only."""
        self.switch_interval: float | None = None
        """The switch interval in force for real-time contexts; None while there is none."""

    def acquire(self) -> None:
        """Count one more real-time context; the first one sets the settings."""
        with self._lock:
            self._users += 1
            if self._users > 1:
                return
            self._interval_before = sys.getswitchinterval()
            # Also where it was shorter: a real-time thread that asks every microsecond keeps the holder of the
            # interpreter lock, which has no priority, from the processor and so from letting go.
            sys.setswitchinterval(SWITCH_INTERVAL)
            self.switch_interval = self._interval_set = sys.getswitchinterval()
            if gc.isenabled():
                # If the host has switched the collector off, nothing is collected here either.
                self.collects = True
                self._cost_ns = list(_GUESS_NS)
                gc.disable()
                gc.collect()
                # A host's frozen objects could not be told from ours afterwards: then nothing is frozen here.
                self._froze = gc.get_freeze_count() <= _OF_THE_INTERPRETER
                if self._froze:
                    gc.freeze()

    def release(self) -> None:
        """Count one real-time context less; after the last all settings are as they were found."""
        with self._lock:
            self._users -= 1
            if self._users:
                return
            if sys.getswitchinterval() == self._interval_set:
                sys.setswitchinterval(self._interval_before)
            self.switch_interval = None
            if self.collects:
                self.collects = False
                if self._froze:
                    gc.unfreeze()
                gc.enable()

    def after_fork(self) -> None:
        """Restore all settings in a forked child, which has no real-time thread."""
        self._lock = threading.Lock()
        self._lockers = 0
        if self._users:
            self._users = 1
            self.release()

    # -- garbage ---------------------------------------------------------------------------------------------------

    def collect(self, slack_ns: int) -> None:
        """Collect the oldest generation that is due, when `slack_ns` is twice what it costs, or it is long overdue."""
        counts, thresholds = gc.get_count(), gc.get_threshold()
        if counts[0] <= thresholds[0]:
            return
        for generation in (2, 1, 0):
            count, threshold = counts[generation], thresholds[generation]
            if count <= threshold:
                continue
            if slack_ns >= 2 * self._cost_ns[generation] or count > _OVERDUE * (threshold + 1):
                self._collect(generation)
                return

    def relieve(self) -> None:
        """Collect garbage that is long overdue: no context had slack, or the only one hangs in a hook."""
        if self.collects and gc.get_count()[0] > _OVERDUE * (gc.get_threshold()[0] + 1):
            self._collect(0 if gc.get_count()[1] <= gc.get_threshold()[1] else 2)

    def _collect(self, generation: int) -> None:
        began = time.monotonic_ns()
        gc.collect(generation)
        took = time.monotonic_ns() - began
        # The highest cost is forgotten slowly: an interrupted collection must not keep others away without end.
        self._cost_ns[generation] = max(took, self._cost_ns[generation] * 7 // 8)

    # -- memory ----------------------------------------------------------------------------------------------------

    def lock_memory(self) -> str:
        """Keep the memory of the process resident; the reason if that is denied, else ""."""
        with self._lock:
            if self._lockers == 0:
                reason = self._lock_now()
                if reason:
                    return reason
            self._lockers += 1
        return ""

    def unlock_memory(self) -> None:
        """Count one context less; after the last the memory is unlocked, unless it was locked before the first."""
        with self._lock:
            self._lockers -= 1
            if self._lockers == 0 and self._unlocks:
                libc = _libc()
                if libc is not None:
                    libc.munlockall()

    def _lock_now(self) -> str:
        libc = _libc()
        if libc is None:
            return "this system has no mlockall"
        status = _status()
        limit = _limit()
        # Within a limit later allocations would fail, which is worse than a page fault.
        if limit is not None and not int(status.get("CapEff", "0"), 16) & _CAP_IPC_LOCK:
            return f"mlockall: the limit is {limit // 1024} kB; set `ulimit -l unlimited` or give CAP_IPC_LOCK"
        self._unlocks = status.get("VmLck", "0 kB").split()[0] == "0"
        if libc.mlockall(_LOCK_FLAGS) != 0:
            import ctypes

            reason = os.strerror(ctypes.get_errno())
            return f"mlockall: {reason}; set `ulimit -l unlimited` or give CAP_IPC_LOCK"
        return ""


def _status() -> dict[str, str]:
    """The system's status of this process, by key; empty where there is none."""
    try:
        with open("/proc/self/status", "rb") as file:
            lines = file.read().decode("utf-8", "replace").splitlines()
    except OSError:
        return {}
    return {key: value.strip() for key, _, value in (line.partition(":") for line in lines)}


def _limit() -> int | None:
    """Bytes that may be locked; None is unlimited."""
    import resource

    soft, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    return None if soft == resource.RLIM_INFINITY else soft


def _libc() -> Any:
    from aiorts.realtime.nanosleep import libc

    found = libc()
    return found if hasattr(found, "mlockall") else None


SETTINGS: Final = ProcessSettings()
"""The only instance: there is one process."""
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=SETTINGS.after_fork)
