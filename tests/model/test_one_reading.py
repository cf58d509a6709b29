"""A text is read as the same value by every way in: an option of a connector, a parameter, a variable."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import pytest
from jsonschema import Draft202012Validator

from aiorts.errors import AiortsError
from aiorts.model.declared import kinds_of, options_of, read_option
from aiorts.model.profile import ConnectorProfile
from aiorts.model.values import convert_value
from aiorts.system.expansion.faults import Typed
from aiorts.system.expansion.variables import typed
from aiorts.system.schemas.option_schema import option_schema

TRUTH = {
    **dict.fromkeys(("true", "YES", " on ", "enable", "1"), True),
    **dict.fromkeys(("False", "no", "OFF", "Disable", "0"), False),
    **dict.fromkeys(("maybe", "2", "", "truee"), None),
}
WHOLE = {"7": 7, "007": 7, "+12": 12, "0x10": 16, "0b11": 3, "0o17": 15, "1_000": 1000, " 8 ": 8} | dict.fromkeys(
    ("1.5", "x", "", "1__0", "0x")
)
REFUSED = partial(Typed, "--var")


def read(way: Callable[[], Any]) -> Any:
    try:
        return way()
    except (AiortsError, ValueError, TypeError):
        return None


def is_allowed(name: str, text: str) -> bool:
    schema = option_schema(kinds_of(ConnectorProfile)[name], options_of(ConnectorProfile)[name])
    return Draft202012Validator(schema).is_valid(text)


@pytest.mark.parametrize(("text", "value"), TRUTH.items())
def test_a_truth_value(text: str, value: bool | None) -> None:
    assert read(lambda: read_option(ConnectorProfile, "keep_last", text)) is value
    assert read(lambda: convert_value(text, bool)) is value
    assert read(lambda: typed(text, REFUSED)(True)) is value
    assert is_allowed("keep_last", text) is (value is not None)


@pytest.mark.parametrize(("text", "value"), WHOLE.items())
def test_a_whole_number(text: str, value: int | None) -> None:
    assert read(lambda: read_option(ConnectorProfile, "length", text)) == value
    assert read(lambda: convert_value(text, int)) == value
    if text != "1.5":  # a default 1 is no promise that a variable stays whole
        assert read(lambda: typed(text, REFUSED)(1)) == value
    assert is_allowed("length", text) is (value is not None)
