"""Describes the system of a recording: kernel, components with their parameters, connections."""

from __future__ import annotations

import platform
from typing import Any, Final

import aiorts
from aiorts import Microkernel

_MOST: Final = 1000
"""Components beyond which only names are listed: the description is made in one step of the loop."""


def about_system(kernel: Microkernel, recorder: str, segment: int) -> dict[str, Any]:
    """Plain data for the metadata of a recording, as of now; `segment` counts from 1."""
    return {
        "kernel": kernel.name,
        "recorder": recorder,
        "segment": segment,
        "begun_ns": kernel.clock.time_ns(),
        "clock": type(kernel.clock).__name__,
        "made_by": f"aiorts {aiorts.__version__}, Python {platform.python_version()}, {platform.node()}",
        "components": _components(kernel),
        "connections": [_connection(one) for one in list(kernel.connectors.values())[:_MOST]],
    }


def _components(kernel: Microkernel) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for number, component in enumerate(list(kernel.components.values())):  # in one go: this may be another thread
        found[component.name] = {"type": type(component).__name__}
        if number < _MOST:
            found[component.name]["params"] = dict(component.configuration.values)
    return found


def _connection(connector: aiorts.Connector) -> dict[str, Any]:
    profile = connector.profile
    return {
        "from": connector.out.path,
        "to": connector.in_.path,
        "subscription": str(profile.subscription),
        "length": profile.length,
        "full": str(profile.full),
    }
