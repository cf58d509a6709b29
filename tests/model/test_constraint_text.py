"""Constraints as text: OpenRTM's grammar is accepted, what is not of it is refused at its place, nothing is lost."""

from __future__ import annotations

import enum
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts import Component, Param
from aiorts.errors import ConfigurationError, DeclarationError
from aiorts.model.configuration.constraint_text import constraint_text, parse_constraint
from aiorts.model.configuration.constraints import Constraint
from aiorts.model.configuration.parameters import ParameterSpec


class Parity(enum.Enum):
    NONE = 0
    EVEN = 2


@pytest.mark.row(73)
@pytest.mark.parametrize(
    ("text", "default", "good", "bad"),
    [
        ("", 1.0, 1e300, "much"),
        ("  ", "a", "anything", 5),
        ("100", 100, 100, 101),
        ("x>=100", 100, 100, 99),
        ("x<=100", 1, 100, 101),
        ("x>100", 101.0, 100.5, 100.0),
        ("x<100", 1.0, 99.5, 100.0),
        ("100<=x<=200", 150, 200, 201),
        ("100<x<200", 150, 199, 200),
        ("100 <= x < 200", 150, 100, 200),
        ("0<=x", 0.0, 1e300, -1e-9),
        ("0<x", 1.0, 5e-324, 0.0),
        ("100>x", 1.0, 99.5, 100.0),
        ("100 >= x", 1.0, 100.0, 100.5),
        ("200>=x>=100", 150, 200, 99),
        ("200>x>=100", 150, 100, 200),
        ("0<x, 10>x, x>100", (1, 9, 101), (5, -5, 500), (0, 9, 101)),
        ("{k0: 200>x>100, k1: 100<=x}", {"k0": 150, "k1": 100}, {"k0": 101, "k1": 1000}, {"k0": 200, "k1": 100}),
        ("-1.5e-3<=x<=inf", 0.0, 1e9, -2e-3),
        ("(9600, 19200, 115200)", 9600, 19200, 19201),
        ("(slow, fast)", "slow", "fast", "warp"),
        ('("a, b", c)', "c", "a, b", "a"),
        ("(NONE, EVEN)", Parity.NONE, "EVEN", "ODD"),
        ("(true)", True, True, False),
        ("x<1, x<10, x>100", (0, 9, 101), (-5, 5, 500), (0, 10, 101)),
        ("x<1, x<10, x>100", (0, 9, 101), (0, 0, 101), (0, 9)),
        ("{k0: 100<x<200, k1: x>=100}", {"k0": 150, "k1": 100}, {"k0": 101, "k1": 1000}, {"k0": 150, "k1": 99}),
        ("{k0: 100<x<200, k1: x>=100}", {"k0": 150, "k1": 100}, "{k0: 101, k1: 100}", {"k0": 150}),
        ("x>0", (1, 2), (3,), (1, 0)),
        ('~"COM[0-9]"', "COM1", "COM9", "COM10"),
        ("x>=1 and (1, 2, -3)", 1, 2, -3),
    ],
)
def test_a_constraint_as_text_lets_through_what_it_says_and_nothing_else(
    text: str, default: Any, good: Any, bad: Any
) -> None:
    parameter = ParameterSpec("p", default, constraint=parse_constraint(text))
    parameter.check(good)
    with pytest.raises(ConfigurationError):
        parameter.check(bad)


@pytest.mark.parametrize(
    ("text", "place", "why"),
    [
        ("x", 2, "expected >=, <=, > or <"),
        ("x=5", 2, "cannot be read"),
        ("x>=", 4, "expected a number"),
        ("x>=much", 4, "expected a number"),
        ("x>=1e999", 4, "expected a number"),
        ("100<x>50", 6, "both signs point the same way"),
        ("200>=x<300", 7, "both signs point the same way"),
        ("100<x<", 7, "expected a number"),
        ("100<x and x>5", 11, "the same thing twice"),
        ("100<", 5, "expected x"),
        ("0>=x>=1", 1, "exchange the bounds"),
        ("1<=x<=0", 1, "exchange the bounds"),
        ("a<=x<=b", 1, "a bound is a number"),
        ("1<=y", 4, "expected x"),
        ("(1, 2", 6, 'expected "," or ")"'),
        ("(1,,2)", 4, "expected a value"),
        ("()", 2, "expected a value"),
        ("{}", 2, "expected a key"),
        ("{a x>1}", 4, 'expected ":"'),
        ("{a: x>1, a: x>2}", 10, "stands there twice"),
        ("{a: x>1", 8, 'expected "," or "}"'),
        ("{a: {b: 1}}", 5, "expected x, a value"),
        ("x>1 x<2", 5, "expected the end"),
        ("x>1 and x>2", 9, "the same thing twice"),
        ('~"("', 1, "not a regular expression"),
        (r'"\q"', 1, "not a text as JSON writes it"),
    ],
)
def test_a_wrong_constraint_is_refused_with_its_place_marked(text: str, place: int, why: str) -> None:
    with pytest.raises(DeclarationError) as caught:
        parse_constraint(text)
    message = str(caught.value)
    assert why in message
    first, shown, mark = message.splitlines()[0], *message.splitlines()[-2:]
    assert f"character {place}:" in first
    assert mark.index("^") == 2 + place - 1
    assert shown == f"  {text}"


def test_a_constraint_of_a_megabyte_is_refused_at_once() -> None:
    with pytest.raises(DeclarationError, match="at most"):
        parse_constraint("(" * 1_000_000)


@pytest.mark.parametrize(
    ("default", "text", "why"),
    [
        ("a", "x>=1", "needs numbers"),
        (1, '~"a"', "needs text"),
        (1, "(1, b)", "must be an int"),
        (1.0, "x<1, x<2", "the type is float"),
        (("a", 1), "x<1, x<2", "needs numbers"),
        ((1, 2), "{a: x>1}", "need a mapping"),
        (5, "x>=6", "default 5 must be >= 6"),
    ],
)
def test_a_constraint_that_does_not_fit_its_parameter_is_found_where_it_is_declared(
    default: Any, text: str, why: str
) -> None:
    with pytest.raises(DeclarationError, match=why):
        ParameterSpec("p", default, constraint=parse_constraint(text))


def test_a_component_declares_constraints_as_text() -> None:
    class Port(Component):
        baud_rate = Param(9600, constraint="(9600, 19200, 115200)", unit="Bd")

    assert Port("port").params["baud_rate"].spec.constraint == Constraint(choices=(9600, 19200, 115200))
    with pytest.raises(DeclarationError, match="give either"):
        Param(9600, constraint="x>1", ge=2)


numbers = st.one_of(st.integers(-(10**30), 10**30), st.floats(allow_nan=False))


@st.composite
def plain_constraints(draw: st.DrawFn) -> Constraint:
    low, high = sorted((draw(numbers), draw(numbers)))
    if not low < high:
        low, high = -1, 1
    bounds = {
        draw(st.sampled_from(("ge", "gt"))): draw(st.sampled_from((None, low))),
        draw(st.sampled_from(("le", "lt"))): draw(st.sampled_from((None, high))),
    }
    choices = draw(st.one_of(st.none(), st.lists(st.text(), min_size=1, max_size=4).map(tuple)))
    pattern = draw(st.one_of(st.none(), st.sampled_from(("a.*", r"\d+/\"x\"", "\\\\", "\n", "é~"))))
    return Constraint(**bounds, choices=choices, pattern=pattern)


constraints = st.one_of(
    plain_constraints(),
    st.lists(plain_constraints(), min_size=2, max_size=4).map(lambda parts: Constraint(elements=tuple(parts))),
    st.dictionaries(st.text(), plain_constraints(), min_size=1, max_size=3).map(lambda keys: Constraint(keys=keys)),
)


@pytest.mark.slow(kept_by="test_a_constraint_as_text_lets_through_what_it_says_and_nothing_else")
@settings(max_examples=300)
@given(constraints)
def test_text_of_a_constraint_reads_as_the_same_constraint(constraint: Constraint) -> None:
    again = parse_constraint(constraint_text(constraint))
    assert again == constraint
    assert repr(again) == repr(constraint)


@pytest.mark.row(73)
@given(low=st.integers(-1000, 0), high=st.integers(1, 1000), signs=st.tuples(*[st.sampled_from(("<", "<="))] * 2))
def test_a_bound_means_the_same_from_either_side(low: int, high: int, signs: tuple[str, str]) -> None:
    turned = [sign.replace("<", ">") for sign in signs]
    one, other = signs
    assert parse_constraint(f"{low}{one}x") == parse_constraint(f"x{turned[0]}{low}")
    assert parse_constraint(f"{high}{turned[1]}x") == parse_constraint(f"x{other}{high}")
    forwards = parse_constraint(f"{low}{one}x{other}{high}")
    assert forwards == parse_constraint(f"{high}{turned[1]}x{turned[0]}{low}")
    assert forwards == parse_constraint(f"{low}{one}x and {high}{turned[1]}x")


@pytest.mark.parametrize(
    ("default", "constraint"),
    [
        (9600, Constraint(choices=(9600, 19200))),
        (0.5, Constraint(choices=(0.5, -0.0, 1e-300))),
        (True, Constraint(choices=(True,))),
        (Path("a b"), Constraint(choices=("a b", "c"))),
        (Parity.EVEN, Constraint(choices=(Parity.EVEN, Parity.NONE))),
        (("x", "and"), Constraint(choices=("x", "and", " "))),
    ],
)
def test_choices_of_every_type_survive_as_text(default: Any, constraint: Constraint) -> None:
    declared = ParameterSpec("p", default, constraint=constraint)
    text = constraint_text(declared.constraint)
    assert repr(ParameterSpec("p", default, constraint=parse_constraint(text)).constraint) == repr(declared.constraint)


@pytest.mark.slow(kept_by="test_a_wrong_constraint_is_refused_with_its_place_marked")
@settings(max_examples=300)
@given(st.one_of(st.text(alphabet='x<>=(){},:~"\\ 1a.e-', max_size=25), st.text(max_size=25)))
def test_any_text_is_a_constraint_or_refused(text: str) -> None:
    try:
        found = parse_constraint(text)
    except DeclarationError as error:
        assert str(error).startswith("constraint")  # noqa: PT017 - it may as well be none
    else:
        assert parse_constraint(constraint_text(found)) == found


def test_a_mapping_is_held_read_only_in_its_order() -> None:
    parameter = ParameterSpec("p", {"b": 1.0, "a": 2})
    assert parameter.type_text == "Mapping[str, float]"
    value = parameter.check('{"z": 1, "y": 2.5}')
    assert isinstance(value, Mapping)
    assert list(value.items()) == [("z", 1.0), ("y", 2.5)]
    with pytest.raises(TypeError):
        value["z"] = 3.0  # type: ignore[index]
    for bad, why in (("{a}", "such as"), ({1: 2}, "texts as keys"), ({"a": "b"}, "must be a float"), (5, "a mapping")):
        with pytest.raises(ConfigurationError, match=why):
            parameter.check(bad)
