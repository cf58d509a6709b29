"""Interfaces as values: what fits can be called in every way that was asked for, what does not fit is named."""

from __future__ import annotations

import inspect
from enum import Enum
from typing import Any, Protocol

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from aiorts.errors import DeclarationError
from aiorts.model.interface import Method, check_of, differences, fits, read_interface, read_method
from aiorts.types import TimedDouble
from campaign import cases

P = inspect.Parameter
KINDS = [P.POSITIONAL_ONLY, P.POSITIONAL_OR_KEYWORD, P.KEYWORD_ONLY]


@st.composite
def parameters(draw: st.DrawFn, *, variable: bool) -> tuple[inspect.Parameter, ...]:
    names = draw(st.lists(st.sampled_from("abcd"), unique=True, max_size=4))
    kinds = sorted(draw(st.lists(st.sampled_from(KINDS), min_size=len(names), max_size=len(names))))
    found: list[inspect.Parameter] = []
    optional = False
    for name, kind in zip(names, kinds, strict=True):
        given = draw(st.booleans())
        optional = kind is not P.KEYWORD_ONLY and (optional or given)
        default = 0 if given or optional else P.empty
        found.append(P(name, kind, default=default))
    if variable and draw(st.booleans()):
        index = sum(one.kind is not P.KEYWORD_ONLY for one in found)
        found.insert(index, P("args", P.VAR_POSITIONAL))
    if variable and draw(st.booleans()):
        found.append(P("kwargs", P.VAR_KEYWORD))
    return tuple(found)


def method(parameters: tuple[inspect.Parameter, ...]) -> Method:
    return Method("go", parameters, inspect.Signature.empty, "", True)


def ways_to_call(parameters: tuple[inspect.Parameter, ...]) -> list[tuple[list[int], dict[str, int]]]:
    """Every way that the signature allows."""
    ways: list[tuple[list[int], dict[str, int]]] = [([], {})]
    for one in parameters:
        more: list[tuple[list[int], dict[str, int]]] = []
        for args, kwargs in ways:
            if one.default is not P.empty:
                more.append((args, kwargs))
            if one.kind is not P.KEYWORD_ONLY and not kwargs:
                more.append(([*args, 1], kwargs))
            if one.kind is not P.POSITIONAL_ONLY:
                more.append((args, {**kwargs, one.name: 1}))
        ways = more
    signature = inspect.Signature(list(parameters))
    return [(args, kwargs) for args, kwargs in ways if binds(signature, args, kwargs)]


def binds(signature: inspect.Signature, args: list[int], kwargs: dict[str, int]) -> bool:
    try:
        signature.bind(*args, **kwargs)
    except TypeError:
        return False
    return True


@pytest.mark.slow(kept_by="test_every_interface_fits_itself_and_whoever_takes_anything")
@settings(max_examples=cases(20_000))
@given(parameters(variable=False), parameters(variable=True))
def test_what_fits_takes_every_call_that_is_wanted(
    wanted: tuple[inspect.Parameter, ...], there: tuple[inspect.Parameter, ...]
) -> None:
    # `Signature.bind` of CPython 3.11 refuses f(a=1) for `def f(a=0, /, **kwargs)`, which Python itself takes.
    by_keyword = {one.name for one in wanted if one.kind is not P.POSITIONAL_ONLY}
    assume(not any(one.kind is P.POSITIONAL_ONLY and one.name in by_keyword for one in there))
    signature = inspect.Signature(list(there))
    takes_all = all(binds(signature, args, kwargs) for args, kwargs in ways_to_call(wanted))
    wrong = differences({"go": method(wanted)}, {"go": method(there)})
    if not wrong:
        assert takes_all
    else:
        assert "go" in wrong[0]


@settings(max_examples=cases(5_000))
@given(parameters(variable=False))
def test_every_interface_fits_itself_and_whoever_takes_anything(wanted: tuple[inspect.Parameter, ...]) -> None:
    assert differences({"go": method(wanted)}, {"go": method(wanted)}) == []
    anything = (P("args", P.VAR_POSITIONAL), P("kwargs", P.VAR_KEYWORD))
    assert differences({"go": method(wanted)}, {"go": method(anything)}) == []


class Base: ...


class Derived(Base): ...


class Look(Protocol):
    def look(self) -> int: ...


@pytest.mark.parametrize(
    ("one", "other", "expected"),
    [
        (Derived, Base, True),
        (Base, Derived, False),
        (int, float, True),
        (float, int, False),
        (int, int | None, True),
        (int | None, int, False),
        (None, int | None, True),
        (list[int], list[int], True),
        (list[int], list[float], False),
        (Any, int, True),
        (str, Any, True),
        ("Unknown", "Unknown", True),
        ("Unknown", int, False),
        (Base, Look, True),
        (P.empty, int, True),
    ],
)
def test_types_fit_as_far_as_they_can_be_known(one: Any, other: Any, expected: bool) -> None:
    assert fits(one, other) is expected


class Colour(Enum):
    RED = 1


@pytest.mark.parametrize(
    ("hint", "good", "bad"),
    [
        (float, [1.0, 1], [True, "1", None]),
        (int, [1], [True, 1.0]),
        (bool, [True], [1]),
        (None, [None], [0]),
        (str | None, ["", None], [b""]),
        (TimedDouble, [TimedDouble(0, 1.0)], [1.0]),
        (list[int], [[1], []], [(1,), ["inside"], [1, True]]),
        (list[Any], [["anything"]], [("a",)]),
        (dict[str, list[float]], [{}, {"a": [1]}], [{"a": ["b"]}, {1: []}]),
        (Colour, [Colour.RED], [1]),
    ],
)
def test_answers_are_checked_where_the_type_is_known(hint: Any, good: list[Any], bad: list[Any]) -> None:
    check = check_of(hint)
    assert check is not None
    assert all(map(check, good))
    assert not any(map(check, bad))


@pytest.mark.parametrize("hint", [Any, object, P.empty, "Unknown", Look, int | Look])
def test_what_cannot_be_known_is_not_checked(hint: Any) -> None:
    assert check_of(hint) is None


def test_methods_are_read_with_the_types_that_are_known_here() -> None:
    class Local: ...

    class Interface(Look, Protocol):
        """One that adds to another."""

        async def take(self, what: Local, count: int = 3, /, *, fast: bool) -> TimedDouble | None:
            """Take it.

            All of it.
            """
            ...

    found = read_interface(Interface)
    assert (found.name, found.doc, list(found.methods)) == ("Interface", "One that adds to another.", ["look", "take"])
    take = found.methods["take"].profile
    parameters = "what: Local, count: int = 3, /, *, fast: bool"
    assert str(take) == f"async take({parameters}) -> aiorts.types.basic.TimedDouble | None"
    assert [one.kind for one in take.parameters] == ["position", "position", "keyword"]
    assert take.doc == "Take it.\n\nAll of it."


def test_a_generator_is_no_method() -> None:
    async def stream() -> Any:
        yield 1

    with pytest.raises(DeclarationError, match="is a generator"):
        read_method("stream", stream, bound=True)
