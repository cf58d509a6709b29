"""System files: a whole system as TOML, read and checked before anything is created, then built in a kernel."""

from __future__ import annotations

from aiorts.system.build import Blueprint, build, prepare
from aiorts.system.ending import is_source, wait_finished
from aiorts.system.frames import FrameInput, FrameOutput
from aiorts.system.load import load
from aiorts.system.parse import parse
from aiorts.system.pipes import StandardInput, StandardOutput
from aiorts.system.stream import LineStream
from aiorts.system.values import ComponentEntry, ConnectionEntry, ContextEntry, Override, SystemFile

__all__ = (
    "Blueprint",
    "ComponentEntry",
    "ConnectionEntry",
    "ContextEntry",
    "FrameInput",
    "FrameOutput",
    "LineStream",
    "Override",
    "StandardInput",
    "StandardOutput",
    "SystemFile",
    "build",
    "is_source",
    "load",
    "parse",
    "prepare",
    "wait_finished",
)
