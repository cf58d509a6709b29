"""aiorts, the RT-Middleware for Python: robot software as components on an asyncio event-driven microkernel.

Names are imported when they are first used, so that a command's help or a tool that only asks for the version does not
pay for the kernel.
"""

from __future__ import annotations

from aiorts.late import late as _late

TYPE_CHECKING = False
"""What `typing` calls so; importing that would take as long as all else until the command line can take Ctrl-C."""

if TYPE_CHECKING:
    from anyio import WouldBlock

    from aiorts.clock import Clock, ScaledClock, SimulatedClock, SystemClock
    from aiorts.contexts import EventContext, ExternalContext, PeriodicContext, RealtimeContext, ThreadContext
    from aiorts.errors import AiortsError
    from aiorts.kernel import (
        Bus,
        Component,
        Connector,
        Context,
        InPort,
        Kernel,
        OutPort,
        Param,
        Provided,
        Required,
        ServiceConnector,
        ServicePort,
    )
    from aiorts.kernel.catalogue import Catalogue, Extension
    from aiorts.kernel.composite import Composite
    from aiorts.kernel.configuring import Configuration
    from aiorts.kernel.declarations import Declaration, declaration_of
    from aiorts.kernel.function import component
    from aiorts.kernel.machine import EventPort, StateMachine, StateMachineComponent
    from aiorts.kernel.modes import MultiModeComponent, Participant
    from aiorts.kernel.reload_events import Dropped, Reloaded
    from aiorts.kernel.supervision import Supervised
    from aiorts.kernel.watchdog import LoopStalls
    from aiorts.model.blame import Blame
    from aiorts.model.lifecycle import LifeCycleState
    from aiorts.model.naming import NamePolicy
    from aiorts.model.profile_schema import profile_schema
    from aiorts.model.sequence import StartRule
    from aiorts.model.supervision import Supervision
    from aiorts.model.system_profile import SystemProfile
    from aiorts.running import run

__version__ = "0.1.0"

__all__ = (
    "AiortsError",
    "Blame",
    "Bus",
    "Catalogue",
    "Clock",
    "Component",
    "Composite",
    "Configuration",
    "Connector",
    "Context",
    "Declaration",
    "Dropped",
    "EventContext",
    "EventPort",
    "Extension",
    "ExternalContext",
    "InPort",
    "Kernel",
    "LifeCycleState",
    "LoopStalls",
    "MultiModeComponent",
    "NamePolicy",
    "OutPort",
    "Param",
    "Participant",
    "PeriodicContext",
    "Provided",
    "RealtimeContext",
    "Reloaded",
    "Required",
    "ScaledClock",
    "ServiceConnector",
    "ServicePort",
    "SimulatedClock",
    "StartRule",
    "StateMachine",
    "StateMachineComponent",
    "Supervised",
    "Supervision",
    "SystemClock",
    "SystemProfile",
    "ThreadContext",
    "WouldBlock",
    "component",
    "declaration_of",
    "profile_schema",
    "run",
)

_HOMES = {
    "aiorts.clock": (
        "Clock",
        "ScaledClock",
        "SimulatedClock",
        "SystemClock",
    ),
    "aiorts.contexts": (
        "EventContext",
        "ExternalContext",
        "PeriodicContext",
        "RealtimeContext",
        "ThreadContext",
    ),
    "aiorts.errors": ("AiortsError",),
    "aiorts.kernel": (
        "Bus",
        "Component",
        "Connector",
        "Context",
        "InPort",
        "Kernel",
        "OutPort",
        "Param",
        "Provided",
        "Required",
        "ServiceConnector",
        "ServicePort",
    ),
    "aiorts.kernel.catalogue": (
        "Catalogue",
        "Extension",
    ),
    "aiorts.kernel.composite": ("Composite",),
    "aiorts.kernel.configuring": ("Configuration",),
    "aiorts.kernel.declarations": (
        "Declaration",
        "declaration_of",
    ),
    "aiorts.kernel.function": ("component",),
    "aiorts.kernel.machine": (
        "EventPort",
        "StateMachine",
        "StateMachineComponent",
    ),
    "aiorts.kernel.modes": (
        "MultiModeComponent",
        "Participant",
    ),
    "aiorts.kernel.reload_events": (
        "Dropped",
        "Reloaded",
    ),
    "aiorts.kernel.supervision": ("Supervised",),
    "aiorts.kernel.watchdog": ("LoopStalls",),
    "aiorts.model.blame": ("Blame",),
    "aiorts.model.lifecycle": ("LifeCycleState",),
    "aiorts.model.naming": ("NamePolicy",),
    "aiorts.model.profile_schema": ("profile_schema",),
    "aiorts.model.sequence": ("StartRule",),
    "aiorts.model.supervision": ("Supervision",),
    "aiorts.model.system_profile": ("SystemProfile",),
    "aiorts.running": ("run",),
    "anyio": ("WouldBlock",),
}
"""Where each public name lives; the events are in `aiorts.events`, the words of state charts in `aiorts.statechart`."""
_MODULES = frozenset(
    ("clock", "contexts", "errors", "events", "kernel", "model", "statechart", "system", "testing", "types", "wire")
)
"""`import aiorts` is enough to say `aiorts.types.TimedDouble`."""

# Hidden from type checkers, which would otherwise believe in every name.
if not TYPE_CHECKING:
    __getattr__ = _late(__name__, _HOMES, _MODULES)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, *_MODULES})
