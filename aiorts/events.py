"""What a kernel's bus, its connectors and `kernel.watch()` tell: every typed event, as a frozen value.

`kernel.bus.subscribe(StateChanged, observer)` asks for one kind and all that are derived from it.
"""

from __future__ import annotations

from aiorts.late import late as _late

TYPE_CHECKING = False

if TYPE_CHECKING:
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
    from aiorts.kernel.composite import CompositeChanged
    from aiorts.kernel.configuration_events import (
        ConfigurationSetActivated,
        ConfigurationSetAdded,
        ConfigurationSetChanged,
        ConfigurationSetRemoved,
        ParameterAdded,
        ParameterChanged,
        ParameterRemoved,
    )
    from aiorts.kernel.heartbeats import ComponentBeat, ContextBeat
    from aiorts.kernel.listening import ConnectorEvent, Happening
    from aiorts.kernel.machine_events import MachineAfter, MachineBefore, MachineChanged, MachineEnded
    from aiorts.kernel.modes import ModeChanged
    from aiorts.kernel.reload_events import ComponentReloaded
    from aiorts.kernel.supervision import Helped, HelpExhausted
    from aiorts.kernel.watchdog import LoopStall
    from aiorts.model.change import Change, Fresh

__all__ = (
    "CallFailed",
    "Change",
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
    "ConnectorEvent",
    "ContextBeat",
    "ContextStarted",
    "ContextStopped",
    "Disconnected",
    "Event",
    "Fresh",
    "Happening",
    "HelpExhausted",
    "Helped",
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
)

_HOMES = {
    "aiorts.kernel.bus": (
        "CallFailed",
        "ComponentAdded",
        "ComponentRemoved",
        "Connected",
        "ContextStarted",
        "ContextStopped",
        "Disconnected",
        "Event",
        "HookAfter",
        "HookBefore",
        "HookFailed",
        "MemberAdded",
        "MemberRemoved",
        "Overrun",
        "ParametersChanged",
        "PortAdded",
        "PortRemoved",
        "RateChanged",
        "ServiceCalled",
        "StateChanged",
        "ThreadsExhausted",
    ),
    "aiorts.kernel.composite": ("CompositeChanged",),
    "aiorts.kernel.configuration_events": (
        "ConfigurationSetActivated",
        "ConfigurationSetAdded",
        "ConfigurationSetChanged",
        "ConfigurationSetRemoved",
        "ParameterAdded",
        "ParameterChanged",
        "ParameterRemoved",
    ),
    "aiorts.kernel.heartbeats": (
        "ComponentBeat",
        "ContextBeat",
    ),
    "aiorts.kernel.listening": (
        "ConnectorEvent",
        "Happening",
    ),
    "aiorts.kernel.machine_events": (
        "MachineAfter",
        "MachineBefore",
        "MachineChanged",
        "MachineEnded",
    ),
    "aiorts.kernel.modes": ("ModeChanged",),
    "aiorts.kernel.reload_events": ("ComponentReloaded",),
    "aiorts.kernel.supervision": (
        "Helped",
        "HelpExhausted",
    ),
    "aiorts.kernel.watchdog": ("LoopStall",),
    "aiorts.model.change": (
        "Change",
        "Fresh",
    ),
}
"""Where each name lives; imported when it is first used."""

# Hidden from type checkers, which would otherwise believe in every name.
if not TYPE_CHECKING:
    __getattr__ = _late(__name__, _HOMES)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
