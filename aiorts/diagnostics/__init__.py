"""Finds the code that delays a context or the event loop: component, line and duration.

`DeadlineMonitor` and `LoopMonitor` are services of a kernel; one thread of the process waits for the timers of both. A
context that is on time pays one comparison in most cycles.
"""

from __future__ import annotations

from aiorts.late import TYPE_CHECKING, late

if TYPE_CHECKING:
    from aiorts.diagnostics.deadline_monitor import ContextTimer, DeadlineMonitor
    from aiorts.diagnostics.loop_monitor import LoopLimit, LoopMonitor, LoopStall, LoopStalls
    from aiorts.diagnostics.unawaited import unawaited_told

late()
