"""The execution contexts of aiorts, registered as those of any package.

Each decides when a cycle is due and for which members; `aiorts.kernel.execution` carries it out. The real-time context
has a room of its own, `aiorts.realtime`.
"""

from __future__ import annotations

from aiorts.contexts.event import EventContext
from aiorts.contexts.external import ExternalContext
from aiorts.contexts.periodic import PeriodicContext
from aiorts.contexts.thread import ThreadContext

__all__ = ("EventContext", "ExternalContext", "PeriodicContext", "ThreadContext")
