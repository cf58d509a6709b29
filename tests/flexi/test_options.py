"""The tables of options: what the originals had is there, what they set exists, and the README says what is true."""

from __future__ import annotations

from importlib.metadata import entry_points
from pathlib import Path

import pytest

from aiorts import Component
from aiorts_flexi.common.options import KINDS, Option
from aiorts_flexi.readme import COMPONENTS, TARGET, render

ORIGINAL = {
    "FlexiAdd": ["-p/--port", "-v/--verbosity"],
    "FlexiSelect": ["-p/--port", "-v/--verbosity"],
    "FlexiDupe": ["-p/--port", "-v/--verbosity", "-f"],
    "FlexiDump": ["-p/--port", "-n/--port-names", "-v/--verbosity"],
    "FlexiConst": ["-p/--port", "-c/--const", "-m/--type-mod", "-r/--rate", "-v/--verbosity", "-s"],
    "FlexiLogger": [
        *("-i/--input", "-o/--output", "-p/--port", "-n/--port-names", "-l/--logfile", "-t/--text", "-v/--verbosity"),
        "-c/--use_control",
    ],
    "FlexiFilter": [
        *("-i/--inputport", "-o/--outputport", "-m/--map", "-n/--newesttime", "-z/--zeroold", "-v/--verbosity")
    ],
}


WHILE_IT_RUNS = {"FlexiLogger": {"position", "step"}}
"""Parameters that are of use to a component that runs already, and so have no option."""


@pytest.mark.parametrize("cls", COMPONENTS, ids=lambda cls: cls.__name__)
def test_every_option_of_the_original_is_there(cls: type) -> None:
    known = [set(option.flags) for option in cls.options]
    for flags in ORIGINAL[cls.__name__]:
        assert any(set(flags.split("/")) <= option for option in known), flags


@pytest.mark.parametrize("cls", COMPONENTS, ids=lambda cls: cls.__name__)
def test_every_option_sets_a_parameter_that_takes_it_and_every_parameter_has_one(cls: type) -> None:
    params = cls("x").params
    flags = [flag for option in cls.options for flag in option.flags]
    assert len(flags) == len(set(flags))
    for option in cls.options:
        assert option.help
        if not option.param:
            continue
        spec = params[option.param].spec
        is_tuple = spec.type_text.startswith("tuple")
        assert is_tuple or option.kind != "repeat"
        if option.kind == "flag":
            spec.check(option.value)
        if option.kind == "number":
            assert spec.type_text in ("int", "float", "float | None")
    assert {option.param for option in cls.options} >= set(params) - WHILE_IT_RUNS.get(cls.__name__, set())


@pytest.mark.parametrize("cls", COMPONENTS, ids=lambda cls: cls.__name__)
def test_every_action_is_a_class_method(cls: type) -> None:
    for option in cls.options:
        assert not option.action or (
            option.kind == "flag" and not option.param and callable(getattr(cls, option.action))
        )


def test_an_option_of_an_unknown_kind_is_refused() -> None:
    assert KINDS == ("text", "number", "flag", "repeat")
    with pytest.raises(ValueError, match="kind of text"):
        Option(("-x",), "x", "list", "")
    with pytest.raises(ValueError, match="expected flags"):
        Option((), "x", "text", "")


def test_every_component_is_offered_by_name() -> None:
    offered = {point.name: point.load() for point in entry_points(group="aiorts.components")}
    assert all(offered[cls.__name__] is cls for cls in COMPONENTS)


def test_options_do_not_stand_in_the_way_of_what_every_component_has() -> None:
    assert not {"options", "interface", "verbosity", "log_ports"} & set(dir(Component))


def test_the_readme_is_current() -> None:
    assert Path(TARGET).read_text(encoding="utf-8") == render(), "run: python -m aiorts_flexi.readme"
