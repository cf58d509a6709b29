"""System files: a whole system as TOML, read and checked before anything is created, then built in a kernel."""

from __future__ import annotations

from aiorts.kernel.constructing import construct
from aiorts.system.arguments import option_params, parse_options
from aiorts.system.build import Blueprint, build, prepare
from aiorts.system.check import check, check_text
from aiorts.system.ending import is_source, wait_finished
from aiorts.system.findings import Finding
from aiorts.system.frames import FrameInput, FrameOutput
from aiorts.system.graph import FORMATS as GRAPH_FORMATS
from aiorts.system.graph import graph
from aiorts.system.load import load
from aiorts.system.parse import parse
from aiorts.system.pipes import StandardInput, StandardOutput
from aiorts.system.schema import schema
from aiorts.system.stream import LineStream
from aiorts.system.values import (
    ClockEntry,
    ComponentEntry,
    CompositeEntry,
    ConnectionEntry,
    ContextEntry,
    Override,
    SystemFile,
    WatchEntry,
)

__all__ = (
    "GRAPH_FORMATS",
    "Blueprint",
    "ClockEntry",
    "ComponentEntry",
    "CompositeEntry",
    "ConnectionEntry",
    "ContextEntry",
    "FrameInput",
    "FrameOutput",
    "Finding",
    "LineStream",
    "Override",
    "StandardInput",
    "StandardOutput",
    "SystemFile",
    "WatchEntry",
    "build",
    "check",
    "check_text",
    "construct",
    "graph",
    "is_source",
    "load",
    "option_params",
    "parse",
    "parse_options",
    "prepare",
    "schema",
    "wait_finished",
)
