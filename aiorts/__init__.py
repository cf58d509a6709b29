"""aiorts, the RT-Middleware for Python: robot software as components on an asyncio event-driven microkernel."""

from __future__ import annotations

from anyio import WouldBlock

from aiorts.clock import Clock, ScaledClock, SimulatedClock, SystemClock
from aiorts.contexts import EventContext, ExternalContext, PeriodicContext, ThreadContext
from aiorts.errors import AiortsError
from aiorts.kernel import Bus, Component, Connector, Context, InPort, Kernel, OutPort, Param
from aiorts.model.lifecycle import LifeCycleState
from aiorts.running import run

__version__ = "0.1.0"

__all__ = (
    "AiortsError",
    "Bus",
    "Clock",
    "Component",
    "Connector",
    "Context",
    "EventContext",
    "ExternalContext",
    "InPort",
    "Kernel",
    "LifeCycleState",
    "OutPort",
    "Param",
    "PeriodicContext",
    "ScaledClock",
    "SimulatedClock",
    "SystemClock",
    "ThreadContext",
    "WouldBlock",
    "run",
)
