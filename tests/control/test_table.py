"""The whole table: each row with each right, its arguments in plain form, and the log of what changes something."""

from __future__ import annotations

import asyncio
import dataclasses
import os
import re
import typing
from typing import Any

import pytest

from aiorts.control.operation import Operation, Right
from aiorts.control.operations import OPERATIONS
from aiorts.control.server.service import Control
from aiorts.control.session import Session
from aiorts.errors import AiortsError, DeniedError, StaleError
from aiorts.model.plain import plain
from aiorts.model.reading import from_plain
from aiorts.sessions import Client
from control_parts import WAIT, controlled, entry_of

ROWS = list(OPERATIONS.values())
VALUES: dict[Any, Any] = {str: "counter0", float: 1.0, int: 1, bool: True, bytes: b"a", type(None): None}


def given(kind: Any) -> Any:
    """A value of an annotation of arguments."""
    if kind in VALUES:
        return VALUES[kind]
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if origin is tuple:
        return (given(inner[0]),) if inner[1:] == (...,) else tuple(given(one) for one in inner)
    if origin is typing.Literal:
        return inner[0]
    if inner and origin is not None and isinstance(origin, type) and issubclass(origin, typing.Mapping):  # type: ignore[arg-type]
        return {given(inner[0]): given(inner[1])}
    if inner:
        return given(inner[0])
    if dataclasses.is_dataclass(kind):
        return made(kind)
    return 1


def hints(kind: Any) -> dict[str, Any]:
    """The annotations of a class of arguments."""
    return typing.get_type_hints(kind)


def made(kind: Any) -> Any:
    """A value of a class of arguments: each field that has to be given."""
    required = [
        one
        for one in dataclasses.fields(kind)
        if one.default is dataclasses.MISSING and one.default_factory is dataclasses.MISSING
    ]
    return kind(**{one.name: given(hints(kind)[one.name]) for one in required})


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_a_row_says_what_it_does_and_its_arguments_come_back_from_their_plain_form(row: Operation) -> None:
    assert row.text.endswith(".")
    assert row.arguments.__doc__
    assert dataclasses.is_dataclass(row.arguments)
    assert row.arguments.__dataclass_params__.frozen
    value = made(row.arguments)
    assert from_plain(row.arguments, plain(value)) == value
    if dataclasses.is_dataclass(row.result):
        assert row.result.__doc__


@pytest.mark.slow(kept_by="first")
@pytest.mark.parametrize("right", list(Right), ids=lambda right: right.value)
@pytest.mark.anyio
async def test_each_row_is_denied_without_its_right_and_for_another_kernel(
    right: Right, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran: list[str] = []
    monkeypatch.setattr(Session, "begin", _noting(ran))
    async with controlled("rights") as kernel:
        listener = kernel.service(Control)._listener
        assert listener is not None
        listener.right = right

        def walk() -> dict[str, str]:
            codes = {}
            entry = entry_of("rights")
            for row in ROWS:
                arguments = plain(made(row.arguments))
                for epoch in (entry.epoch, "0" * 16):
                    with Client(dataclasses.replace(entry, epoch=epoch)) as client:
                        try:
                            client.call(row.name, WAIT, **arguments)
                            code = ""
                        except AiortsError as error:
                            code = error.code
                    codes[f"{row.name} {epoch == '0' * 16}"] = code
            return codes

        codes = await asyncio.to_thread(walk)
    for row in ROWS:
        allowed = right.allows(row.needed(made(row.arguments)))
        assert codes[f"{row.name} False"] == ("" if allowed else DeniedError.code), row.name
        assert codes[f"{row.name} True"] == StaleError.code, row.name
        assert (row.name in ran) == allowed, row.name


def _noting(ran: list[str]) -> Any:
    def begin(session: Session, number: int, operation: Operation, arguments: Any, _credit: int | None) -> None:
        ran.append(operation.name)
        session._send({"id": number, "ok": None, "end": None}, lambda: None)

    return begin


@pytest.mark.anyio
async def test_what_changes_something_is_a_line_in_the_log_and_what_looks_is_none(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level("INFO", "aiorts.control")

    def use() -> None:
        with Client.open(entry_of("audit"), timeout=WAIT, who='odd "name" of\na tester') as client:
            for name in ("names", "profile", "statistics", "log_levels"):
                client.call(name, WAIT)
            client.stream("events", WAIT).close()
            client.call("deactivate", WAIT, component="reader0")
            with pytest.raises(AiortsError):
                client.call("activate", WAIT, component="nobody")

    async with controlled("audit"):
        await asyncio.to_thread(use)
    lines = [one.getMessage() for one in caplog.records if one.name.startswith("aiorts.control")]
    done, refused = lines
    fields = re.compile(r'who="([^"]*)" kernel="([^"]*)" what="([^"]*)" outcome="([^"]*)"')
    (who, kernel, what, outcome), other = (fields.fullmatch(line).groups() for line in (done, refused))  # type: ignore[union-attr]
    assert re.fullmatch(rf"odd 'name' of a tester \[process {os.getpid()}\]", who)
    assert (kernel.rpartition("/")[2], outcome) == ("audit", "done")
    assert what.startswith("deactivate(component='reader0'")
    assert other[:2] == (who, kernel)
    assert other[2].startswith("activate(component='nobody'")
    assert other[3].startswith("refused E-")
