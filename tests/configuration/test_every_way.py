"""Constraints hold on every way to a value, and what OpenRTM cannot set (empty text, a truth as text) can be set."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import pytest

from aiorts import Component, ExternalContext, Kernel, Param
from aiorts.cli.app import run_command
from aiorts.errors import ConfigurationError, DeclarationError
from aiorts.events import ParametersChanged
from aiorts.testing import simulated
from config_parts import hear

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable
    from pathlib import Path

SOURCE = """
from aiorts import Component, Param

class Bounded(Component):
    level = Param(1, ge=0, le=10)
    label = Param("")
    on = Param(False)
    configurations = {"high": {"level": 9}}
"""


class Bounded(Component):
    level = Param(1, ge=0, le=10)
    label = Param("")
    on = Param(False)
    configurations: ClassVar = {"high": {"level": 9}}

    async def on_execute(self) -> None:
        if hasattr(self, "wanted"):
            self.told = await self.wanted(self)


async def _in_a_hook(kernel: Kernel, bounded: Bounded, way: Callable[[Any], Any]) -> None:
    async def wanted(self: Bounded) -> BaseException | None:
        try:
            result = way(self)
            if result is not None:
                await result
        except ConfigurationError as error:
            return error
        return None

    bounded.wanted = wanted  # type: ignore[attr-defined]
    context = await kernel.start(ExternalContext(), bounded, activate=True)
    await context.tick()
    if (told := bounded.told) is not None:  # type: ignore[attr-defined]
        raise told


async def _from_a_file(kernel: Kernel, folder: Path, value: str) -> None:
    file = folder / "values.toml"
    file.write_text(
        f'schema = 1\n[components.one]\nactive = "default"\n[components.one.sets.default]\nlevel = {value}\n'
    )
    await kernel.load_configuration(file)


WAYS: dict[str, Callable[[Kernel, Any, Path], Awaitable[Any]]] = {
    "add": lambda k, c, p: k.add(Bounded("two"), level=11),
    "create": lambda k, c, p: k.create(Bounded, "two", level=11),
    "configure": lambda k, c, p: c.configure(level=11),
    "as text": lambda k, c, p: c.configure(level="11"),
    "of several": lambda k, c, p: c.configure(label="x", level=11),
    "change": lambda k, c, p: c.configuration.change("default", {"level": 11}),
    "change another": lambda k, c, p: c.configuration.change("high", {"level": 11}),
    "add a set": lambda k, c, p: c.configuration.add("more", {"level": 11}),
    "replace a set": lambda k, c, p: c.configuration.add("high", {"level": 11}, replace=True),
    "replace all": lambda k, c, p: c.configuration.replace({"default": {"level": 11}}),
    "merge": lambda k, c, p: c.configuration.merge({"default": {"label": "x"}, "high": {"level": 11}}),
    "in a hook": lambda k, c, p: _in_a_hook(k, c, lambda self: self.configure(level=11)),
    "soon": lambda k, c, p: _in_a_hook(k, c, lambda self: self.configuration.change_soon(level=11)),
    "file": lambda k, c, p: _from_a_file(k, p, "11"),
    "text in a file": lambda k, c, p: _from_a_file(k, p, '"much"'),
}


@pytest.mark.row(73, 75)
@pytest.mark.fault("B22")
@pytest.mark.parametrize("way", WAYS)
@simulated
async def test_a_value_out_of_bounds_is_refused_on_every_way(way: str, tmp_path: Path) -> None:
    """OpenRTM has constraints for its editor's widgets; the component takes whatever a tool or a file sends."""
    async with Kernel() as kernel:
        one = await kernel.add(Bounded("one"))
        changed = hear(kernel, ParametersChanged)
        before = one.configuration.profile
        with pytest.raises(ConfigurationError, match=r"level.*(10|much)"):
            await WAYS[way](kernel, one, tmp_path)
        assert one.configuration.profile == before
        assert (one.level, one.label, changed) == (1, "", [])
        assert "two" not in kernel.components


@pytest.mark.row(73)
def test_nor_is_it_declared_or_given_on_the_command_line_or_in_a_system_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(DeclarationError, match="level"):
        type("Wrong", (Bounded,), {"configurations": {"high": {"level": 11}}})
    (tmp_path / "bounded.py").write_text(SOURCE)
    system = tmp_path / "system.toml"
    system.write_text('schema = 1\n[components.one]\ntype = "bounded.py:Bounded"\nparams.level = 11\n')
    fine = tmp_path / "fine.toml"
    fine.write_text('schema = 1\n[components.one]\ntype = "bounded.py:Bounded"\n')
    for arguments in (["check", str(system)], ["run", str(system)], ["run", str(fine), "--set", "one.level=11"]):
        assert run_command(arguments) == 2
        said = "".join(capsys.readouterr())
        assert "level" in said
        assert "10" in said


@pytest.mark.row(72)
@simulated
async def test_empty_text_and_truths_as_text_are_values_like_any_other() -> None:
    """OpenRTM-aist-Python refuses an empty default, cannot set empty text, and reads "false" as int("false")."""
    async with Kernel() as kernel:
        one = await kernel.add(Bounded("one"))
        assert one.label == ""
        for given, label in (("x", "x"), ("", "")):
            await one.configure(label=given)
            assert one.label == label
        for given, on in (("true", True), ("false", False), ("1", True), ("0", False), ("yes", True), ("no", False)):
            await one.configure(on=given)
            assert one.on is on
        for given in ("maybe", "", "2"):
            with pytest.raises(ConfigurationError, match="on"):
                await one.configure(on=given)
        await one.configuration.add("empty", {})
        await one.configuration.activate("empty")
        assert (one.level, one.label, one.on) == (1, "", False)
