"""What a kernel can create: offered types are named without importing them, and described when they are wanted."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from aiorts import Catalogue, Kernel
from aiorts.errors import AbsentError, DeniedError
from aiorts.sessions import Client
from control_parts import WAIT, controlled, with_client

OFFERED = '''
from aiorts import Component, InPort, OutPort, Param
from aiorts.types import TimedDouble

class Gain(Component):
    """Makes samples larger.

    By its gain.
    """

    into = InPort(TimedDouble, name="in", unit="m")
    out = OutPort(TimedDouble)
    gain: float = Param(2.0, ge=0.0, unit="1", doc="How much larger.")
'''


async def asked(name: str, **arguments: Any) -> dict[str, Any]:
    def ask(client: Client) -> dict[str, Any]:
        return dict(client.call("catalogue", WAIT, **arguments))

    return await with_client(name, ask)


@pytest.mark.anyio
async def test_types_are_named_at_once_and_described_when_they_are_wanted(tmp_path: Path) -> None:
    (tmp_path / "offered_gain.py").write_text(OFFERED)
    (tmp_path / "offered_broken.py").write_text("from aiorts import Component\nclass Broken(Component): x = 1 / 0\n")
    services: dict[str, Any] = {"control": {"name": "offers"}}
    async with Kernel(plugins=Catalogue((tmp_path,)), services=services) as kernel:
        found = (await asked("offers"))["components"]
        gain = found["Gain"]
        assert (gain["source"], gain["target"]) == (f"file {tmp_path / 'offered_gain.py'}", "offered_gain.py:Gain")
        assert (gain["unknown"], gain["ports"], gain["params"]) == ("is not imported yet", [], {})
        assert "FlexiAdd" in found

        gain = (await asked("offers", components=["Gain", "Broken"]))["components"]["Gain"]
        assert (gain["unknown"], gain["doc"]) == ("", "Makes samples larger.\n\nBy its gain.")
        assert [(one["name"], one["direction"], one["unit"]) for one in gain["ports"]] == [
            ("in", "in", "m"),
            ("out", "out", None),
        ]
        param = gain["params"]["gain"]
        assert (param["value"], param["ge"], param["doc"]) == (2.0, 0.0, "How much larger.")

        found = await asked("offers", contexts=["periodic"])
        assert found["components"]["Gain"] == gain
        assert found["contexts"]["periodic"]["options"]["rate"] == ["a number"]
        assert not kernel.components

        broken = (await asked("offers", components=["Broken"]))["components"]["Broken"]
        assert "ZeroDivisionError" in broken["unknown"]
        with pytest.raises(AbsentError, match=r"Gian: no such type of component; did you mean Gain\?"):
            await asked("offers", components=["Gian"])


@pytest.mark.anyio
async def test_who_only_looks_has_nothing_imported() -> None:
    async with controlled("viewed", mode="view"):
        assert "FlexiAdd" in (await asked("viewed"))["components"]
        with pytest.raises(DeniedError):
            await asked("viewed", components=["FlexiAdd"])


@pytest.mark.slow(kept_by="test_types_are_named_at_once_and_described_when_they_are_wanted")
@pytest.mark.anyio
async def test_the_shell_completes_types_and_their_parameters(
    tmp_path: Path, completed: Callable[..., set[str]]
) -> None:
    (tmp_path / "offered_gain2.py").write_text(OFFERED.replace("Gain(", "Gainer("))
    async with Kernel(plugins=Catalogue((tmp_path,)), services={"control": {"name": "typed"}}):
        assert await asyncio.to_thread(completed, "comp", "create", "Gai") == {"Gainer"}
        await asked("typed", components=["Gainer"])
        assert await asyncio.to_thread(completed, "comp", "create", "Gainer", "typed/one", "") == {"gain="}
