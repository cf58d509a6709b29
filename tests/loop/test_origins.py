"""A failure names the line of the user's own code that it came from, and naming it never fails."""

from __future__ import annotations

import json
import os
import random
import sys
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from aiorts import Component, Kernel, OutPort, Param, PeriodicContext
from aiorts.errors import ComponentError, ConfigurationError, PortTypeError
from aiorts.events import HookFailed
from aiorts.kernel.loop.origins import is_foreign, located, origin_of
from aiorts.testing import simulated
from aiorts.types import TimedDouble
from hostile import hostile

HERE = Path(__file__).resolve()


def code(tmp_path: Path, name: str, text: str) -> dict[str, Any]:
    """What a file of this name and text defines."""
    path = tmp_path / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    found: dict[str, Any] = {}
    exec(compile(text, str(path), "exec"), found)
    return found


def raised(call: Any, *args: Any) -> BaseException:
    try:
        call(*args)
    except Exception as error:
        trace = error.__traceback__
        return error.with_traceback(trace and trace.tb_next)  # from the call on: this file is a user's, too
    raise AssertionError("it did not raise")


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_innermost_frame_of_the_user_is_named_from_the_current_folder(here: Path) -> None:
    user = code(here, "robot/arm.py", "import json\ndef move():\n    json.loads('[')\ndef on():\n    move()\n")
    error = raised(user["on"])
    assert origin_of(error) == f"robot{os.sep}arm.py:3"
    assert located(error).endswith(f" (robot{os.sep}arm.py:3)")


def test_a_file_elsewhere_has_its_whole_path(tmp_path: Path) -> None:
    assert origin_of(raised(code(tmp_path, "arm.py", "def on():\n    1 / 0\n")["on"])) == f"{tmp_path / 'arm.py'}:2"


def test_where_aiorts_refuses_it_is_the_line_that_asked(here: Path) -> None:
    text = "from aiorts.types import TimedDouble\ndef on():\n    TimedDouble(0, 'no')\n"
    assert origin_of(raised(code(here, "arm.py", text)["on"])) == "arm.py:3"


@pytest.mark.parametrize("kind", ["aiorts.types.record", "dataclasses.dataclass"])
def test_what_a_record_refuses_itself_names_the_line_that_makes_it_and_the_one_that_raises(
    kind: str, here: Path
) -> None:
    fix = "class Fix:\n    n: int = 0\n    def __post_init__(self):\n        check(self.n)\n"
    text = f"import aiorts.types, dataclasses\ndef check(n):\n    raise ValueError(n)\n@{kind}\n{fix}"
    user = code(here, "arm.py", text)
    exec(compile("def on():\n    Fix(n=3)\n", str(here / "move.py"), "exec"), user)
    assert origin_of(raised(user["on"])) == "move.py:2, raised in arm.py:3"
    assert origin_of(raised(user["Fix"], 3)) == "arm.py:3"


def test_an_installed_component_has_its_own_line_and_what_it_refuses_has_none(here: Path) -> None:
    text = "from aiorts.errors import ConfigurationError as E\ndef on(kind):\n    raise kind('no')\n"
    on = code(here, "lib/site-packages/arms/arm.py", text)["on"]
    error = raised(on, ValueError)
    assert origin_of(error) == ""
    assert origin_of(error, installed=True).endswith("arm.py:3")
    assert origin_of(raised(on, ConfigurationError), installed=True) == ""


def test_aiorts_the_standard_library_and_generated_code_are_nobodys_own() -> None:
    import aiorts_flexi

    assert all(map(is_foreign, (json.__file__, sys.modules["aiorts"].__file__, aiorts_flexi.__file__, "<string>")))
    assert not is_foreign(str(HERE))
    assert not is_foreign("<stdin>")


def test_an_exception_without_a_traceback_has_no_origin_and_a_deep_one_ends() -> None:
    assert origin_of(ValueError("x")) == ""
    assert located(ValueError("x")) == "ValueError: x"

    def deep(left: int) -> None:
        deep(left - 1)

    assert origin_of(raised(deep, 10**6)).startswith(str(HERE).removeprefix(f"{os.getcwd()}{os.sep}"))


def test_naming_the_line_of_a_hostile_exception_never_fails() -> None:
    rng = random.Random(7)
    for _ in range(300):
        error = hostile(rng)

        with suppress(type(error)):
            raise error
        assert "test_origins.py:" in origin_of(error)
        assert located(error).endswith(")")


def test_a_folder_that_was_deleted_is_no_reason_to_fail(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def gone() -> str:
        raise FileNotFoundError("no current folder")

    error = raised(code(tmp_path, "arm.py", "def on():\n    1 / 0\n")["on"])
    monkeypatch.setattr(os, "getcwd", gone)
    assert origin_of(error) == f"{tmp_path / 'arm.py'}:2"


class Picky(Component):
    """Its check has a mistake of its own."""

    gain = Param(1.0)

    def check_configuration(self, values: Mapping[str, Any]) -> None:
        if values["gain"] == 2.0:
            raise KeyError("gian")


@simulated
async def test_a_check_of_values_that_fails_is_named_with_its_line() -> None:
    async with Kernel() as kernel:
        picky = await kernel.add(Picky("picky"))
        with pytest.raises(ConfigurationError, match=rf"raised KeyError: 'gian' \(.*{HERE.name}:\d+\); nothing was"):
            await picky.configure(gain=2.0)


class Careless(Component):
    """Writes what its port does not take, in the hook that is named."""

    out = OutPort(TimedDouble)
    fails = "on_execute"

    async def _fail(self, hook: str) -> None:
        if hook == self.fails:
            await self.out.write("no")  # type: ignore[arg-type]

    async def on_initialize(self) -> None:
        await self._fail("on_initialize")

    async def on_activated(self) -> None:
        await self._fail("on_activated")

    async def on_execute(self) -> None:
        await self._fail("on_execute")

    async def on_finalize(self) -> None:
        await self._fail("on_finalize")


@simulated
async def test_events_log_lines_and_errors_of_failing_hooks_name_the_line(caplog: pytest.LogCaptureFixture) -> None:
    line = next(n for n, text in enumerate(HERE.read_text().splitlines(), 1) if 'write("no")  #' in text)
    place = f"{HERE.name}:{line}"
    for hook in ("on_initialize", "on_activated", "on_execute", "on_finalize"):
        caplog.clear()
        events: list[HookFailed] = []
        async with Kernel() as kernel:
            kernel.bus.subscribe(HookFailed, events.append)
            careless = Careless("careless")
            careless.fails = hook
            if hook == "on_initialize":
                with pytest.raises(PortTypeError):
                    await kernel.add(careless)
            else:
                await kernel.add(careless)
                context = await kernel.start(PeriodicContext(10.0), careless)
                if hook == "on_activated":
                    with pytest.raises(ComponentError, match=rf"on_activated raised PortTypeError: .*{place}\); it is"):
                        await context.activate(careless)
                else:
                    await context.activate(careless)
                    await kernel.sleep(0.25)
        assert [event.hook for event in events] == [hook]
        assert events[0].origin.endswith(place)
        if hook != "on_initialize":
            assert any(f"{place})" in record.getMessage() for record in caplog.records)
