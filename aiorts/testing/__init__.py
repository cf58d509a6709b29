"""The test kit: a rig for components, exact virtual time, conformance suites, and components that misbehave on purpose.

Names are imported when they are first used, so that a pytest plugin costs nothing to those who do not use it.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from aiorts.testing import faults
    from aiorts.testing.codec_checks import CODEC_CHECKS, check_codec
    from aiorts.testing.component_checks import COMPONENT_CHECKS, check_component
    from aiorts.testing.conformance import ConformanceError
    from aiorts.testing.context_checks import CONTEXT_CHECKS, check_context
    from aiorts.testing.rig import Caught, Rig
    from aiorts.testing.samples import difference
    from aiorts.testing.simulated import simulated
    from aiorts.testing.simulation import SimulatedLoop, current_clock, simulate

__all__ = (
    "CODEC_CHECKS",
    "COMPONENT_CHECKS",
    "CONTEXT_CHECKS",
    "Caught",
    "ConformanceError",
    "Rig",
    "SimulatedLoop",
    "check_codec",
    "check_component",
    "check_context",
    "current_clock",
    "difference",
    "faults",
    "simulate",
    "simulated",
)

_HOMES = {
    "codec_checks": ("CODEC_CHECKS", "check_codec"),
    "component_checks": ("COMPONENT_CHECKS", "check_component"),
    "conformance": ("ConformanceError",),
    "context_checks": ("CONTEXT_CHECKS", "check_context"),
    "rig": ("Caught", "Rig"),
    "samples": ("difference",),
    "simulated": ("simulated",),
    "simulation": ("SimulatedLoop", "current_clock", "simulate"),
}
_HOME = {name: home for home, names in _HOMES.items() for name in names}

# Hidden from type checkers, which would otherwise believe in every name.
if not TYPE_CHECKING:

    def __getattr__(name: str) -> object:
        if name == "faults":
            return import_module("aiorts.testing.faults")
        if name not in _HOME:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        found = globals()[name] = getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
        return found
