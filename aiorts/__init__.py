"""aiorts, the RT-Middleware for Python: robot software as components on an asyncio event-driven microkernel."""

from __future__ import annotations

from anyio import WouldBlock

from aiorts.clock import Clock, ScaledClock, SimulatedClock, SystemClock
from aiorts.contexts import EventContext, ExternalContext, PeriodicContext, RealtimeContext, ThreadContext
from aiorts.errors import AiortsError
from aiorts.kernel import Bus, Component, Connector, Context, InPort, Kernel, OutPort, Param
from aiorts.kernel.bus import (
    ComponentAdded,
    ComponentRemoved,
    Connected,
    ContextStarted,
    ContextStopped,
    Disconnected,
    Event,
    HookAfter,
    HookBefore,
    HookFailed,
    MemberAdded,
    MemberRemoved,
    Overrun,
    ParametersChanged,
    PortAdded,
    PortRemoved,
    RateChanged,
    StateChanged,
    ThreadsExhausted,
)
from aiorts.model.blame import Blame
from aiorts.model.lifecycle import LifeCycleState
from aiorts.running import run

__version__ = "0.1.0"

__all__ = (
    "AiortsError",
    "Blame",
    "Bus",
    "Clock",
    "Component",
    "ComponentAdded",
    "ComponentRemoved",
    "Connected",
    "Connector",
    "Context",
    "ContextStarted",
    "ContextStopped",
    "Disconnected",
    "Event",
    "EventContext",
    "ExternalContext",
    "HookAfter",
    "HookBefore",
    "HookFailed",
    "InPort",
    "Kernel",
    "LifeCycleState",
    "MemberAdded",
    "MemberRemoved",
    "OutPort",
    "Overrun",
    "Param",
    "ParametersChanged",
    "PeriodicContext",
    "PortAdded",
    "PortRemoved",
    "RateChanged",
    "RealtimeContext",
    "ScaledClock",
    "SimulatedClock",
    "StateChanged",
    "SystemClock",
    "ThreadContext",
    "ThreadsExhausted",
    "WouldBlock",
    "run",
)
