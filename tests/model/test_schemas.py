"""JSON Schemas of annotations: of any dataclass, for values as they are written and as clients give them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Literal

import jsonschema
import pytest

from aiorts.model.plain import Schemas, plain


class Colour(Enum):
    RED = "red"


@dataclass(frozen=True)
class Inner:
    """One inside."""

    left: int
    right: float | None = None


@dataclass(frozen=True)
class Outer:
    """All kinds. The first sentence of many.

    More of it.
    """

    inner: Inner
    many: tuple[Inner, ...] = ()
    pair: tuple[int, str] = (1, "a")
    names: Mapping[str, list[str]] = field(default_factory=dict)
    word: Literal["a", "b"] = "a"
    colour: Colour = Colour.RED
    raw: bytes = b""
    anything: Any = None


def document(schemas: Schemas, kind: Any) -> dict[str, Any]:
    return {**schemas.of(kind), "$defs": schemas.definitions}


def test_what_is_written_is_as_its_schema_says() -> None:
    schemas = Schemas()
    schema = document(schemas, Outer)
    jsonschema.Draft202012Validator.check_schema(schema)
    validator = jsonschema.Draft202012Validator(schema)
    written = plain(Outer(Inner(1), (Inner(2, float("nan")),), names={"a": ["b"]}))
    assert validator.is_valid({**written, "raw": ""})
    wrong = {"inner": {"left": "x"}, "pair": [1], "word": "c", "colour": "blue", "names": {"a": "b"}, "many": {}}
    for name, value in wrong.items():
        assert not validator.is_valid({**written, "raw": "", name: value}), name
    assert not validator.is_valid({**written, "raw": "", "more": 1})
    del written["word"]
    assert not validator.is_valid({**written, "raw": ""})


def test_what_has_a_default_may_be_left_out_where_that_is_said() -> None:
    schemas = Schemas("#/$defs/", defaults=True, simple={int: {"type": "string"}})
    schema = document(schemas, Outer)
    validator = jsonschema.Draft202012Validator(schema)
    assert validator.is_valid({"inner": {"left": "1"}})
    assert not validator.is_valid({"inner": {"left": 1}})
    assert not validator.is_valid({})
    assert schemas.definitions["Outer"]["properties"]["word"]["default"] == "a"


def test_of_two_classes_with_one_name_the_second_is_named_with_its_module() -> None:
    other = dataclass(type("Inner", (), {"__annotations__": {"up": str}, "__module__": __name__}))
    schemas = Schemas()
    assert schemas.of(Inner) == {"$ref": "#/$defs/Inner"}
    assert schemas.of(other) == {"$ref": "#/$defs/test_schemas.Inner"}
    assert schemas.of(Inner) == {"$ref": "#/$defs/Inner"}


def test_what_json_has_no_form_for_is_an_error() -> None:
    with pytest.raises(TypeError, match="complex"):
        Schemas().of(tuple[complex, ...])
