"""Settings of services that others write: a dataclass is read as it is, and what its fields do not take is refused."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, Any, Literal

import pytest

from aiorts import setting
from aiorts.diagnostics import LoopLimit
from aiorts.errors import ConfigurationError
from aiorts.kernel.extensions.arguments import settings_faults, settings_of
from aiorts.model.declared import fault_of, options_of
from aiorts.system.schemas.option_schema import plain_schema

if TYPE_CHECKING:
    from pathlib import PurePath


@dataclass(frozen=True)
class Base:
    rate: float = setting(1.0, "Its rate.", unit="s", above=0, high=10)
    free: float = setting(1.0, "Any number.")
    way: Literal["up", "down"] = setting("up", "Its way.")
    mixed: int | Literal["auto"] | list[int] = setting("auto", "A number, a list or a word.")  # noqa: RUF009 - it makes a field
    count: Literal[0, 1, 2] = setting(0, "How many.")
    endless: float = setting(1.0, "It may be without end.", above=0, endless=True)


class Derived(Base):
    """Not decorated again."""


@dataclass(frozen=True)
class Unknown:
    path: PurePath | None = setting(None, "A type that is there for type checkers alone.")  # noqa: RUF009 - it makes a field
    rate: float = setting(1.0, "Its rate.", above=0)


@dataclass(frozen=True)
class Foreign:
    own: int = field(default=3, metadata={"option": True, "doc": "Of another tool."})


class Way(StrEnum):
    DOWN = "down"


@pytest.mark.parametrize("cls", [Base, Derived])
def test_what_a_field_declares_is_refused_and_all_else_taken(cls: type) -> None:
    for name, good, bad in (
        ("rate", [0.5, 10, 10.0], [0, -1.0, 10.5, math.inf, math.nan, True]),
        ("free", [math.inf, -5.0, 0], []),
        ("way", ["down", Way.DOWN], ["dwn"]),
        ("mixed", [3, "auto", [1, 2], "else"], []),
        ("count", [0, 2], []),
        ("endless", [math.inf, 5], [0.0, math.nan]),
    ):
        assert [value for value in good if fault_of(cls, name, value)] == [], name
        assert [value for value in bad if not fault_of(cls, name, value)] == [], name
    assert fault_of(cls, "rate", 0) == "expected seconds above 0 to 10, such as 1.0, got 0"
    assert fault_of(cls, "way", "dwn") == "unknown way 'dwn'; did you mean 'down'?"


def test_a_type_that_only_type_checkers_know_and_metadata_of_others_are_no_declaration() -> None:
    assert list(settings_faults(Unknown, {"rate": 2.0})) == []
    assert options_of(Foreign) == {}
    assert settings_of(Foreign, {"own": 4}).own == 4


def test_settings_that_a_program_makes_are_checked_too() -> None:
    for given in ({"limit": -1.0}, {"limit": math.nan}, {"limit": "x"}, {"policy": "wran"}):
        arguments: dict[str, Any] = given
        with pytest.raises(ConfigurationError, match=next(iter(given))):
            LoopLimit(**arguments)


def test_a_list_is_no_default() -> None:
    with pytest.raises(ValueError, match="mutable default"):

        @dataclass(frozen=True)
        class _Shared:
            names: Any = setting([], "Names.")  # noqa: RUF009 - it makes a field


def test_the_length_of_a_text_is_checked_and_stands_in_the_schema() -> None:
    @dataclass(frozen=True)
    class Named:
        name: str = setting("ab", "A name.", low=2, high=4)

    assert [fault_of(Named, "name", text) for text in ("ab", "abcd", 7)] == ["", "", ""]
    assert fault_of(Named, "name", "a") == "expected a text of at least 2 and at most 4 characters, got 'a'"
    assert "at most 4" in fault_of(Named, "name", "abcde")
    schema = plain_schema(str, options_of(Named)["name"])
    assert (schema["minLength"], schema["maxLength"]) == (2, 4)
