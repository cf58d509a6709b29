"""Making, loading and ending components within the process, who is told of it, and what the log keeps."""

from __future__ import annotations

import io
import logging
from pathlib import Path
from typing import Any

import pytest

from aiorts import Catalogue, Component, ExternalContext, Kernel
from aiorts.clock import SimulatedClock
from aiorts.errors import AiortsError, PluginError
from aiorts.events import ComponentAdded, ComponentRemoved, Event
from aiorts.testing import simulate

GOOD = "from aiorts import Component\nclass Good(Component):\n    '''A component.'''\n"
BAD = {
    "a file that is no Python": ("class Broken(Component:\n", "Broken", "1 could not be read"),
    "a module that raises": (
        "from aiorts import Component\nclass Broken(Component): pass\n1 / 0\n",
        "Broken",
        "ZeroDivisionError",
    ),
    "a missing module": (
        "from aiorts import Component\nimport not_there_at_all\nclass Broken(Component): pass\n",
        "Broken",
        "not_there_at_all",
    ),
}


@pytest.mark.row(87)
def test_components_are_loaded_made_and_ended_by_name_and_everybody_is_told(tmp_path: Path) -> None:
    (tmp_path / "good.py").write_text(GOOD)

    async def main(clock: SimulatedClock) -> None:
        told: list[Event] = []
        async with Kernel(plugins=Catalogue([tmp_path])) as kernel:
            assert "Good" in kernel.plugins.extensions("components")
            kernel.bus.subscribe(ComponentAdded, told.append)
            kernel.bus.subscribe(ComponentRemoved, told.append)
            made = [await kernel.create("Good") for _ in range(3)]
            assert [component.name for component in made] == ["good0", "good1", "good2"]
            assert {report.doc for report in kernel.profile().components.values()} == {"A component."}
            await kernel.remove(made[1])
            assert set(kernel.profile().components) == {"good0", "good2"}
            assert (await kernel.create("Good")).name == "good1"
            assert [(type(event).__name__, event.component) for event in told] == [  # type: ignore[attr-defined]
                *[("ComponentAdded", f"good{number}") for number in range(3)],
                ("ComponentRemoved", "good1"),
                ("ComponentAdded", "good1"),
            ]

    simulate(main)


@pytest.mark.row(88)
@pytest.mark.parametrize("case", BAD)
def test_what_went_wrong_when_loading_is_told_to_who_asked(case: str, tmp_path: Path) -> None:
    """OpenRTM's load_module returns RTC_OK whatever happens, and create_component nil without a reason."""
    text, name, says = BAD[case]
    (tmp_path / "broken.py").write_text(text)
    (tmp_path / "good.py").write_text(GOOD)

    async def main(clock: SimulatedClock) -> None:
        async with Kernel(plugins=Catalogue([tmp_path])) as kernel:
            before = kernel.profile().structure()
            with pytest.raises(AiortsError, match=says):
                await kernel.create(name)
            assert kernel.profile().structure() == before
            with pytest.raises(PluginError, match="did you mean Good"):
                await kernel.create("Goood")
            await kernel.create("Good")

    simulate(main)


@pytest.mark.row(94)
def test_whoever_manages_the_process_is_told_of_every_step_of_a_component() -> None:
    async def main(clock: SimulatedClock) -> None:
        told: list[str] = []
        async with Kernel() as kernel:
            kernel.bus.subscribe(Event, lambda event: told.append(type(event).__name__))
            part = await kernel.add(Component("part"))
            context = await kernel.start(ExternalContext(name="loop"), part, activate=True)
            await context.stop()
            await kernel.remove(part)
        assert told == [
            "ComponentAdded",
            "ContextStarted",
            "StateChanged",
            "StateChanged",
            "ContextStopped",
            "ComponentRemoved",
            "Closing",
        ]

    simulate(main)


class Talker(Component):
    def on_execute(self) -> None:
        for level in ("debug", "info", "warning", "error"):
            getattr(self.log, level)("%s at %s", level, self.context.ticks)


@pytest.mark.row(95)
def test_levels_and_several_sinks_are_those_of_standard_logging_and_the_last_lines_are_kept() -> None:
    async def main(clock: SimulatedClock) -> Any:
        async with Kernel("robot") as kernel:
            talker, other = await kernel.add(Talker("talker")), await kernel.add(Talker("other"))
            context = await kernel.start(ExternalContext(name="loop"), talker, other, activate=True)
            for _ in range(20):
                await context.tick()
                await clock.advance(1.5)
            return kernel.profile()

    everything, errors = io.StringIO(), io.StringIO()
    logger = logging.getLogger("aiorts.component")
    handlers = [logging.StreamHandler(everything), logging.StreamHandler(errors)]
    for handler, level in zip(handlers, (logging.DEBUG, logging.ERROR), strict=True):
        handler.setLevel(level)
        handler.setFormatter(logging.Formatter("%(levelname)s %(component)s %(hook)s %(tick)s %(message)s"))
        logger.addHandler(handler)
    handlers[1].addFilter(lambda record: record.component == "talker")  # type: ignore[attr-defined]
    old = logger.level
    logger.setLevel(logging.INFO)
    try:
        profile = simulate(main)
    finally:
        logger.setLevel(old)
        for handler in handlers:
            logger.removeHandler(handler)
    assert "DEBUG" not in everything.getvalue()
    assert "INFO other on_execute 20 info at 20" in everything.getvalue()
    assert {line.split()[0] for line in errors.getvalue().splitlines()} == {"ERROR"}
    assert {line.split()[1] for line in errors.getvalue().splitlines()} == {"talker"}
    kept = profile.components["talker"].log
    assert len(kept) == 16
    assert (kept[-1].level, kept[-1].text, kept[-1].hook) == ("ERROR", "error at 20", "on_execute")
    assert [line.level for line in kept[-3:]] == ["INFO", "WARNING", "ERROR"]
    assert [line.monotonic_ns for line in kept] == sorted(line.monotonic_ns for line in kept)
