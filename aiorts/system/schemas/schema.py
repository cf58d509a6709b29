"""The JSON Schema (draft 2020-12) of system files, made of the installed types: editors complete and mark with it.

It accepts what the program accepts, texts for numbers included, and knows the parameters of every component type that
can be loaded. No schema can find faults between tables (a member that is no component): `check` does.
"""

from __future__ import annotations

import dataclasses
import enum
import inspect
import math
import re
import types
import typing
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

from aiorts.errors import AiortsError
from aiorts.kernel.component import Component
from aiorts.kernel.declarations import declarations
from aiorts.kernel.execution.context import Context
from aiorts.kernel.extensions.arguments import arguments_of, needs_rate
from aiorts.kernel.extensions.catalogue import Catalogue, Extension
from aiorts.kernel.service import load_service
from aiorts.model.configuration.parameters import Constraint, ParameterSpec
from aiorts.model.declared import Option, options_of, words_among
from aiorts.model.plain import Schema, SchemaForms
from aiorts.model.wanted.entries import ClockEntry, ContextEntry
from aiorts.system.file.parse import SCHEMA
from aiorts.system.schemas.connection_schema import connection_schema
from aiorts.system.schemas.option_schema import WHOLE_TEXT, YES_TEXT, limits_schema
from aiorts.system.schemas.table_schemas import (
    active_schema,
    component_schema,
    composite_schema,
    keys_schema,
    sets_schema,
    start_schema,
    supervision_schema,
)
from aiorts.system.schemas.template_schema import PART, include_schema, templated, variables_schema

T = typing.TypeVar("T")

_NAME: Final = "[A-Za-z0-9_][A-Za-z0-9_-]{0,99}"
_NUMBER: Final = r"^\s*[+-]?([0-9][0-9_]*\.?[0-9_]*([eE][+-]?[0-9_]+)?|\.[0-9_]+([eE][+-]?[0-9_]+)?|[iI][nN][fF]([iI][nN][iI][tT][yY])?|[nN][aA][nN])\s*$"  # noqa: E501
_BOUNDS: Final = {"ge": "minimum", "gt": "exclusiveMinimum", "le": "maximum", "lt": "exclusiveMaximum"}
_JSON: Final = {bool: "boolean", int: "integer", float: "number", str: "string", list: "array"}
_ARGUMENT: Final = re.compile(r"^ +(\w+(?:, \w+)*): (.*)")


def schema(catalogue: Catalogue | None = None, *, templates: bool = True) -> dict[str, Any]:
    """The schema as plain data, for `json.dumps`.

    Args:
        catalogue: the source of component types and contexts; the default catalogue by default.
        templates: whether texts such as "${name}" may stand for values, as in a file before it is expanded.
    """
    catalogue = Catalogue.default() if catalogue is None else catalogue
    components = _classes(catalogue, "components", lambda one: one.load_class(Component))
    contexts = _classes(catalogue, "contexts", lambda one: one.load_class(Context))
    made: dict[str, Any] = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "aiorts system file",
        "description": "Components, the connections between their ports, and the contexts that run them.",
        "type": "object",
        "required": ["schema"],
        "additionalProperties": False,
        "properties": {
            "schema": {"type": "integer", "const": SCHEMA, "description": "The version of this format."},
            "include": include_schema(rf"^{_NAME}\.{_NAME}$"),
            "variables": variables_schema(),
            "plugins": _plugins(),
            "clock": _clock(),
            "components": _named("component", "[components.NAME]: one component of the system."),
            "composites": _named("composite", "[composites.NAME]: components that look like one to all others."),
            "connections": {
                "type": "array",
                "description": "[[connections]]: which out-port sends to which in-ports.",
                "items": {"$ref": "#/$defs/connection"},
            },
            "contexts": _named("context", "[contexts.NAME]: when components run, and in which order."),
            **_services(catalogue),
        },
        "$defs": {
            "component": {"oneOf": [*(_component(*one) for one in components), _by_file()]},
            "composite": composite_schema(),
            "supervision": supervision_schema(),
            "start": start_schema(),
            "connection": connection_schema(_NAME),
            "context": {"oneOf": [_context(*one) for one in contexts]},
        },
    }
    return templated(made) if templates else made


def _named(kind: str, text: str) -> dict[str, Any]:
    """A table of entries by name."""
    names, entry = {"pattern": f"^{_NAME}$"}, {"$ref": f"#/$defs/{kind}"}
    return {"type": "object", "description": text, "propertyNames": names, "additionalProperties": entry}


def _classes(
    catalogue: Catalogue, kind: str, load: Callable[[Extension], type[T]]
) -> Iterator[tuple[str, type[T] | None]]:
    """Names and classes of a kind of extension; None if it does not load (`aiorts plugins --check` shows why)."""
    for name in catalogue.extensions(kind):
        try:
            yield name, load(catalogue.find(kind, name))
        except AiortsError:
            yield name, None


def _plugins() -> dict[str, Any]:
    return {
        "type": "object",
        "additionalProperties": False,
        "properties": {
            "path": {
                "type": "array",
                "items": {"type": "string"},
                "default": ["."],
                "description": "Folders with component files and plugin packages, below the system file's folder.",
            }
        },
    }


def _clock() -> dict[str, Any]:
    speed = keys_schema(ClockEntry)["speed"]
    return {
        "description": "How time passes, unless the command line says otherwise (--speed, --simulate).",
        "oneOf": [
            {
                "type": "object",
                "additionalProperties": False,
                "properties": {"kind": {"enum": ["system", "simulated"], "default": "system"}},
            },
            {
                "type": "object",
                "required": ["speed"],
                "additionalProperties": False,
                "properties": {"kind": {"const": "scaled"}, "speed": speed},
            },
        ],
    }


# -- components --------------------------------------------------------------------------------------------------------


def _component(name: str, cls: type[Component] | None) -> dict[str, Any]:
    kind: dict[str, Any] = {"const": name}
    params: dict[str, Any] = {"type": "object"}
    if cls is not None:
        kind["description"] = inspect.cleandoc(cls.__doc__ or name)
        specs = declarations(cls).parameters
        params |= {"additionalProperties": False, "properties": {one: _parameter(spec) for one, spec in specs.items()}}
    return _entry(kind, params, cls)


def _by_file() -> dict[str, Any]:
    text = "FILE.py:Class, a file below the system file's folder, or package.module:Class"
    return _entry(
        {"type": "string", "pattern": r"^([^:]+\.py|[^:/\\]+):[^:]+$", "description": text}, {"type": "object"}, None
    )


def _entry(kind: dict[str, Any], params: dict[str, Any], cls: type[Component] | None) -> dict[str, Any]:
    text = "Options as on the component's command line."
    for option in getattr(cls, "options", ()):
        if option.param:
            text += f"\n{', '.join(option.flags)}: {option.help}"
    options = {"type": ["array", "string"], "items": {"type": ["string", "number"]}, "description": text}
    return {
        "type": "object",
        "required": ["type"],
        "additionalProperties": False,
        "properties": {
            "type": kind,
            "options": options,
            "params": params,
            "sets": sets_schema(params, _NAME),
            "active": active_schema(),
            **component_schema(),
            **PART,
        },
    }


def _parameter(spec: ParameterSpec) -> dict[str, Any]:
    unit = f" [{spec.unit}]" if spec.unit else ""
    made = {"title": f"{spec.type_text}{unit}", **_Values(spec.constraint).of(spec.type)}
    if spec.doc:
        made["description"] = spec.doc
    if (default := _plain(spec.default)) is not None:
        made["default"] = default
    return made


class _Values(SchemaForms):
    """The schemas of a parameter's values, as TOML or as text."""

    def __init__(self, limits: Constraint) -> None:
        self._limits = limits
        super().__init__(
            simple={
                bool: {"anyOf": [{"type": "boolean"}, YES_TEXT]},
                int: self._number("integer", WHOLE_TEXT["pattern"]),
                float: self._number("number", _NUMBER),
                str: self._text(),
                Path: self._text(minLength=1),
                types.NoneType: {"type": "string", "pattern": r"^\s*[nN][oO][nN][eE]\s*$"},
            }
        )

    def _number(self, kind: str, pattern: str) -> Schema:
        limits = ((word, getattr(self._limits, name)) for name, word in _BOUNDS.items())
        bounds = {word: limit for word, limit in limits if limit is not None and math.isfinite(limit)}
        choices = {} if self._limits.choices is None else {"enum": list(self._limits.choices)}
        return {"anyOf": [{"type": kind, **bounds, **choices}, {"type": "string", "pattern": pattern}]}

    def _text(self, **limits: int) -> Schema:
        choices = {} if self._limits.choices is None else {"enum": list(map(str, self._limits.choices))}
        return {"type": "string", **limits, **choices}

    def fixed(self, hint: Any, items: list[Schema]) -> Schema:
        return {"anyOf": [super().fixed(hint, items), {"type": "string"}]}

    def many(self, hint: Any, kind: Any, item: Schema) -> Schema:
        return {"anyOf": [super().many(hint, kind, item), {"type": "string"}]}

    def mapping(self, hint: Any, kind: Any, key: Any, item: Schema) -> Schema:
        return {"anyOf": [super().mapping(hint, kind, key, item), {"type": "string"}]}

    def members(self, kind: type[enum.Enum]) -> Schema:
        return {"enum": _members(kind)}


def _members(kind: type[enum.Enum]) -> list[Any]:
    values = [member.value for member in kind if isinstance(member.value, str | int | float | bool)]
    return list(dict.fromkeys([*kind.__members__, *values, *map(str, values)]))


def _plain(value: Any) -> Any:
    """A default as a JSON value; None for a default that JSON cannot represent."""
    if isinstance(value, enum.Enum):
        return value.name
    if isinstance(value, tuple):
        parts = [_plain(one) for one in value]
        return None if None in parts else parts
    if isinstance(value, Path):
        return str(value)
    return None if isinstance(value, float) and not math.isfinite(value) else value


# -- services ----------------------------------------------------------------------------------------------------------


def _services(catalogue: Catalogue) -> dict[str, Any]:
    """The schema of each service's table."""
    found: dict[str, Any] = {}
    for name, service in _classes(catalogue, "services", load_service):
        if service is None:
            found[name] = {"type": "object"}
            continue
        cls = service.settings
        kinds = arguments_of(cls)
        keys = {
            one.name: _argument(cls, one.name, kinds[one.name], one.default, one.metadata.get("doc", ""))
            for one in dataclasses.fields(cls)
        }
        found[name] = {
            "type": "object",
            "description": inspect.cleandoc(cls.__doc__ or name).partition("\n\n")[0],
            "additionalProperties": False,
            "properties": keys,
        }
        if kinds.get(name) == (list,):  # [[NAME]]
            found[name] = keys[name]
    return found


def _argument(cls: type, name: str, kinds: tuple[type, ...], default: Any, text: str) -> dict[str, Any]:
    """The schema of a service's setting or a context's option; default and text are used where none is declared."""
    one = options_of(cls).get(name) or Option(text, default)
    made: dict[str, Any] = {}
    if words := words_among(cls, name):
        made["enum"] = words
    elif kinds:
        types_ = [_JSON[kind] for kind in kinds]
        made["type"] = types_ if len(types_) > 1 else types_[0]
    if one.doc:
        made["description"] = one.described
    if isinstance(one.default, str | bool | int | float):
        made["default"] = one.default
    return {**made, **limits_schema(one), **one.schema}


# -- contexts ----------------------------------------------------------------------------------------------------------


def _context(kind: str, cls: type[Context] | None) -> dict[str, Any]:
    made: dict[str, Any] = {
        "type": "object",
        "required": ["kind", "members"],
        "properties": {
            "kind": {"const": kind},
            "members": {
                "type": "array",
                "items": {"type": "string"},
                "uniqueItems": True,
                "description": "Components, in the order in which they run.",
            },
            **keys_schema(ContextEntry),
            **PART,
        },
    }
    if cls is None:
        return made
    made["additionalProperties"] = False
    made["properties"]["kind"]["description"] = inspect.cleandoc(cls.__doc__ or kind).partition("\n\n")[0]
    texts = _documented(cls)
    defaults = inspect.signature(cls).parameters
    for name, kinds in arguments_of(cls).items():
        made["properties"][name] = _argument(cls, name, kinds, defaults[name].default, texts.get(name, ""))
    if needs_rate(cls):
        made["required"] = ["kind", "rate", "members"]
        del made["properties"]["rate"]["default"]
    return made


def _documented(cls: type) -> dict[str, str]:
    """The descriptions of arguments, from signatures and `Args:` of a class and its bases; the class itself wins."""
    texts: dict[str, str] = {}
    for base in reversed(cls.__mro__):
        texts.update({name: one.described for name, one in options_of(base).items()})
        names: list[str] = []
        for line in inspect.cleandoc(base.__doc__ or "").partition("Args:\n")[2].splitlines():
            if (found := _ARGUMENT.match(line)) is not None:
                names = [] if found[2].startswith("see ") else found[1].split(", ")
                texts.update(dict.fromkeys(names, found[2]))
            elif not line.startswith("     "):
                names = []  # the next paragraph
            texts.update({name: f"{texts[name]} {line.strip()}" for name in names if found is None})
    return texts
