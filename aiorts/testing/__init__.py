"""The test kit: a rig for components, exact virtual time, conformance suites, and components that misbehave on purpose.

Names are imported when they are first used, so that a pytest plugin costs nothing to those who do not use it.
"""

from __future__ import annotations

from aiorts.late import TYPE_CHECKING
from aiorts.late import late as _late

if TYPE_CHECKING:
    from aiorts.statemachines import ChartCoverage, ChartPath, ChartPaths, Move, chart_coverage, chart_paths
    from aiorts.testing import faults
    from aiorts.testing.codec_checks import CODEC_CHECKS, check_codec
    from aiorts.testing.component_checks import COMPONENT_CHECKS, check_component
    from aiorts.testing.conformance import ConformanceError
    from aiorts.testing.context_checks import CONTEXT_CHECKS, check_context
    from aiorts.testing.converter_checks import CONVERTER_CHECKS, check_converter
    from aiorts.testing.decorator import simulated
    from aiorts.testing.memory_links import MemoryNetwork
    from aiorts.testing.rig import Caught, Rig
    from aiorts.testing.samples import difference
    from aiorts.testing.service_checks import SERVICE_CHECKS, check_service
    from aiorts.testing.simulation import SimulatedLoop, current_clock, simulate
    from aiorts.testing.transport_checks import TRANSPORT_CHECKS, check_transport

__all__ = (
    "CODEC_CHECKS",
    "COMPONENT_CHECKS",
    "CONTEXT_CHECKS",
    "CONVERTER_CHECKS",
    "SERVICE_CHECKS",
    "TRANSPORT_CHECKS",
    "Caught",
    "ChartCoverage",
    "ChartPath",
    "ChartPaths",
    "ConformanceError",
    "MemoryNetwork",
    "Move",
    "Rig",
    "SimulatedLoop",
    "chart_coverage",
    "chart_paths",
    "check_codec",
    "check_component",
    "check_context",
    "check_converter",
    "check_service",
    "check_transport",
    "current_clock",
    "difference",
    "faults",
    "simulate",
    "simulated",
)

_late("faults")
