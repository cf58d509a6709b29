"""A component's command-line options as parameters, as a system file has them under `options`."""

from __future__ import annotations

from typing import Any

import pytest

from aiorts import Catalogue, Component, Param
from aiorts.errors import ConfigurationError
from aiorts.system import option_params, parse_options


class Plain(Component):
    rate_limit = Param(1.0)
    name_of_it = Param("x")


def flexi(name: str) -> Any:
    return Catalogue().find("components", name).load()


@pytest.mark.parametrize(
    ("arguments", "params"),
    [
        ([], {}),
        (["-i", "TimedLong", "-i", "TimedDouble:3"], {"inputs": ("TimedLong", "TimedDouble:3")}),
        (["--inputport=TimedLong", "-m0>0"], {"inputs": ("TimedLong",), "map": "0>0"}),
        (["-m", "0>-1>0"], {"map": "0>-1>0"}),
        (["-n", "-z"], {"time": "newest", "zero_old": True}),
        (["--clamp", "-1,1", "-v", "2"], {"clamp": "-1,1", "verbosity": "2"}),
        (["-m", "0>0", "-m", "0>2>0"], {"map": "0>2>0"}),
    ],
)
def test_options_are_what_they_are_on_a_command_line(arguments: list[str], params: dict[str, Any]) -> None:
    assert parse_options(flexi("FlexiFilter"), arguments) == params


def test_a_class_without_a_table_has_an_option_for_each_parameter() -> None:
    assert parse_options(Plain, ["--rate-limit", "5", "--name-of-it=y=z"]) == {"rate_limit": "5", "name_of_it": "y=z"}


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--inputprot", "TimedLong"], "did you mean --inputport?"),
        (["--zzz=1"], "there are -i, --inputport"),
        (["TimedLong"], "expected an option such as -i"),
        (["-m"], "-m: its value is missing; write -m VALUE"),
        (["--zeroold=1"], "--zeroold: takes no value, got '1'"),
        (["--check"], "--check: is for a command line"),
        (["--type-mod", "os"], "--type-mod: is for a command line"),
    ],
)
def test_a_bad_option_is_named_with_what_to_do(arguments: list[str], said: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        parse_options(flexi("FlexiFilter"), arguments)
    assert said in str(caught.value)


def test_values_by_place_in_the_table_are_what_a_command_line_parser_has() -> None:
    table = flexi("FlexiFilter").options
    assert option_params(table, {0: ("TimedLong",), 1: (), 2: None, 3: True, 4: False}) == {
        "inputs": ("TimedLong",),
        "time": "newest",
    }
