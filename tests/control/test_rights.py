"""A session may do what its hello asked for, as far as the kernel allows that."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from aiorts.control.operation import Right
from aiorts.control.operations import OPERATIONS
from aiorts.errors import AiortsError, ControlError, DeniedError
from aiorts.model.reading import from_plain
from aiorts.sessions import AsyncClient, Client, RightName
from control_parts import WAIT, controlled, entry_of, with_client

CALLS: dict[Right, tuple[str, dict[str, Any]]] = {
    Right.VIEW: ("names", {}),
    Right.OPERATE: ("configure", {"component": "counter0", "values": {"default": {"step": 2.0}}}),
    Right.CODE: ("create", {"type": "robot.py:Motor", "name": "motor0"}),
}
"""By right, a call that needs it."""


def test_the_calls_here_need_what_they_stand_for() -> None:
    for right, (name, arguments) in CALLS.items():
        operation = OPERATIONS[name]
        assert operation.needed(from_plain(operation.arguments, arguments)) is right


async def refusals(client: AsyncClient) -> dict[Right, str]:
    """By right, why a call that needs it is refused."""
    found = {}
    for right, (name, arguments) in CALLS.items():
        try:
            await client.call(name, WAIT, **arguments)
        except DeniedError as error:
            found[right] = str(error)
        except AiortsError:
            continue  # there is no such file
    return found


@pytest.mark.anyio
@pytest.mark.parametrize(("mode", "allowed"), [("on", Right.CODE), ("view", Right.VIEW)])
@pytest.mark.parametrize("wanted", ["", "view", "operate", "code"])
async def test_the_kernel_gives_the_smaller_of_what_is_wanted_and_what_it_allows(
    wanted: RightName, mode: str, allowed: Right
) -> None:
    given = Right(wanted) if wanted and allowed.allows(Right(wanted)) else allowed
    async with controlled("least", mode), AsyncClient.connect("least", right=wanted, timeout=WAIT) as client:
        assert client.right == given.value
        refused = await refusals(client)
    assert refused.keys() == {right for right in CALLS if not given.allows(right)}
    for right, text in refused.items():
        asked = f"this client asked for {wanted!r}; begin the session with right={right.value!r}"
        why = asked if allowed.allows(right) else f"this kernel allows {mode!r}; start it with --control on"
        assert text == f"{CALLS[right][0]}: needs the right {right.value!r}, and {why}"


@pytest.mark.anyio
async def test_the_blocking_client_asks_in_the_same_way() -> None:
    def use() -> str:
        with Client.open(entry_of("asked"), timeout=WAIT, right="view") as client:
            with pytest.raises(DeniedError, match="activate: needs the right 'operate', and this client asked for"):
                client.call("activate", WAIT, component="counter0")
            return client.right

    async with controlled("asked"):
        assert await asyncio.to_thread(use) == "view"


@pytest.mark.anyio
async def test_a_client_that_says_nothing_of_a_right_has_all_that_the_kernel_allows() -> None:
    async with controlled("silent"):
        assert await with_client("silent", lambda client: client.right) == "code"


@pytest.mark.anyio
async def test_a_right_that_there_is_not_is_refused() -> None:
    async with controlled("odd"):
        with pytest.raises(ControlError, match="hello: right: expected view, operate, code, got 'root'"):
            await AsyncClient.open("odd", right="root", timeout=WAIT)  # type: ignore[arg-type]
