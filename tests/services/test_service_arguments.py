"""What a caller gives is checked against the interface, as what the provider answers is."""

from __future__ import annotations

from types import UnionType
from typing import Any, ClassVar, Protocol, Union, get_args, get_origin

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aiorts import Component, Kernel, Provided, Required
from aiorts.errors import InterfaceMismatch
from aiorts.model.interface import check_of, misfit
from aiorts.testing import simulated


class Brake(Protocol):
    async def stop(self, force: float) -> bool: ...
    async def both(self, force: float, name: str) -> bool: ...
    async def all(self, a: int, b: int, c: int = 3) -> bool: ...
    async def loose(self, one: Any, some: list[int] | None = None, force: float = None) -> bool: ...  # type: ignore[assignment] # noqa: RUF013
    async def lists(self, path: list[float], more: dict[str, tuple[int, ...]] | None = None) -> list[str]: ...
    async def pair(self, one: tuple[str, list[set[int]]], two: frozenset[bool] = frozenset(), x: Any = 0) -> bool: ...
    def now(self, force: float) -> bool: ...


class Plain(Component):
    service = Provided[Brake]()
    calls = 0

    def stop(self, force: float) -> bool:
        return self._called()

    def both(self, force: float, name: str) -> bool:
        return self._called()

    def all(self, a: int, b: int, c: int = 3) -> bool:
        return self._called()

    def loose(self, one: Any, some: list[int] | None = None, force: float = 0.0) -> bool:
        return self._called()

    def lists(self, path: list[float], more: dict[str, tuple[int, ...]] | None = None) -> list[str]:
        self._called()
        return self.answer

    def pair(self, one: tuple[str, list[set[int]]], two: frozenset[bool] = frozenset(), x: Any = 0) -> bool:
        return self._called()

    def now(self, force: float) -> bool:
        return self._called()

    answer: ClassVar[list[Any]] = ["a"]

    def _called(self) -> bool:
        self.calls += 1
        return True


class Waiting(Plain):
    async def stop(self, force: float) -> bool:  # type: ignore[override]
        return self._called()

    async def both(self, force: float, name: str) -> bool:  # type: ignore[override]
        return self._called()

    async def all(self, a: int, b: int, c: int = 3) -> bool:  # type: ignore[override]
        return self._called()

    async def loose(self, one: Any, some: list[int] | None = None, force: float = 0.0) -> bool:  # type: ignore[override]
        return self._called()


class Arm(Component):
    brake = Required[Brake]()


WRONG: list[tuple[str, tuple[Any, ...], dict[str, Any], str]] = [
    ("stop", ("notafloat",), {}, "arm.brake gave force = str 'notafloat', the interface takes float"),
    ("stop", (True,), {}, "force = bool True"),
    ("stop", (), {"force": "1"}, "force = str '1'"),
    ("both", (1.0, 2.0), {}, "name = float 2.0, the interface takes str"),
    ("both", (1.0,), {"name": 2}, "name = int 2"),
    ("all", (1, 2, 3.5), {}, "c = float 3.5"),
    ("all", (1,), {"b": None}, "b = NoneType None"),
    ("loose", (1, 2), {}, "some = int 2"),
    ("now", (None,), {}, "force = NoneType None"),
    ("lists", (["x"],), {}, "arm.brake gave path[0] = str 'x', the interface takes list[float]"),
    ("lists", ([*[1.0] * 10_000, True],), {}, "path[10000] = bool True, the interface takes list[float]"),
    ("lists", ((1.0,),), {}, "path = tuple (1.0,)"),
    ("lists", ([],), {"more": {1: ()}}, "more[key 1] = int 1, the interface takes dict[str, tuple[int, ...]] | None"),
    ("lists", ([], {"a": (1,), "b": (1, 2.5)}), {}, "more['b'][1] = float 2.5"),
    ("pair", (("a", [{1}, {"b"}]),), {}, "one[1][1][an element] = str 'b'"),
    ("pair", (("a", [], 3),), {}, "one = tuple ('a', [], 3)"),
    ("pair", (("a", []), frozenset([1])), {}, "two[an element] = int 1"),
]
RIGHT: list[tuple[str, tuple[Any, ...], dict[str, Any]]] = [
    ("stop", (1,), {}),
    ("stop", (), {"force": 1.0}),
    ("both", (1.0, "a"), {}),
    ("both", (2, "a"), {}),
    ("all", (1, 2), {}),
    ("all", (1, 2, 3), {}),
    ("loose", (object(), None, None), {}),
    ("loose", ("a", [1]), {"force": 2}),
    ("lists", ([],), {}),
    ("lists", ([1, 2.5, 10**30],), {"more": None}),
    ("lists", ([1.5] * 10_000, {"a": (), "b": (1, 2)}), {}),
    ("pair", (("a", [set(), {1}]), frozenset([True])), {"x": ["x", 1]}),
]


@pytest.mark.parametrize("kind", [Plain, Waiting])
@simulated
async def test_an_argument_of_a_wrong_type_is_refused_before_the_provider_sees_it(kind: type[Plain]) -> None:
    async with Kernel() as kernel:
        arm, brake = await kernel.add(Arm("arm")), await kernel.add(kind("brake"))
        await kernel.connect(arm.brake, brake.service)
        proxy: Any = arm.brake.proxy
        for name, args, kwargs, text in WRONG:
            with pytest.raises(InterfaceMismatch) as told:
                await getattr(proxy, name)(*args, **kwargs)
            assert text in str(told.value)
        assert brake.calls == 0
        for name, args, kwargs in RIGHT:
            assert await getattr(proxy, name)(*args, **kwargs) in (True, ["a"])
        assert brake.calls == len(RIGHT)
        with pytest.raises(TypeError, match="too many positional arguments"):
            await proxy.stop(1.0, 2.0)


@simulated
async def test_what_is_inside_an_answer_is_looked_at_too() -> None:
    async with Kernel() as kernel:
        arm, brake = await kernel.create(Arm, "arm"), await kernel.create(Waiting, "brake")
        await kernel.connect(arm.brake, brake.service)
        brake.answer = ["a", 2]  # type: ignore[misc]
        with pytest.raises(InterfaceMismatch) as told:
            await arm.brake.proxy.lists([])
        assert "answered with list ['a', 2], in which [1] is int 2, arm.brake takes list[str]" in str(told.value)


HINTS = st.recursive(
    st.sampled_from([int, float, str, bool, Any]),
    lambda inner: st.one_of(
        inner.map(lambda one: list[one]),  # type: ignore[valid-type]
        inner.map(lambda one: tuple[one, ...]),  # type: ignore[valid-type]
        st.tuples(inner, inner).map(lambda two: tuple[two]),  # type: ignore[valid-type]
        inner.map(lambda one: dict[str, one]),  # type: ignore[valid-type]
        inner.map(lambda one: one | None if one is not Any else one),
    ),
    max_leaves=5,
)
VALUES = st.recursive(
    st.one_of(st.integers(), st.floats(), st.text(max_size=2), st.booleans(), st.none()),
    lambda inner: st.one_of(
        st.lists(inner, max_size=3),
        st.lists(inner, max_size=3).map(tuple),
        st.dictionaries(st.text(max_size=2), inner, max_size=2),
    ),
    max_leaves=6,
)


def fits(hint: Any, value: Any) -> bool:
    """The rule, written out plainly."""
    if hint is Any:
        return True
    kind, inner = get_origin(hint), get_args(hint)
    if kind in (Union, UnionType):
        return any(fits(one, value) for one in inner)
    if kind is list:
        return isinstance(value, list) and all(fits(inner[0], one) for one in value)
    if kind is dict:
        return isinstance(value, dict) and all(fits(inner[0], k) and fits(inner[1], v) for k, v in value.items())
    if kind is tuple and inner[-1] is ...:
        return isinstance(value, tuple) and all(fits(inner[0], one) for one in value)
    if kind is tuple:
        return isinstance(value, tuple) and len(value) == len(inner) and all(map(fits, inner, value))
    if hint is float:
        return type(value) in (int, float)
    return type(value) is (type(None) if hint is None else hint)


@pytest.mark.slow(kept_by="test_what_is_inside_an_answer_is_looked_at_too")
@given(HINTS, VALUES)
def test_a_value_is_of_a_type_when_everything_inside_it_is(hint: Any, value: Any) -> None:
    check = check_of(hint)
    if check is None:
        assert fits(hint, value) or "Any" in str(hint)
        return
    assert check(value) is fits(hint, value)
    place, what = misfit(hint, value)
    if check(value):
        return
    if place:
        assert what is not value
    else:
        assert what is value
