"""Looks into a kernel: its profile, changes of it, chosen values, samples of out-ports, heart-beats, listeners.

It is a service of the kernel, made at the first look. Nothing in it changes the system: samples are copied by a tap.
"""

from __future__ import annotations

from aiorts.late import TYPE_CHECKING, late

if TYPE_CHECKING:
    from aiorts.observe.change_values import Change, PastEvent, ProfileSnapshot
    from aiorts.observe.changes import Changes, system_profile_in_turns
    from aiorts.observe.declaration import Declaration, declaration_of
    from aiorts.observe.heartbeats import ComponentBeat, ContextBeat
    from aiorts.observe.html import html_of, kernel_html
    from aiorts.observe.introspection import Introspection
    from aiorts.observe.listening import ConnectorEvent, ConnectorEventKind, Listening
    from aiorts.observe.monitor import Monitor, Reading
    from aiorts.observe.part import SystemPart, system_part
    from aiorts.observe.profiles import (
        ComponentReport,
        CompositeReport,
        ConnectorReport,
        ContextReport,
        MachineReport,
        ModeReport,
        ParameterReport,
        SystemProfile,
    )
    from aiorts.observe.profiling import context_report, declared_params, system_profile, visible
    from aiorts.observe.reading import ToldChange, ToldSnapshot, profile_from_plain, profile_to_plain
    from aiorts.observe.samples import Samples, out_port_of, when_removed
    from aiorts.observe.schema import profile_schema
    from aiorts.observe.special_reports import calls, thread_writes

late()
