"""aiorts, the RT-Middleware for Python: robot software as components on an asyncio event-driven microkernel.

Names are imported when they are first used, so that a command's help or a tool that only asks for the version does not
pay for the kernel.
"""

from __future__ import annotations

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
    from aiorts.kernel.bus import (
        CallFailed,
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
        ServiceCalled,
        StateChanged,
        ThreadsExhausted,
    )
    from aiorts.kernel.catalogue import Catalogue, Extension
    from aiorts.kernel.composite import Composite, CompositeChanged
    from aiorts.kernel.configuration_events import (
        ConfigurationSetActivated,
        ConfigurationSetAdded,
        ConfigurationSetChanged,
        ConfigurationSetRemoved,
        ParameterAdded,
        ParameterChanged,
        ParameterRemoved,
    )
    from aiorts.kernel.configuring import Configuration
    from aiorts.kernel.declarations import Declaration, declaration_of
    from aiorts.kernel.function import component
    from aiorts.kernel.heartbeats import ComponentBeat, ContextBeat
    from aiorts.kernel.listening import ConnectorEvent, Happening
    from aiorts.kernel.machine import EventPort, StateMachine, StateMachineComponent
    from aiorts.kernel.machine_events import MachineAfter, MachineBefore, MachineChanged, MachineEnded
    from aiorts.kernel.modes import ModeChanged, MultiModeComponent, Participant
    from aiorts.kernel.reload_events import ComponentReloaded, Dropped, Reloaded
    from aiorts.kernel.supervision import Helped, HelpExhausted, Supervised
    from aiorts.kernel.watchdog import LoopStall, LoopStalls
    from aiorts.model.blame import Blame
    from aiorts.model.change import Change, Fresh
    from aiorts.model.charting import Chart, ChartWarning
    from aiorts.model.lifecycle import LifeCycleState
    from aiorts.model.naming import NamePolicy
    from aiorts.model.profile_schema import profile_schema
    from aiorts.model.sequence import StartRule
    from aiorts.model.statechart import After, Always, End, History, On, Parallel, State
    from aiorts.model.supervision import Supervision
    from aiorts.model.system_profile import SystemProfile
    from aiorts.running import run

__version__ = "0.1.0"

__all__ = (
    "After",
    "AiortsError",
    "Always",
    "Blame",
    "Bus",
    "CallFailed",
    "Catalogue",
    "Chart",
    "ChartWarning",
    "Change",
    "Clock",
    "Component",
    "ComponentAdded",
    "ComponentBeat",
    "ComponentReloaded",
    "ComponentRemoved",
    "Configuration",
    "ConfigurationSetActivated",
    "ConfigurationSetAdded",
    "ConfigurationSetChanged",
    "ConfigurationSetRemoved",
    "MachineChanged",
    "Composite",
    "CompositeChanged",
    "Connected",
    "Connector",
    "ConnectorEvent",
    "Context",
    "ContextBeat",
    "ContextStarted",
    "ContextStopped",
    "Declaration",
    "Disconnected",
    "Dropped",
    "End",
    "Event",
    "EventContext",
    "EventPort",
    "Extension",
    "ExternalContext",
    "History",
    "HelpExhausted",
    "Helped",
    "Fresh",
    "Happening",
    "HookAfter",
    "HookBefore",
    "HookFailed",
    "InPort",
    "Kernel",
    "LifeCycleState",
    "MachineAfter",
    "MachineBefore",
    "MachineEnded",
    "MemberAdded",
    "MemberRemoved",
    "ModeChanged",
    "MultiModeComponent",
    "On",
    "LoopStall",
    "LoopStalls",
    "NamePolicy",
    "OutPort",
    "Overrun",
    "Parallel",
    "Param",
    "ParameterAdded",
    "ParameterChanged",
    "ParameterRemoved",
    "ParametersChanged",
    "Participant",
    "PeriodicContext",
    "PortAdded",
    "PortRemoved",
    "Provided",
    "RateChanged",
    "RealtimeContext",
    "Reloaded",
    "Required",
    "ScaledClock",
    "ServiceCalled",
    "ServiceConnector",
    "ServicePort",
    "SimulatedClock",
    "State",
    "StateChanged",
    "StateMachine",
    "StateMachineComponent",
    "StartRule",
    "Supervised",
    "Supervision",
    "SystemClock",
    "SystemProfile",
    "ThreadContext",
    "ThreadsExhausted",
    "WouldBlock",
    "component",
    "declaration_of",
    "profile_schema",
    "run",
)

_HOMES = {
    "anyio": ("WouldBlock",),
    "aiorts.clock": ("Clock", "ScaledClock", "SimulatedClock", "SystemClock"),
    "aiorts.contexts": ("EventContext", "ExternalContext", "PeriodicContext", "RealtimeContext", "ThreadContext"),
    "aiorts.errors": ("AiortsError",),
    "aiorts.kernel": (
        *("Bus", "Component", "Connector", "Context", "InPort", "Kernel", "OutPort", "Param"),
        *("Provided", "Required", "ServiceConnector", "ServicePort"),
    ),
    "aiorts.kernel.configuration_events": (
        "ConfigurationSetActivated",
        "ConfigurationSetAdded",
        "ConfigurationSetChanged",
        "ConfigurationSetRemoved",
        "ParameterAdded",
        "ParameterChanged",
        "ParameterRemoved",
    ),
    "aiorts.kernel.configuring": ("Configuration",),
    "aiorts.kernel.catalogue": ("Catalogue", "Extension"),
    "aiorts.kernel.composite": ("Composite", "CompositeChanged"),
    "aiorts.kernel.function": ("component",),
    "aiorts.kernel.declarations": ("Declaration", "declaration_of"),
    "aiorts.kernel.machine": ("EventPort", "StateMachine", "StateMachineComponent"),
    "aiorts.kernel.machine_events": ("MachineChanged", "MachineAfter", "MachineBefore", "MachineEnded"),
    "aiorts.kernel.modes": ("ModeChanged", "MultiModeComponent", "Participant"),
    "aiorts.kernel.reload_events": ("ComponentReloaded", "Dropped", "Reloaded"),
    "aiorts.kernel.supervision": ("HelpExhausted", "Helped", "Supervised"),
    "aiorts.kernel.watchdog": ("LoopStall", "LoopStalls"),
    "aiorts.model.blame": ("Blame",),
    "aiorts.model.charting": ("Chart", "ChartWarning"),
    "aiorts.model.statechart": ("After", "Always", "End", "History", "On", "Parallel", "State"),
    "aiorts.model.lifecycle": ("LifeCycleState",),
    "aiorts.model.naming": ("NamePolicy",),
    "aiorts.model.sequence": ("StartRule",),
    "aiorts.model.supervision": ("Supervision",),
    "aiorts.kernel.heartbeats": ("ComponentBeat", "ContextBeat"),
    "aiorts.kernel.listening": ("ConnectorEvent", "Happening"),
    "aiorts.model.change": ("Change", "Fresh"),
    "aiorts.model.profile_schema": ("profile_schema",),
    "aiorts.model.system_profile": ("SystemProfile",),
    "aiorts.running": ("run",),
}
"""Where each public name lives; what is named nowhere is an event of the bus."""
_HOME = dict.fromkeys(__all__, "aiorts.kernel.bus") | {name: home for home, names in _HOMES.items() for name in names}
_MODULES = frozenset(("clock", "contexts", "errors", "kernel", "model", "system", "testing", "types", "wire"))
"""`import aiorts` is enough to say `aiorts.types.TimedDouble`."""

# Hidden from type checkers, which would otherwise believe in every name.
if not TYPE_CHECKING:

    def __getattr__(name: str) -> object:
        from importlib import import_module

        if name in _MODULES:
            return import_module(f"{__name__}.{name}")
        if name not in _HOME:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        found = globals()[name] = getattr(import_module(_HOME[name]), name)
        return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, *_MODULES})
