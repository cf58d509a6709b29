"""Parameters: a value is converted exactly or refused with a message that says where, what and what is kept."""

from __future__ import annotations

import enum
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aiorts.errors import ConfigurationError, DeclarationError, InvalidNameError
from aiorts.model.configuration.parameters import Constraint, ParameterSpec, validate


class Mode(enum.Enum):
    AUTO = "auto"
    MANUAL = 2


def spec(default: Any, kind: Any = None, **bounds: Any) -> ParameterSpec:
    return ParameterSpec("gain", default, kind, constraint=Constraint(**bounds))


@pytest.mark.parametrize(
    ("default", "kind", "value", "expected"),
    [
        (1.0, None, "2.5", 2.5),
        (1.0, None, 3, 3.0),
        (1.0, None, np.float32(0.5), 0.5),
        (1.0, None, np.int16(3), 3.0),
        (1.0, None, "inf", math.inf),
        (1, None, "12", 12),
        (1, None, "0x10", 16),
        (1, None, np.uint8(7), 7),
        (False, None, "true", True),
        (True, None, "False", False),
        (True, None, " off ", False),
        (True, None, np.bool_(False), False),
        ("a", None, "5", "5"),
        (Path("a.csv"), None, "b/c.csv", Path("b/c.csv")),
        ((1.0, 2.0), None, [3, "4"], (3.0, 4.0)),
        ((1.0, 2), None, (), ()),
        ((1, 2), None, "[3, 4]", (3, 4)),
        ((1, 2), None, "3, 4,", (3, 4)),
        ((1, 2), None, "", ()),
        ((1.0,), None, np.array([1.5, 2.5]), (1.5, 2.5)),
        (("a", 1), None, ["b", 2], ("b", 2)),
        (("a",), None, '["b,c", "d"]', ("b,c", "d")),
        (("a",), None, "[b, c]", ("b", "c")),
        (None, float | None, "none", None),
        (None, float | None, "1.5", 1.5),
        (None, str | None, "none", "none"),
        (None, Path | None, None, None),
        (((1.0, 2.0),), None, [[1, 2], [3, 4]], ((1.0, 2.0), (3.0, 4.0))),
        (Mode.AUTO, None, "MANUAL", Mode.MANUAL),
        (Mode.AUTO, None, 2, Mode.MANUAL),
        (Mode.AUTO, None, "auto", Mode.AUTO),
    ],
)
def test_value_is_converted_to_the_type_of_the_parameter(default: Any, kind: Any, value: Any, expected: Any) -> None:
    checked = spec(default, kind).check(value)
    assert checked == expected
    assert type(checked) is type(expected)
    if isinstance(expected, tuple):
        assert [type(item) for item in checked] == [type(item) for item in expected]


@pytest.mark.parametrize(
    ("default", "value", "why"),
    [
        (1.0, "fast", "must be a float"),
        (1.0, True, "must be a float, got bool"),
        (1.0, None, "must be a float, got NoneType"),
        (1.0, 2**53 + 1, "none holds this whole number exactly"),
        (1.0, 10**400, "too large"),
        (1, 2.0, "must be an int, got float"),
        (1, "2.5", "must be an int"),
        (1, True, "must be an int, got bool"),
        (False, 1, "must be true or false"),
        (False, "maybe", "must be true or false"),
        ("a", 5, "must be text, got int"),
        (Path("a"), "", "must be a path"),
        (Path("a"), "a\0b", "must be a path"),
        ((1.0,), 5, "must be a list or tuple, got int"),
        ((1.0,), ["x"], "element 0 ('x') must be a float"),
        (("a", 1), ["b"], "must have 2 elements, got 1"),
        ((1,), "[" * 100_000, "nested too deeply"),
        (Mode.AUTO, "FAST", "must be one of AUTO, MANUAL"),
        (Mode.AUTO, True, "must be one of AUTO, MANUAL"),
    ],
)
def test_value_of_another_type_is_refused_with_the_expected_one(default: Any, value: Any, why: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        spec(default).check(value)
    assert why in str(caught.value)
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize(
    ("bounds", "good", "bad", "why"),
    [
        ({"ge": 0.0}, 0.0, -1e-9, "must be >= 0.0"),
        ({"gt": 0.0}, 1e-9, 0.0, "must be > 0.0"),
        ({"le": 3.0}, 3.0, 3.1, "must be <= 3.0"),
        ({"lt": 3.0}, 2.9, 3.0, "must be < 3.0"),
        ({"choices": (1, 2.5)}, 2.5, 2.0, "must be one of 1.0, 2.5"),
        ({"ge": 0.0}, math.inf, math.nan, "must be >= 0.0"),
        ({"lt": 3.0}, -math.inf, math.nan, "must be < 3.0"),
    ],
)
def test_constraint_lets_through_what_is_inside_and_nothing_else(
    bounds: Any, good: float, bad: float, why: str
) -> None:
    parameter = spec(good, **bounds)
    assert parameter.check(good) == good
    with pytest.raises(ConfigurationError, match=why):
        parameter.check(bad)


def test_nan_is_a_value_where_nothing_is_bounded() -> None:
    assert math.isnan(spec(0.0).check("nan"))


def test_constraint_holds_for_each_element_of_a_tuple() -> None:
    parameter = spec((1, 2), ge=0)
    assert parameter.check([3, 4]) == (3, 4)
    with pytest.raises(ConfigurationError, match="must be >= 0"):
        parameter.check([3, -4])


def test_pattern_has_to_match_the_whole_text() -> None:
    parameter = spec("COM1", pattern=r"COM\d")
    assert parameter.check("COM7") == "COM7"
    with pytest.raises(ConfigurationError, match="must match"):
        parameter.check("COM77")


def test_message_names_owner_value_reason_and_what_is_kept() -> None:
    with pytest.raises(ConfigurationError) as caught:
        spec(1.0, ge=0.0, le=10.0).check(-1.0, owner="pid0", current=2.0)
    assert str(caught.value) == "pid0.gain = -1.0: must be >= 0.0; 2.0 kept"


@pytest.mark.parametrize(
    ("make", "why"),
    [
        (lambda: spec(1.0, ge=2.0), "gain: default 1.0 must be >= 2.0"),
        (lambda: spec("x", int), "gain: default 'x': must be an int"),
        (lambda: spec(None), "give type="),
        (lambda: spec(()), "give type="),
        (lambda: spec({}), "give type="),
        (lambda: spec({}, dict), "type dict: a parameter is"),
        (lambda: spec((), tuple), "a parameter is"),
        (lambda: spec(1, int | str), "only X | None"),
        (lambda: spec("a", ge=0), "needs numbers, the type is str"),
        (lambda: spec(True, ge=0), "needs numbers, the type is bool"),
        (lambda: spec(1, pattern="x"), "needs text, the type is int"),
        (lambda: spec(1, choices=("a",)), "choices=('a',)"),
        (lambda: Constraint(ge=0, gt=0), "choose one lower bound"),
        (lambda: Constraint(ge=2, le=1), "no value lies between"),
        (lambda: Constraint(gt=1, le=1), "no value lies between"),
        (lambda: Constraint(ge=math.nan), "expected a number"),
        (lambda: Constraint(choices=()), "nothing to choose from"),
        (lambda: Constraint(choices="abc"), "expected a tuple"),  # type: ignore[arg-type]
        (lambda: Constraint(pattern="("), "not a regular expression"),
        (lambda: ParameterSpec("gain", 1.0, widget="slidr"), "did you mean slider?"),
        (lambda: ParameterSpec("gain", 1.0, widget="slider"), "needs a lower and an upper bound"),
        (lambda: ParameterSpec("gain", 1.0, widget="radio"), "needs choices"),
        (lambda: ParameterSpec("gain", 1.0, widget="text.5"), "only a slider has a step"),
    ],
)
def test_declaration_that_cannot_work_is_refused(make: Any, why: str) -> None:
    with pytest.raises(DeclarationError) as caught:
        make()
    assert why in str(caught.value)


def test_declaration_error_names_the_class() -> None:
    with pytest.raises(DeclarationError, match=r"^Pid\.gain: default 1\.0 must be >= 2\.0$"):
        ParameterSpec("gain", 1.0, constraint=Constraint(ge=2.0), owner="Pid")


def test_name_of_a_parameter_follows_the_grammar() -> None:
    with pytest.raises(InvalidNameError, match="parameter name"):
        ParameterSpec("a.b", 1.0)


@pytest.mark.parametrize("widget", ["text", "slider", "slider.0.1", "spin"])
def test_widget_that_the_declaration_can_serve_is_kept(widget: str) -> None:
    assert ParameterSpec("gain", 1.0, constraint=Constraint(ge=0.0, le=2.0), widget=widget).widget == widget


@pytest.mark.parametrize(
    ("default", "kind", "text"),
    [
        (1.0, None, "float"),
        (Path("x"), None, "Path"),
        ((1, 2), None, "tuple[int, ...]"),
        (("a", 1), None, "tuple[str, int]"),
        (None, int | None, "int | None"),
        (Mode.AUTO, None, "Mode"),
    ],
)
def test_type_is_told_as_one_writes_it(default: Any, kind: Any, text: str) -> None:
    assert ParameterSpec("gain", default, kind).type_text == text


@pytest.mark.parametrize(
    ("constraint", "text"),
    [
        (Constraint(), ""),
        (Constraint(ge=0.0, le=10.0), "0.0 <= x <= 10.0"),
        (Constraint(gt=0, lt=5), "0 < x < 5"),
        (Constraint(le=5), "x <= 5"),
        (Constraint(choices=("a", "b")), "one of 'a', 'b'"),
    ],
)
def test_constraint_reads_as_one_line(constraint: Constraint, text: str) -> None:
    assert str(constraint) == text


SPECS = {
    "gain": ParameterSpec("gain", 1.0, constraint=Constraint(ge=0.0)),
    "mode": ParameterSpec("mode", "auto", constraint=Constraint(choices=("auto", "manual"))),
    "count": ParameterSpec("count", 1),
}


def test_several_changes_come_back_converted_in_their_order() -> None:
    checked = validate(SPECS, {"count": "3", "gain": 2})
    assert list(checked.items()) == [("count", 3), ("gain", 2.0)]
    assert type(checked["gain"]) is float


def test_one_bad_change_refuses_all_and_every_bad_one_is_named() -> None:
    with pytest.raises(ConfigurationError) as caught:
        validate(SPECS, {"gain": -1.0, "mode": "auto", "count": "x", "gian": 1.0}, owner="pid0", current={"gain": 2.0})
    message = str(caught.value)
    assert "pid0: 3 of 4 changes refused, none was made" in message
    assert "pid0.gain = -1.0: must be >= 0.0; 2.0 kept" in message
    assert "pid0.count = 'x': must be an int" in message
    assert "pid0.gian: no such parameter; did you mean gain?" in message


def test_unknown_name_without_a_near_one_lists_those_there_are() -> None:
    with pytest.raises(ConfigurationError, match=r"^pid0\.zzz: no such parameter; there are gain, mode, count$"):
        validate(SPECS, {"zzz": 1}, owner="pid0")


@pytest.mark.slow(kept_by="test_value_is_converted_to_the_type_of_the_parameter")
@given(st.floats(allow_nan=False))
def test_text_of_a_float_gives_the_same_float(value: float) -> None:
    assert spec(0.0).check(repr(value)) == value


@pytest.mark.slow(kept_by="test_value_is_converted_to_the_type_of_the_parameter")
@given(st.lists(st.integers()) | st.text() | st.floats() | st.none() | st.booleans() | st.binary())
def test_any_value_is_converted_or_refused_and_the_result_is_stable(value: object) -> None:
    for parameter in (*SPECS.values(), spec((1,)), spec(False), spec(Path("a")), spec(None, int | None)):
        try:
            checked = parameter.check(value)
        except ConfigurationError:
            continue
        again = parameter.check(checked)
        assert again == checked or (again != again and checked != checked)
