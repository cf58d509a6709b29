"""The part of the JSON Schema that is about `[[connections]]`: the declared options."""

from __future__ import annotations

from enum import StrEnum
from typing import Any, Final, get_args

from aiorts.model.declared import Option, kinds_of, options_of
from aiorts.model.profile import ConnectorProfile, PortLimits
from aiorts.system.schemas.template_schema import PART

_TEXT: Final = {"type": "string", "pattern": r"^\s*[+-]?[0-9._]+([eE][+-]?[0-9]+)?\s*$"}
_YES: Final = {
    "anyOf": [
        {"type": "boolean"},
        {"enum": [0, 1]},
        {
            "type": "string",
            "pattern": r"^\s*([yY][eE][sS]|[tT][rR][uU][eE]|1|[nN][oO]|[fF][aA][lL][sS][eE]|0|[eE][nN][aA][bB][lL][eE]"
            r"|[dD][iI][sS][aA][bB][lL][eE])\s*$",
        },
    ]
}


def _choice(kind: type[StrEnum], one: Option) -> dict[str, Any]:
    """The words of an option for an editor to offer, and the same in any case, with blanks round them."""
    words = [*(member.value for member in kind), *one.words, *([""] if one.default is None else [])]
    spelled = ("".join(f"[{c}{c.upper()}]" if c.isalpha() else c for c in word) for word in words)
    return {"anyOf": [{"enum": words}, {"type": "string", "pattern": rf"^\s*({'|'.join(spelled)})\s*$"}]}


def _number(kind: type, one: Option) -> dict[str, Any]:
    number = {"type": "integer" if kind is int else "number", "minimum": one.low}
    return {"anyOf": [number if one.endless else {**number, "maximum": one.high}, _TEXT]}


def _yes(others: tuple[Any, ...]) -> dict[str, Any]:
    words = [word for other in others for word in get_args(other)]
    texts = ("".join(f"[{c}{c.upper()}]" for c in word) for word in words)
    return {"anyOf": [*_YES["anyOf"], *({"type": "string", "pattern": rf"^\s*{text}\s*$"} for text in texts)]}


def _option(kinds: tuple[Any, ...], one: Option) -> dict[str, Any]:
    """What JSON Schema says of a declared option."""
    kind = kinds[0]
    if kind is bool:
        found = _yes(kinds[1:])
    elif kind is str:
        found = {"type": "string"} if one.low is None else {"type": "string", "minLength": one.low}
    else:
        found = _choice(kind, one) if issubclass(kind, StrEnum) else _number(kind, one)
    default = {} if one.default in (None, "") else {"default": str(one.default) if kind is str else one.default}
    unit = f" In {one.unit}." if one.unit else ""
    return {**found, **default, "description": f"{one.doc}{unit}"}


OPTIONS: Final[dict[str, dict[str, Any]]] = {
    key: _option(kinds_of(cls)[key], one)
    for cls in (ConnectorProfile, PortLimits)
    for key, one in options_of(cls).items()
}
"""By key. What `Kernel.connect` takes, and OpenRTM's words for the same values."""
_KEPT: Final = ("data_type", "interface_type", "buffer_type", "marshaling_type", "thread_type")
_ALIASES: Final = (
    *("dataflow_type", "subscription_type", "io_mode", "timestamp_policy", "allow_dup_connection"),
    "sync_readwrite",
)


def connection_schema(name: str) -> dict[str, Any]:
    """One entry of `[[connections]]`; `name` is the pattern of a component's or a port's name."""
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
            **{key: {"description": "Of OpenRTM's files: kept and reported, without effect."} for key in _KEPT},
            **{key: {"description": "OpenRTM's name of an option above."} for key in _ALIASES},
        },
        # OpenRTM's keys have dots, which are tables in TOML: `buffer.length = 4`.
        "additionalProperties": {"type": "object", "minProperties": 1},
    }
