"""The events that a kernel's bus, its connectors and `kernel.changes()` publish: typed, frozen values.

These are the names of the events; each is defined in the room that reports it.

`kernel.bus.subscribe(StateChanged, observer)` asks for one kind and all that are derived from it.
"""

from __future__ import annotations

from aiorts.late import TYPE_CHECKING
from aiorts.late import late as _late

if TYPE_CHECKING:
    from aiorts.composites import CompositeChanged
    from aiorts.diagnostics import LoopStall
    from aiorts.kernel.configuration_events import (
        ConfigurationSetActivated,
        ConfigurationSetAdded,
        ConfigurationSetChanged,
        ConfigurationSetRemoved,
        ParameterAdded,
        ParameterChanged,
        ParameterRemoved,
    )
    from aiorts.kernel.loop.bus import (
        Assembled,
        CallFailed,
        Closing,
        ComponentAdded,
        ComponentRemoved,
        Connected,
        ConnectorChanged,
        ContextStarted,
        ContextStopped,
        ConversionFailed,
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
    from aiorts.kernel.quality import WriterBack, WriterSilent
    from aiorts.observe import (
        Change,
        ComponentBeat,
        ConnectorEvent,
        ConnectorEventKind,
        ContextBeat,
        PastEvent,
        ProfileSnapshot,
    )
    from aiorts.reload import ComponentReloaded
    from aiorts.services import GoalAccepted, GoalEnded
    from aiorts.statemachines import MachineAfter, MachineBefore, MachineChanged, MachineEnded, ModeChanged
    from aiorts.supervision import ComponentRecovered, RestartLimitReached

__all__ = (
    "CallFailed",
    "Change",
    "Assembled",
    "Closing",
    "ComponentAdded",
    "ComponentBeat",
    "ComponentReloaded",
    "ComponentRemoved",
    "CompositeChanged",
    "ConfigurationSetActivated",
    "ConfigurationSetAdded",
    "ConfigurationSetChanged",
    "ConfigurationSetRemoved",
    "Connected",
    "ConnectorChanged",
    "ConnectorEvent",
    "ContextBeat",
    "ContextStarted",
    "ContextStopped",
    "ConversionFailed",
    "Disconnected",
    "Event",
    "PastEvent",
    "ProfileSnapshot",
    "ConnectorEventKind",
    "RestartLimitReached",
    "ComponentRecovered",
    "GoalAccepted",
    "GoalEnded",
    "HookAfter",
    "HookBefore",
    "HookFailed",
    "LoopStall",
    "MachineAfter",
    "MachineBefore",
    "MachineChanged",
    "MachineEnded",
    "MemberAdded",
    "MemberRemoved",
    "ModeChanged",
    "Overrun",
    "ParameterAdded",
    "ParameterChanged",
    "ParameterRemoved",
    "ParametersChanged",
    "PortAdded",
    "PortRemoved",
    "RateChanged",
    "ServiceCalled",
    "StateChanged",
    "ThreadsExhausted",
    "WriterBack",
    "WriterSilent",
)

_late()
