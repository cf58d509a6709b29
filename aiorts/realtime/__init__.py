"""The real-time context, and the transports that a real-time thread uses: they take no lock.

A port becomes lock-free when such a thread comes to it, and ordinary when the thread has gone (`lock_free.py`).
Priorities, locked memory and sleeping without drift are Linux's.
"""

from __future__ import annotations

from aiorts.realtime.realtime_context import RealtimeContext
