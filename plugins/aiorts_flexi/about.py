"""What a recording says of the system that it is of: kernel, components with their parameters, connections."""

from __future__ import annotations

import platform
from typing import Any, Final

import aiorts
from aiorts import Component, Kernel

__all__ = ("about",)

_MOST: Final = 1000
"""Components of which more than the name is told: it is all said in one step of the loop."""


def about(logger: Component, segment: int) -> dict[str, Any]:
    """Plain data for the metadata of a recording, of this moment; `segment` counts the activations from 1."""
    kernel = logger.kernel
    return {
        "kernel": kernel.name,
        "recorder": logger.name,
        "segment": segment,
        "begun_ns": kernel.clock.time_ns(),
        "clock": type(kernel.clock).__name__,
        "made_by": f"aiorts {aiorts.__version__}, Python {platform.python_version()}, {platform.node()}",
        "components": _components(kernel),
        "connections": [_connection(one) for one in list(kernel.connectors.values())[:_MOST]],
    }


def _components(kernel: Kernel) -> dict[str, Any]:
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
