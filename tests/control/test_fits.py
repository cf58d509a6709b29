"""Which ports fit a port, and why the others do not: the words in which `connect` refuses them."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any, Protocol

import pytest

from aiorts import Component, InPort, OutPort, Provided, Required
from aiorts.errors import AbsentError, WiringError
from aiorts.sessions import Client
from aiorts.types import TimedDouble, TimedLong
from control_parts import WAIT, controlled, with_client


class Scale(Protocol):
    def scale(self, value: float) -> float: ...


class Turn(Protocol):
    def turn(self) -> None: ...


class Many(Component):
    """Has ports of all kinds."""

    level = InPort(TimedDouble)
    metres = InPort(TimedDouble, unit="m")
    number = InPort(TimedLong)
    out = OutPort(TimedDouble, unit="m")
    scale = Required[Scale]()
    turn = Required[Turn]()


class Scaler(Component):
    """Answers."""

    scaling = Provided[Scale]()

    def scale(self, value: float) -> float:
        return value


async def asked(name: str, port: str, **arguments: Any) -> dict[str, str]:
    def ask(client: Client) -> dict[str, str]:
        return dict(client.call("fits", WAIT, port=port, **arguments))

    return await with_client(name, ask)


@pytest.mark.anyio
async def test_each_other_port_fits_or_is_refused_in_the_words_of_connect() -> None:
    async with controlled("fits") as kernel:
        await kernel.create(Many, "many0")
        await kernel.create(Scaler, "scaler0")
        for port in ("counter0.out", "many0.out", "many0.metres", "many0.scale", "scaler0.scaling"):
            found = await asked("fits", port)
            others = {one.path for component in kernel.components.values() for one in component.ports.values()}
            assert set(found) == others - {port}
            assert await asked("fits", port, fitting=True) == {name: "" for name, why in found.items() if not why}
            before = dict(kernel.connectors) | dict(kernel.service_connectors)
            for other, why in found.items():
                if why:
                    with pytest.raises(WiringError) as refused:
                        await kernel.connect(port, other)
                    assert str(refused.value) == why
                else:
                    await kernel.disconnect(await kernel.connect(port, other))
            assert {**kernel.connectors, **kernel.service_connectors} == before
        found = await asked("fits", "counter0.out")
        assert {name for name, why in found.items() if not why} == {"many0.level", "many0.metres"}
        assert "connected already" in found["reader0.in"]
        assert "types differ" in found["many0.number"]
        with pytest.raises(AbsentError, match=r"reader0 has no such port"):
            await asked("fits", "reader0.inn")
        with pytest.raises(WiringError, match=r"reader0: is a component; say one of its ports"):
            await asked("fits", "reader0")


@pytest.mark.slow(kept_by="test_each_other_port_fits_or_is_refused_in_the_words_of_connect")
@pytest.mark.anyio
async def test_the_shell_completes_ports_that_fit_the_first_one(completed: Callable[..., set[str]]) -> None:
    async with controlled("completing") as kernel:
        await kernel.create(Many, "many0")
        assert await asyncio.to_thread(completed, "con", "counter0.out", "") == {"many0.level", "many0.metres"}
        assert await asyncio.to_thread(completed, "con", "counter0.out", "many0.m") == {"many0.metres"}
        there = await asyncio.to_thread(completed, "con", "completing/counter0.out", "completing/")
        assert there == {"completing/many0.level", "completing/many0.metres"}
