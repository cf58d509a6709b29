"""What a caller gives is checked against the interface, as what the provider answers is."""

from __future__ import annotations

from typing import Any, Protocol

import pytest

from aiorts import Component, Kernel, Provided, Required
from aiorts.errors import InterfaceMismatch
from aiorts.testing import simulated


class Brake(Protocol):
    async def stop(self, force: float) -> bool: ...
    async def both(self, force: float, name: str) -> bool: ...
    async def all(self, a: int, b: int, c: int = 3) -> bool: ...
    async def loose(self, one: Any, some: list[int] | None = None, force: float = None) -> bool: ...  # type: ignore[assignment] # noqa: RUF013
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

    def now(self, force: float) -> bool:
        return self._called()

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
            assert await getattr(proxy, name)(*args, **kwargs) is True
        assert brake.calls == len(RIGHT)
        with pytest.raises(TypeError, match="too many positional arguments"):
            await proxy.stop(1.0, 2.0)
