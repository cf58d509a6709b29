"""Describes the system of a recording: kernel, components with their parameters, connections."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from typing import Any, Final

import aiorts
from aiorts import Microkernel

_MOST: Final = 1000
"""Components beyond which only their names are listed: the description is made in one step of the loop."""


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


def about_profile(profile: Mapping[str, Any], recorder: str) -> dict[str, Any]:
    """The data of `about_system` for a kernel in another process, from its profile as JSON has it."""
    versions, wires = profile["versions"], list(profile["connectors"].values())
    return {
        "kernel": profile["name"],
        "recorder": recorder,
        "segment": 1,
        "begun_ns": profile["clock"]["time_ns"],
        "clock": profile["clock"]["kind"],
        "made_by": f"aiorts {versions['aiorts']}, Python {versions['python']}, {platform.node()}",
        "components": {name: _reported(one) for name, one in profile["components"].items()},
        "connections": [
            {
                "from": wire["source"],
                "to": wire["target"],
                **{key: wire["options"][key] for key in ("subscription", "length", "full")},
            }
            for wire in wires[:_MOST]
        ],
    }


def _reported(component: Mapping[str, Any]) -> dict[str, Any]:
    params = {name: one["value"] for name, one in component["params"].items()}
    return {"type": component["type"].rpartition(":")[2].rpartition(".")[2], "params": params}


def _components(kernel: Microkernel) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for number, component in enumerate(list(kernel.components.values())):  # a copy: this may be another thread
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
