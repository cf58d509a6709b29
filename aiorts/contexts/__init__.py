"""The execution contexts that ship with aiorts, registered the way a third party's are."""

from __future__ import annotations

from aiorts.contexts.event import EventContext
from aiorts.contexts.external import ExternalContext
from aiorts.contexts.periodic import PeriodicContext
from aiorts.contexts.realtime import RealtimeContext
from aiorts.contexts.thread import ThreadContext

__all__ = ("EventContext", "ExternalContext", "PeriodicContext", "RealtimeContext", "ThreadContext")
