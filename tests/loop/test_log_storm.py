"""Everybody fails or talks at once: the log stays readable, the system stays visible, nothing is lost in silence."""

from __future__ import annotations

import io
import logging
import time
from typing import TYPE_CHECKING

import pytest

from aiorts import Component, ExternalContext, Kernel, SimulatedClock
from aiorts.kernel.loop.log import BYTES_PER_SECOND, LOGGER_NAME
from aiorts.testing.simulation import simulate

if TYPE_CHECKING:
    from collections.abc import Iterator


@pytest.fixture
def written() -> Iterator[io.StringIO]:
    """What a plain handler writes to a file."""
    text, logger = io.StringIO(), logging.getLogger(LOGGER_NAME)
    handler = logging.StreamHandler(text)
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s %(message)s"))
    logger.addHandler(handler)
    logger.propagate = False
    yield text
    logger.propagate = True
    logger.removeHandler(handler)


class Failing(Component):
    def on_execute(self) -> None:
        raise ValueError(f"bus fault of {self.name}: " + "x" * 60)


@pytest.mark.slow
@pytest.mark.fault("G13")
def test_thousand_components_that_fail_at_once_are_a_thousand_lines_at_most_then_a_summary(
    written: io.StringIO,
) -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel("plant") as kernel:
            members = [await kernel.add(Failing(f"c{n}")) for n in range(1000)]
            context = await kernel.start(ExternalContext(timing=False), *members, activate=True)
            await context.tick()
            await clock.advance(1.5)
            assert all(str(member.last_error).startswith(f"bus fault of c{n}:") for n, member in enumerate(members))
            assert kernel._repr_html_().count("error") >= 1000
            lines = written.getvalue().splitlines()
            assert "plant: its components logged more than" in lines[-1]
            assert "kernel.components has every state" in lines[-1]
            told = sum("on_execute failed" in line for line in lines)
            dropped = int(lines[-1].split(" more lines of ")[0].rsplit(" ", 1)[1])
            assert told >= 20
            assert told + dropped == 1000

    began = time.monotonic()
    simulate(main)
    assert time.monotonic() - began <= 5.0
    assert len(written.getvalue().splitlines()) <= 1001
    assert len(written.getvalue()) <= 1_000_000


class Talker(Component):
    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        self.said = 0

    def on_execute(self) -> None:
        for _ in range(1000):
            self.said += 1
            self.log.info("line %s of many", self.said)
            self.log.info(f"template {self.said} that is new each time")  # noqa: G004


@pytest.mark.slow(kept_by="loop/test_log.py::test_no_line_is_ever_lost_without_a_count")
@pytest.mark.fault("A21")
def test_component_that_logs_without_end_writes_a_megabyte_a_second_at_most_and_every_line_is_counted(
    written: io.StringIO,
) -> None:
    logging.getLogger(LOGGER_NAME).setLevel(logging.INFO)

    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            talker = await kernel.add(Talker("talker"))
            context = await kernel.start(ExternalContext(timing=False), talker, activate=True)
            for _ in range(3):
                await context.tick(8)
                await clock.advance(1.0)

    try:
        simulate(main)
    finally:
        logging.getLogger(LOGGER_NAME).setLevel(logging.NOTSET)
    assert len(written.getvalue()) <= 3 * BYTES_PER_SECOND + 10_000
    assert "dropped" in written.getvalue()
    assert " more like this" in written.getvalue()


@pytest.mark.slow
def test_quiet_component_is_heard_while_another_storms(written: io.StringIO) -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            talker, quiet = await kernel.add(Talker("talker")), await kernel.add(Component("quiet"))
            context = await kernel.start(ExternalContext(timing=False), talker, activate=True)
            await context.tick(8)
            quiet.log.warning("battery low")

    logging.getLogger(LOGGER_NAME).setLevel(logging.INFO)
    try:
        simulate(main)
    finally:
        logging.getLogger(LOGGER_NAME).setLevel(logging.NOTSET)
    assert "battery low" in written.getvalue()
