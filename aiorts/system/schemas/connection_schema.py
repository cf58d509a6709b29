"""The part of the JSON Schema that is about `[[connections]]`: the declared options."""

from __future__ import annotations

from typing import Any, Final

from aiorts.model.declared import kinds_of, options_of
from aiorts.model.options import ALIASES, KEPT, PortLimits
from aiorts.model.profile import ConnectorProfile
from aiorts.system.schemas.option_schema import option_schema
from aiorts.system.schemas.template_schema import PART

OPTIONS: Final[dict[str, dict[str, Any]]] = {
    key: option_schema(kinds_of(cls)[key], one)
    for cls in (ConnectorProfile, PortLimits)
    for key, one in options_of(cls).items()
}
"""The schemas by key: the values of `Kernel.connect`, and OpenRTM's words for the same values."""
_ALIASES: Final = [alias for alias, _ in ALIASES if "." not in alias and alias not in OPTIONS]


def connection_schema(name: str) -> dict[str, Any]:
    """The schema of one entry of `[[connections]]`; `name` is the pattern of a component's or a port's name."""
    port = {"type": "string", "pattern": rf"^(?:(?:[^/]+/)?{name}/)?{name}\.{name}$"}
    return {
        "type": "object",
        "required": ["from", "to"],
        "properties": {
            "from": {
                **port,
                "description": "COMPONENT.PORT of the out-port; KERNEL/COMPONENT.PORT elsewhere.",
            },
            "to": {
                "anyOf": [port, {"type": "array", "items": port, "minItems": 1}],
                "description": "COMPONENT.PORT of the in-port, or a list of several.",
            },
            **PART,
            **OPTIONS,
            **{key: {"description": "Of OpenRTM's files: kept and reported, without effect."} for key in KEPT},
            **{key: {"description": "OpenRTM's name of an option above."} for key in _ALIASES},
        },
        # OpenRTM's keys have dots, which are tables in TOML: `buffer.length = 4`.
        "additionalProperties": {"type": "object", "minProperties": 1},
    }
