"""The part of the JSON Schema that is about expansion: included files, variables, conditions, repeated parts."""

from __future__ import annotations

from typing import Any, Final

from aiorts.system.expansion.repeating import MOST

_IN_NAMES: Final = r"\$\{|\{i"
TEMPLATE: Final[dict[str, Any]] = {"$ref": "#/$defs/template"}
DEFINITION: Final[dict[str, Any]] = {
    "type": "string",
    "pattern": _IN_NAMES,
    "description": "A text with a variable, ${name}, or with the number of a repeated part, {i}.",
}
PART: Final[dict[str, Any]] = {
    "if": {
        "type": "boolean",
        "description": 'Whether it is there: "${name}" or "not ${name}", of a variable that is true or false.',
    },
    "repeat": {
        "type": "integer",
        "minimum": 0,
        "maximum": MOST,
        "description": "How often it is there; {i} in its texts is the number of each, from 0.",
    },
}
"""Keys that every component, composite, connection, context and include may have."""
_ANNOTATIONS: Final = ("title", "description", "default")


def include_schema(port: str) -> dict[str, Any]:
    """The schema of `include` and `[[include]]`; `port` is the pattern of COMPONENT.PORT."""
    remap = {"anyOf": [{"type": "string", "pattern": port}, {"type": "object"}]}
    return {
        "description": '[[include]]: other system files, whose parts become parts of this; also include = ["a.toml"].',
        "type": ["array", "string"],
        "items": {
            "type": ["object", "string"],
            "required": ["file"],
            "additionalProperties": False,
            "properties": {
                "file": {"type": "string", "description": "The file, counted from the folder of this one."},
                "prefix": {"type": "string", "description": "What its names begin with here, such as left_."},
                "vars": {"type": "object", "description": "Values of its variables, by name."},
                "remap": {
                    "type": "object",
                    "additionalProperties": remap,
                    "description": "Ports of this system by ports of its connections, in whose place they come.",
                },
                **PART,
            },
        },
    }


def variables_schema() -> dict[str, Any]:
    """The schema of `[variables]`."""
    return {
        "description": "[variables]: defaults by name, for ${name} in texts; --var, or vars of an include, wins.",
        "type": "object",
        "propertyNames": {"pattern": "^[A-Za-z_][A-Za-z0-9_-]{0,99}$"},
        "additionalProperties": {"type": ["string", "number", "boolean", "array"]},
        "properties": {
            "env": {
                "type": "array",
                "items": {"type": "string"},
                "description": "The variables that the environment may set; no other is read from it.",
            }
        },
    }


def templated(made: dict[str, Any]) -> dict[str, Any]:
    """The whole schema, in which a template may stand for each value."""
    top, defs = made["properties"], made["$defs"]
    for name, table in top.items():
        if name not in ("schema", "variables"):
            for one in table.get("oneOf", [table]):
                if "properties" in one:
                    one["properties"] = {**one["properties"], "if": PART["if"]}
            top[name] = _inside(table)
            if "propertyNames" in table:
                top[name]["propertyNames"] = {"anyOf": [table["propertyNames"], {"pattern": _IN_NAMES}]}
    for name, table in defs.items():
        defs[name] = _inside(table)
    members = {"type": ["array", "string"], "items": {"type": "string"}}
    defs["context"]["oneOf"].append(
        {
            "type": "object",
            "required": ["kind", "members"],
            "properties": {"kind": {"type": "string", "pattern": _IN_NAMES}, "members": members},
        }
    )
    defs["template"] = DEFINITION
    return made


def _inside(node: Any) -> Any:
    """The schema of a table, or of a choice of tables, in which a template may replace each value."""
    if not isinstance(node, dict):
        return node
    made = dict(node)
    for word in ("oneOf", "allOf"):
        if word in made:
            made[word] = [_inside(one) for one in made[word]]
    if "properties" in made:
        made["properties"] = {name: _value(one) for name, one in made["properties"].items()}
    if isinstance(made.get("additionalProperties"), dict):
        made["additionalProperties"] = _value(made["additionalProperties"])
    if "items" in made:
        made["items"] = _value(made["items"])
    return made


def _value(node: Any) -> Any:
    if not isinstance(node, dict) or "$ref" in node or "const" in node:
        return node
    if "properties" in node or node.get("type") == "object" or "oneOf" in node:
        return _inside(node)
    if "prefixItems" in node:
        node = {**node, "prefixItems": [_value(one) for one in node["prefixItems"]]}
    if "items" in node:
        node = {**node, "items": _value(node["items"])}
    if not node.keys() - {*_ANNOTATIONS} or (node.get("type") == "string" and "pattern" not in node):
        return node  # any text will do
    told = {word: node[word] for word in _ANNOTATIONS if word in node}
    own = {word: one for word, one in node.items() if word not in told}
    choices = [_value(one) for one in own["anyOf"]] if list(own) == ["anyOf"] else [own]
    return {**told, "anyOf": [*choices, TEMPLATE]}
