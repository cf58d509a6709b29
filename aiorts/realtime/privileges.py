"""The privileges that a real-time thread asks for: a scheduling class, processors, exact timers, resident memory.

Everything here runs in that thread. A denied privilege is kept with the reason and the remedy; nothing is raised.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Mapping
from dataclasses import field
from types import MappingProxyType
from typing import Final

from aiorts.late import dataclass
from aiorts.realtime import process
from aiorts.realtime.nanosleep import Sleep, relative_sleep, set_timer_slack, sleeper

_SLACK_NS: Final = 1


@dataclass(frozen=True, slots=True)
class Wanted:
    """The privileges that a real-time context asks for."""

    priority: int | None = None
    cpus: frozenset[int] | None = None
    lock_memory: bool = False


@dataclass(frozen=True, slots=True)
class Granted:
    """The privileges in force for a real-time context; all empty before it starts and in simulated time."""

    priority: int | None = None
    """The priority in SCHED_FIFO; None: scheduled as any other thread."""
    cpus: frozenset[int] | None = None
    """The processors that the thread keeps to; None: any."""
    locked: bool = False
    """Whether the memory of the process stays resident."""
    timer_slack_ns: int | None = None
    """How much later than requested the system may wake the thread; None: its default, 50 us."""
    absolute_sleep: bool = False
    """Whether the thread sleeps until an absolute moment, by clock_nanosleep."""
    collector: bool = False
    """Whether garbage is collected in slack time only."""
    switch_interval: float | None = None
    """Seconds after which a thread that holds the interpreter lock has to release it."""
    denied: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))
    """The reason and the remedy, by the privilege that was requested and not granted."""


def obtain(wanted: Wanted) -> tuple[Granted, Sleep]:
    """Ask for all that is wanted, for the calling thread; the privileges in force then, and its sleep function."""
    denied: dict[str, str] = {}
    sleep = sleeper()
    if sleep is None:
        denied["absolute sleep"] = "this system has no clock_nanosleep; time.sleep serves, less exactly"
    slack = set_timer_slack(_SLACK_NS)
    if not slack:
        denied["timer slack"] = "this system has no prctl(PR_SET_TIMERSLACK); wake-ups may be 50 us late"
    cpus = None if wanted.cpus is None else _affinity(wanted.cpus, denied)
    # Locked before the thread goes first: it is the longest of these calls.
    locked = wanted.lock_memory and _granted(denied, "memory lock", process.SETTINGS.lock_memory())
    priority = wanted.priority is not None and _granted(denied, "priority", _fifo(wanted.priority))
    granted = Granted(
        priority=wanted.priority if priority else None,
        cpus=cpus,
        locked=locked,
        timer_slack_ns=_SLACK_NS if slack else None,
        absolute_sleep=sleep is not None,
        collector=process.SETTINGS.collects,
        switch_interval=process.SETTINGS.switch_interval,
        denied=MappingProxyType(denied),
    )
    return granted, sleep or relative_sleep


def _granted(denied: dict[str, str], what: str, reason: str) -> bool:
    if reason:
        denied[what] = reason
    return not reason


def _fifo(priority: int) -> str:
    """Put this thread, and no other, into SCHED_FIFO; the reason if that is denied, else ""."""
    try:
        # 0 is the calling thread. Threads that it starts do not inherit the class.
        policy = os.SCHED_FIFO | getattr(os, "SCHED_RESET_ON_FORK", 0)
        os.sched_setscheduler(0, policy, os.sched_param(priority))
    except AttributeError:
        return "this system has no sched_setscheduler"
    except OSError as error:
        return f"SCHED_FIFO {priority}: {_name(error)}; raise `ulimit -r` to {priority} or give CAP_SYS_NICE"
    return ""


def _affinity(cpus: frozenset[int], denied: dict[str, str]) -> frozenset[int] | None:
    """Keep this thread to these processors, as far as they are there; the processors that it keeps to, None: any."""
    try:
        os.sched_setaffinity(0, cpus)
        kept = frozenset(os.sched_getaffinity(0))
    except AttributeError:
        denied["cpus"] = "this system has no sched_setaffinity"
        return None
    except (OSError, OverflowError) as error:
        here = sorted(os.sched_getaffinity(0))
        denied["cpus"] = f"cpus {sorted(cpus)}: {_name(error)}; this process may use {here}"
        return None
    if missing := cpus - kept:
        denied["cpus"] = f"cpus {sorted(missing)}: not there for this process; it keeps to {sorted(kept)}"
    return kept


def _name(error: Exception) -> str:
    number = getattr(error, "errno", None)
    return type(error).__name__ if number is None else errno.errorcode.get(number, str(number))
