"""aiorts, the RT-Middleware for Python: robot software as components on an asyncio event-driven microkernel.

Names are imported when they are first used, so that a command's help or a tool that only asks for the version does not
pay for the kernel.
"""

from __future__ import annotations

from aiorts.late import TYPE_CHECKING
from aiorts.late import late as _late
from aiorts.late import provide as _provide

if TYPE_CHECKING:
    from typing import Any as _Any

    from anyio import WouldBlock

    from aiorts.assembly import Kernel
    from aiorts.clock import Clock, ScaledClock, SimulatedClock, SystemClock
    from aiorts.composites import Composite
    from aiorts.contexts import EventContext, ExternalContext, PeriodicContext, ThreadContext
    from aiorts.diagnostics import LoopStalls
    from aiorts.errors import AiortsError
    from aiorts.functions import component
    from aiorts.kernel import (
        Bus,
        Component,
        Connection,
        Connector,
        Context,
        InPort,
        KernelService,
        Microkernel,
        OutPort,
        Param,
        check_settings,
        setting,
        wait_any,
    )
    from aiorts.kernel.configuring import Configuration
    from aiorts.kernel.extensions.catalogue import Catalogue, Extension
    from aiorts.kernel.extensions.type_modules import import_types
    from aiorts.model.blame import Blame
    from aiorts.model.connect_options import ConnectOptions
    from aiorts.model.declared import Option
    from aiorts.model.lifecycle import LifecycleState
    from aiorts.model.naming import NamePolicy
    from aiorts.model.reading import PlainLimits
    from aiorts.observe import (
        Declaration,
        SystemProfile,
        declaration_of,
        profile_from_plain,
        profile_schema,
        profile_to_plain,
    )
    from aiorts.realtime import RealtimeContext
    from aiorts.reload import Dropped, Reloaded
    from aiorts.running import run
    from aiorts.services import Goal, Provided, Required, ServiceConnector, ServicePort, idempotent
    from aiorts.statemachines import EventPort, MultiModeComponent, Participant, StateMachine, StateMachineComponent
    from aiorts.supervision import StartRule, Supervised, Supervision
    from aiorts.sync import Synchronizer

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
    "ConnectOptions",
    "Connection",
    "Connector",
    "Context",
    "Declaration",
    "Dropped",
    "EventContext",
    "EventPort",
    "Extension",
    "ExternalContext",
    "Goal",
    "InPort",
    "Kernel",
    "KernelService",
    "LifecycleState",
    "LoopStalls",
    "Microkernel",
    "MultiModeComponent",
    "NamePolicy",
    "Option",
    "OutPort",
    "Param",
    "Participant",
    "PeriodicContext",
    "PlainLimits",
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
    "Synchronizer",
    "SystemClock",
    "SystemProfile",
    "ThreadContext",
    "WouldBlock",
    "check_settings",
    "component",
    "declaration_of",
    "idempotent",
    "import_types",
    "profile_from_plain",
    "profile_schema",
    "profile_to_plain",
    "run",
    "setting",
    "wait_any",
)

_late("clock", "contexts", "errors", "events", "kernel", "model", "statechart", "system", "testing", "types", "wire")
"""The events are in `aiorts.events`, the words of state charts in `aiorts.statechart`.

`import aiorts` is enough to say `aiorts.types.TimedDouble`.
"""


def _finders(kind: str) -> _Any:
    from aiorts.kernel.extensions.finders import FINDERS

    return FINDERS[kind]


_provide(("types", "declared types", "codecs"), _finders)
