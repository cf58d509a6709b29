"""Sleeping until an absolute moment of CLOCK_MONOTONIC, and the thread's timer slack; nothing here decides how long.

The call goes by ctypes, and gives up the interpreter lock while the thread sleeps. The two structures that it needs are
made once. Where the system has no such call, `time.sleep` for the rest serves, as `Granted.denied` says.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any, Final, Protocol

_ABSTIME: Final = 1
_EINTR: Final = 4
_SET_TIMERSLACK: Final = 29
_LONGEST_NS: Final = 2**62


class Sleep(Protocol):
    """Sleep until `time.monotonic_ns()` has reached the moment; a moment in the past returns at once."""

    def __call__(self, deadline_ns: int, /) -> None: ...


def relative_sleep(deadline_ns: int, /) -> None:
    """Sleep where there is no absolute sleep: late by the time between the look at the clock and the call."""
    while (rest := deadline_ns - time.monotonic_ns()) > 0:
        time.sleep(rest / 1e9)


def sleeper() -> Sleep | None:
    """A sleep for one thread by `clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME)`; None where there is no such call."""
    library = libc()
    if library is None:
        return None
    import ctypes

    call = getattr(library, "clock_nanosleep", None)
    if call is None or ctypes.sizeof(ctypes.c_long) != 8:  # with 32-bit longs the layout depends on the C library
        return None
    call.argtypes = (ctypes.c_int, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)
    spec = (ctypes.c_long * 2)()
    return _absolute(call, spec, ctypes.addressof(spec), time.CLOCK_MONOTONIC)


def _absolute(call: Callable[..., int], spec: Any, address: int, clock: int) -> Sleep:
    def sleep(deadline_ns: int, /) -> None:
        spec[0], spec[1] = divmod(min(deadline_ns, _LONGEST_NS), 1_000_000_000)
        # A signal ends the call early; the deadline is absolute, so asking again is all there is to do.
        while (error := call(clock, _ABSTIME, address, None)) == _EINTR:
            pass
        if error:
            relative_sleep(deadline_ns)

    return sleep


def set_timer_slack(nanoseconds: int) -> bool:
    """Set how much later the system may wake this thread to save energy; False: it cannot be set."""
    library = libc()
    call = getattr(library, "prctl", None)
    if call is None:
        return False
    import ctypes

    return int(call(_SET_TIMERSLACK, ctypes.c_ulong(nanoseconds), 0, 0, 0)) == 0


def libc() -> Any:
    """The C library, loaded so that its calls give up the interpreter lock; None where there are no such calls."""
    if sys.platform != "linux":
        return None
    try:
        import ctypes

        return ctypes.CDLL(None, use_errno=True)
    except (ImportError, OSError):
        return None
