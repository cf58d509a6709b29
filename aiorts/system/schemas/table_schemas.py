"""The JSON Schema of sets, supervision, start and composites: tables of keys, with descriptions."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Final

from aiorts.model.declared import kinds_of, options_of
from aiorts.model.lifecycle import CYCLE_HOOKS
from aiorts.model.wanted.entries import ComponentEntry, CompositeEntry
from aiorts.model.wanted.restart_policy import ACTING
from aiorts.processes import Limits
from aiorts.supervision import StartRule, Supervision
from aiorts.system.schemas.option_schema import plain_schema
from aiorts.system.schemas.template_schema import PART

_SECONDS: Final = {"type": "number", "exclusiveMinimum": 0}
_CONDITION: Final = {"type": "string", "pattern": r"^\s*[A-Za-z0-9_-]+(\s+(added|inactive|active|error))?\s*$"}
_KEYS: Final = options_of(ComponentEntry)
_TEXTS: Final = {"type": "array", "items": {"type": "string"}}
_OF_COMPOSITE: Final = {
    key: {"anyOf": kinds, "description": options_of(CompositeEntry)[key].doc}
    for key, kinds in (
        ("exported", [_TEXTS, {"type": "string"}, {"type": "object", "additionalProperties": {"type": "string"}}]),
        ("groups", [{"type": "string"}, {"type": "array", "items": _TEXTS}]),
    )
}


def sets_schema(params: dict[str, Any], name: str) -> dict[str, Any]:
    """The schema of `[components.X.sets.NAME]`; `params` is that of its parameters."""
    return {
        "type": "object",
        "description": "[components.X.sets.NAME]: named configuration sets; what one does not name is as under params.",
        "propertyNames": {"pattern": f"^(?!default$|_){name}$"},
        "additionalProperties": params,
    }


def active_schema() -> dict[str, Any]:
    """The schema of a component's `active`."""
    return {"type": "string", "description": "The configuration set in force: one of sets, of its class, or default."}


def component_schema() -> dict[str, Any]:
    """The schemas of a component's declared keys."""
    tables = {
        "supervision": {"$ref": "#/$defs/supervision"},
        "start": {"$ref": "#/$defs/start"},
        "limits": _table(_KEYS["limits"].doc, keys_schema(Limits)),
    }
    return keys_schema(ComponentEntry, tables)


def keys_schema(cls: type, tables: Mapping[str, dict[str, Any]] = MappingProxyType({})) -> dict[str, Any]:
    """The schemas of a class's declared keys: for a table that in `tables`, for another key that of its type."""
    kinds, keys = kinds_of(cls), options_of(cls).items()
    return {key: tables.get(key) or plain_schema(kinds[key][0], one) for key, one in keys}


def supervision_schema() -> dict[str, Any]:
    """The schema of `[components.X.supervision]`."""
    deadlines = _table(options_of(Supervision)["deadlines"].described, dict.fromkeys(CYCLE_HOOKS, _SECONDS))
    keys = _table(_KEYS["supervision"].doc, keys_schema(Supervision, {"deadlines": deadlines}))
    return keys | {"anyOf": [{"required": [word]} for word in ACTING]}


def start_schema() -> dict[str, Any]:
    """The schema of `[components.X.start]`."""
    after = {"anyOf": [_CONDITION, {"type": "array", "items": _CONDITION}]}
    described = {**after, "description": options_of(StartRule)["after"].described}
    return _table(_KEYS["start"].doc, keys_schema(StartRule, {"after": described}))


def composite_schema() -> dict[str, Any]:
    """The schema of `[composites.NAME]`."""
    made = _table(
        "[composites.NAME]: components that look like one to all others.",
        {
            "members": {
                **_TEXTS,
                "uniqueItems": True,
                "description": "Components, composites, KERNEL/COMPONENT elsewhere, in the order in which they run.",
            },
            **keys_schema(CompositeEntry, _OF_COMPOSITE),
            **PART,
        },
    )
    return {**made, "required": ["members"]}


def _table(text: str, properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": "object", "description": text, "additionalProperties": False, "properties": properties}
