"""System files made of a JSON Schema, as plain data: right ones, and the same with something wrong."""

from __future__ import annotations

import copy
import json
import math
import re
from collections import Counter
from collections.abc import Iterator
from random import Random
from typing import Any

Place = tuple[str, ...]
"""A part of a schema: the keys that lead to it from its definition."""

TEXTS = (
    *("a", "b", "a.out", "b.inp", "elsewhere/a.out", "elsewhere/b.inp", "a active", "b added", "c", "c.inp", "group"),
    *("parts.py:Source", "parts.py:Sink", "./part.toml", "4", "0.25", "1e-3", "0x10", "0o17", "0b101", "inf", "none"),
    *("on", "Off", " yes ", "No", "TRUE", "false", "1", "0", "enable", "Disable", "4.0", "1e3", "_", "-3", "Text"),
    *(" Skip ", "new", "FLUSH", "Periodic", "block", "overwrite", "push", "Pull", "wait", "readback", "send", "${one}"),
    *("*.out", "a{i}", "on_write", "", " ", "no such word", "/", "x.y.z", "default", "_own", "slow"),
)
"""What is tried as a text, and chosen from where a text has a form."""
STRANGE = (
    *(True, False, 0, 1, -1, 2, 0.5, -0.5, 4.0, 1e13, -1e300, 2**63 - 1, math.inf, -math.inf, [], [1], ["a"], [[]]),
    *([["a"], ["b"]], [{}], {}, {"a": 1}, {"a": {"b": 1}}, {"a.out": "b"}),
)
"""What is tried in the place of any value."""
_COMPONENTS = {"a": {"type": "parts.py:Source"}, "b": {"type": "parts.py:Sink"}}
"""Components that every file has, to be connected and run."""
_TEMPLATE = {"$ref": "#/$defs/template"}
_WHOLES = (0, 1, 3, 100)
_NUMBERS = (0, 0.001, 1, 2.5, 10.0)


def parts_of(schema: dict[str, Any]) -> dict[Place, dict[str, Any]]:
    """The parts of a schema that say something of a value: each property, item and choice, of each definition."""
    found: dict[Place, dict[str, Any]] = {}

    def add(node: Any, place: Place) -> None:
        if not isinstance(node, dict) or "$ref" in node:
            return
        found[place] = node
        for step, inner in _inside(node):
            add(inner, (*place, *step))

    add({key: value for key, value in schema.items() if key != "$defs"}, ())
    for name, node in schema["$defs"].items():
        add(node, ("$defs", name))
    return found


def _inside(node: dict[str, Any]) -> Iterator[tuple[Place, Any]]:
    for key, inner in node.get("properties", {}).items():
        yield ("properties", key), inner
    for word in ("oneOf", "anyOf", "prefixItems"):
        for number, inner in enumerate(node.get(word, ())):
            if "required" not in inner or "properties" in inner:  # else a condition, and no value
                yield (word, str(number)), inner
    for word in ("additionalProperties", "items"):
        yield (word,), node.get(word)


def _index(step: Place) -> str | int:
    return step[1] if step[0] == "properties" else int(step[1])


class Maker:
    """Makes values that a schema accepts, of those parts first that it made the fewest of."""

    def __init__(self, schema: dict[str, Any], chance: Random) -> None:
        self._schema = schema
        self._chance = chance
        self._sizes: dict[int, int] = {}
        self.made = Counter[Place]()
        """By part of the schema."""
        self.wrong = Counter[Place]()
        """By keys that lead to a value, without names and numbers: how often it was changed."""
        self._keys = {place[-1] for place in parts_of(schema) if place[-2:-1] == ("properties",)}

    def file(self) -> dict[str, Any]:
        """A system file."""
        file = {"schema": 1, **self.value(self._schema, ())}
        if "${one}" in json.dumps(file):
            file.setdefault("variables", {})["one"] = self._chance.choice((1, 2.5, True, "a", ["a"]))
        return file | {"components": {**copy.deepcopy(_COMPONENTS), **file.get("components", {})}}

    def marred(self, file: dict[str, Any]) -> dict[str, Any]:
        """The file with one thing changed: another value, a key misspelt, unknown or missing."""
        made, chance = copy.deepcopy(file), self._chance
        usual = {("components", name) for name, one in _COMPONENTS.items() if made["components"][name] == one}
        places = [place for place in _places(made, ()) if place[:2] not in usual]
        spots = {place: tuple(key for key in place if key in self._keys) for place in places}
        *above, key = min(places, key=lambda place: (self.wrong[spots[place]], chance.random()))
        self.wrong[spots[(*above, key)]] += 1
        holder: Any = made
        for one in above:
            holder = holder[one]
        if type(holder[key]) in (int, float) and chance.random() < 0.5:
            holder[key] = chance.choice((holder[key] + 1, holder[key] - 1, -1, 10**10))
        elif not isinstance(holder, dict) or chance.random() < 0.3:
            holder[key] = copy.deepcopy(chance.choice(chance.choice((STRANGE, TEXTS))))
        elif chance.random() < 0.6:
            wrong = chance.choice((f"{key}{key[-1:]}", key[:-1] + "q", key.title(), "unknown"))
            holder[wrong] = holder.pop(key)
        elif chance.random() < 0.7:
            holder["unknown"] = copy.deepcopy(chance.choice(STRANGE))
        else:
            del holder[key]
        return made

    def value(self, node: dict[str, Any], place: Place) -> Any:
        if "$ref" in node:
            self.made[place] += 1
            place = tuple(node["$ref"].removeprefix("#/").split("/"))
            node = self._schema["$defs"][place[-1]]
        self.made[place] += 1
        for word in ("oneOf", "anyOf"):
            choices = [step for step, one in _inside(node) if step[0] == word and one != _TEMPLATE]
            if choices and _TEMPLATE in node[word] and self._chance.random() < 0.01:
                return self._text(self._schema["$defs"]["template"], ("$defs", "template"))
            if choices:
                step = self._fewest(node, place, choices)
                return self.value(node[word][_index(step)], (*place, *step))
        if "const" in node or "enum" in node:
            return self._chance.choice(node["enum"]) if "enum" in node else node["const"]
        kinds = node.get("type", "object" if "properties" in node else ["string", "integer", "boolean"])
        kind = self._chance.choice([kinds[0], *kinds]) if isinstance(kinds, list) else kinds
        makers = {"object": self._table, "array": self._list, "string": self._text, "boolean": self._yes}
        return makers[kind](node, place) if kind in makers else self._number(node, whole=kind == "integer")

    def _fewest(self, node: dict[str, Any], place: Place, steps: list[Place]) -> Place:
        """The step to what was made the most seldom for its size."""

        def share(step: Place) -> tuple[float, float]:
            return self.made[(*place, *step)] / (30 + self._size(node[step[0]][_index(step)])), self._chance.random()

        return min(steps, key=share)

    def _size(self, node: dict[str, Any]) -> int:
        """The number of parts below a part."""
        if id(node) not in self._sizes:
            there = self._schema["$defs"][node["$ref"].rpartition("/")[2]] if "$ref" in node else node
            self._sizes[id(node)] = 1 + sum(self._size(one) for _, one in _inside(there) if isinstance(one, dict))
        return self._sizes[id(node)]

    def _table(self, node: dict[str, Any], place: Place) -> dict[str, Any]:
        properties, needed = node.get("properties", {}), [*node.get("required", ())]
        if "anyOf" in node:  # one of several keys has to be there
            needed += self._chance.choice(node["anyOf"])["required"]
        free = [key for key in properties if key not in needed]
        for _ in range(min(len(free), self._chance.choice((1, 2, 3)))):
            needed.append(self._fewest(node, place, [("properties", key) for key in free])[1])
            free.remove(needed[-1])
        table = {key: self.value(properties[key], (*place, "properties", key)) for key in needed}
        others = node.get("additionalProperties", {})
        if isinstance(others, dict) and (not properties or self._chance.random() < 0.25):
            for _ in range(max(node.get("minProperties", 0), self._chance.choice((0, 1, 1, 2)))):
                name = self._one_of(node.get("propertyNames", {}))
                if name not in properties:
                    made = self.value(others, (*place, "additionalProperties"))
                    repeated = isinstance(made, dict) and "repeat" in made
                    table[f"{name}{{i}}" if repeated else name] = made
        return table

    def _list(self, node: dict[str, Any], place: Place) -> list[Any]:
        if "prefixItems" in node:
            return [
                self.value(one, (*place, "prefixItems", str(number))) for number, one in enumerate(node["prefixItems"])
            ]
        count = max(node.get("minItems", 0), self._chance.choice((0, 1, 1, 1, 2, 2)))
        made = [self.value(node.get("items", {"type": "string"}), (*place, "items")) for _ in range(count)]
        return list(dict.fromkeys(made)) if node.get("uniqueItems") else made

    def _text(self, node: dict[str, Any], place: Place) -> str:
        self.made[place] += 1
        return self._one_of(node)

    def _one_of(self, node: dict[str, Any]) -> str:
        """A text, more often one of the first that fit."""
        form = "|".join(one.get("pattern", "") for one in node.get("anyOf", [node]))
        fit = [text for text in TEXTS if re.search(form, text) and len(text) >= node.get("minLength", 0)]
        return self._chance.choice(fit[:3] if self._chance.random() < 0.7 else fit)

    def _yes(self, node: dict[str, Any], place: Place) -> bool:
        return self._chance.random() < 0.5

    def _number(self, node: dict[str, Any], *, whole: bool) -> float:
        low, above = node.get("minimum", -math.inf), node.get("exclusiveMinimum", -math.inf)
        high = node.get("maximum", math.inf)
        ends = [end for end in (low, high) if math.isfinite(end)]
        usual = ends if ends and self._chance.random() < 0.5 else _WHOLES if whole else _NUMBERS
        return self._chance.choice(
            [one for one in (*usual, *ends) if low <= one <= high and one > above] or [above + 1]
        )


def _places(node: Any, place: tuple[Any, ...]) -> Iterator[tuple[Any, ...]]:
    inner = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for key, one in inner:
        yield (*place, key)
        yield from _places(one, (*place, key))


def toml(file: dict[str, Any]) -> str:
    """The text of the file."""
    return "".join(f"{json.dumps(key)} = {_inline(value)}\n" for key, value in file.items())


def _inline(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(key)} = {_inline(one)}" for key, one in value.items()) + "}"
    if isinstance(value, list):
        return f"[{', '.join(map(_inline, value))}]"
    return json.dumps(value) if isinstance(value, str | bool) else repr(value)
