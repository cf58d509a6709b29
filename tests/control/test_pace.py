"""The share of the loop that clients have: what is owed for what they took has a bound, whatever a clock says."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from types import SimpleNamespace

import pytest

from aiorts.control import pace
from aiorts.control.pace import Pace, looks_of
from aiorts.errors import NoAnswerError
from aiorts.sessions import AsyncClient
from control_parts import WAIT, controlled, entry_of


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    now = [0.0]
    monkeypatch.setattr(pace, "time", SimpleNamespace(monotonic=lambda: now[0]))
    return now


def test_what_is_used_is_waited_for_and_no_debt_is_longer_than_what_can_be_saved(clock: list[float]) -> None:
    one = Pace(0.2, 0.5)
    one.spend(0.6)
    assert one.due() == pytest.approx(0.5)
    clock[0] += 0.5
    assert one.due() == pytest.approx(0.0, abs=1e-9)
    one.spend(3_600.0)
    assert one.due() == pytest.approx(2.5)
    one.spend(3_600.0)
    assert one.due() == pytest.approx(2.5)


@pytest.mark.anyio
@pytest.mark.parametrize(
    ("operation", "arguments"),
    [("counters", {"rate": 50.0}), ("monitor", {"paths": ["counter0.out", "reader0.in"], "rate": 10_000.0})],
)
async def test_streams_that_look_again_and_again_wait_for_their_share_of_the_loop(
    operation: str, arguments: dict[str, object]
) -> None:
    """A stream of each viewer at the highest rate else took all of the loop."""
    async with (
        controlled("looked") as kernel,
        AsyncClient.connect(entry_of("looked"), right="view") as client,
        asyncio.timeout(WAIT),
        client.stream(operation, **arguments) as stream,
    ):
        await stream.next()
        looks_of(kernel).spend(3_600.0)  # as long looks do
        with suppress(NoAnswerError):
            while await stream.next(0.1):  # what was under way, then nothing
                pass
        assert looks_of(kernel).due()
        assert await stream.next()
