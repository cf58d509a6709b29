"""Kernels are looked into and changed over HTTP, by clients with a token."""

from __future__ import annotations

from typing import Any, Protocol

import pytest

from aiorts import Component, Provided
from aiorts.control import Right
from control_parts import controlled
from studio_parts import site

pytestmark = pytest.mark.anyio


async def test_kernels_are_listed_and_asked() -> None:
    async with controlled("robot") as kernel, site() as client:
        reply = await client.ask("GET", "/api/kernels")
        assert reply.status == 200
        assert [(one["name"], one["address"]) for one in reply.value] == [("robot", kernel.address)]
        for word in ("robot", kernel.address, kernel.address.replace("/", "%2F")):
            names = await client.call(word, "names")
            assert names.status == 200, names
            assert set(names.value["components"]) == {"counter0", "reader0"}


async def test_a_parameter_is_changed_by_who_may() -> None:
    async with controlled("robot") as kernel, site(Right.OPERATE) as client:
        values = {"default": {"step": 2.5}}
        reply = await client.call("robot", "configure", component="counter0", values=values)
        assert (reply.status, reply.value["text"]) == (200, ""), reply
        assert kernel.components["counter0"].step == 2.5


class Deep(Protocol):
    def deep(self, levels: int) -> Any: ...


class Nesting(Component):
    """Answers with lists in lists."""

    nests = Provided[Deep]()

    def deep(self, levels: int) -> Any:
        found: Any = 1
        for _ in range(levels):
            found = [found]
        return found


async def test_an_answer_that_is_nested_too_deep_is_a_problem_and_no_fault_of_the_server() -> None:
    async with controlled("robot") as kernel, site(Right.OPERATE) as client:
        await kernel.create(Nesting, "nesting0")
        for levels, status in ((20, 200), (480, 409)):
            reply = await client.call("robot", "call", path="nesting0.nests.deep", args=[levels])
            assert reply.status == status, reply
