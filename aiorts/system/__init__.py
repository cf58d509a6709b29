"""System files: a whole system as TOML, read and checked before anything is created, then built in a kernel."""

from __future__ import annotations

from aiorts.late import TYPE_CHECKING, late

if TYPE_CHECKING:
    from aiorts.kernel.component import construct
    from aiorts.kernel.loop.line_stream import LineStream, standard_output
    from aiorts.model.wanted.entries import (
        ClockEntry,
        ComponentEntry,
        CompositeEntry,
        ConnectionEntry,
        ContextEntry,
        Wanted,
        said_keys,
        with_option,
    )
    from aiorts.model.wanted.system_text import system_text
    from aiorts.system.blueprint import Blueprint, build, prepare
    from aiorts.system.checks.check import check, check_text
    from aiorts.system.checks.findings import Finding
    from aiorts.system.checks.running import check_running
    from aiorts.system.draw.graph import GRAPH_FORMATS, graph
    from aiorts.system.draw.running import running_graph
    from aiorts.system.ending import Ending, ended_in_error, is_source, wait_finished
    from aiorts.system.expansion.choices import AS_WRITTEN, Choices
    from aiorts.system.file.arguments import option_params, parse_options
    from aiorts.system.file.load import load
    from aiorts.system.file.parse import parse
    from aiorts.system.file.values import Override, SystemFile
    from aiorts.system.schemas.schema import schema
    from aiorts.system.stdio.frames import FrameInput, FrameOutput
    from aiorts.system.stdio.live import LiveInput
    from aiorts.system.stdio.pipes import StandardInput, StandardOutput
    from aiorts.system.wanting import wanted

__all__ = (
    "GRAPH_FORMATS",
    "AS_WRITTEN",
    "Blueprint",
    "Choices",
    "ClockEntry",
    "ComponentEntry",
    "CompositeEntry",
    "ConnectionEntry",
    "ContextEntry",
    "Ending",
    "FrameInput",
    "FrameOutput",
    "Finding",
    "LineStream",
    "LiveInput",
    "Override",
    "StandardInput",
    "StandardOutput",
    "SystemFile",
    "Wanted",
    "build",
    "check",
    "check_running",
    "check_text",
    "construct",
    "ended_in_error",
    "graph",
    "is_source",
    "load",
    "option_params",
    "parse",
    "parse_options",
    "prepare",
    "running_graph",
    "schema",
    "standard_output",
    "system_text",
    "wait_finished",
    "wanted",
    "said_keys",
    "with_option",
)

late()
