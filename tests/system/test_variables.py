"""Variables, conditions and repeated parts: what a file says by them is what it would say written out."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from aiorts.model.wanted.system_text import system_text
from aiorts.system import Choices, SystemFile, check, load, prepare
from expansion_parts import refused

WHOLE = """\
schema = 1
[variables]
sim = true
rate = 100.0
count = 3
name = "robot"
data = "${name}/data.txt"
names = ["one", "two"]
[components.one]
type = "parts.py:Source"
params = { data = "${data}", rate_limit = "${count}" }
[components.two]
type = "parts.py:Sink"
[contexts.loop]
kind = "periodic"
rate = "${rate}"
members = "${names}"
activate = "${sim}"
"""


def with_params(params: str, variables: str = "") -> str:
    table = f"[variables]\n{variables}\n" if variables else ""
    return f'schema = 1\n{table}[components.one]\ntype = "parts.py:Source"\nparams = {params}\n'


def params(system: SystemFile) -> dict[str, Any]:
    return dict(system.components["one"].params)


def test_a_variable_alone_keeps_its_type_and_is_written_out_in_a_text(write: Callable[..., Path]) -> None:
    system = load(write(WHOLE))
    assert params(system) == {"data": "robot/data.txt", "rate_limit": 3}
    context = system.contexts["loop"]
    assert (context.options["rate"], context.members, context.activate) == (100.0, ("one", "two"), True)
    prepare(system)


def test_the_command_line_sets_variables(write: Callable[..., Path]) -> None:
    path = write(WHOLE)
    given = ("name=a=b", "rate=5", "count=2", 'names=["two"]', "sim=off")
    system = load(path, (), Choices(given))
    assert params(system) == {"data": "a=b/data.txt", "rate_limit": 2}
    context = system.contexts["loop"]
    assert (context.options["rate"], context.members, context.activate) == (5.0, ("two",), False)


@pytest.mark.fault("F03")
@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("sim=maybe", "expected true or false, got 'maybe'"),
        ("rate=fast", "expected a number, got 'fast'"),
        ("count=0x", "expected a number, got '0x'"),
        ("names=a,b", "expected a list, got 'a,b'"),
        ("names=[1]\nx = [2]", "expected a list, got"),
        ("names=" + "[" * 40 + "]" * 40, "expected a list, got"),
        ("rat=1", "unknown variable 'rat'; did you mean 'rate'?"),
        ("env=1", "unknown variable 'env'; there are"),
        ("rate", "expected NAME=VALUE, such as sim=true"),
        ("=1", "expected NAME=VALUE, such as sim=true"),
        ("name=\udcff", "'\\udcff' is not UTF-8"),
    ],
)
def test_a_variable_of_the_command_line_that_is_wrong_says_so(
    write: Callable[..., Path], text: str, message: str
) -> None:
    assert f"system.toml: --var {text[:80]}: {message}"[:60] in refused(write(WHOLE), Choices((text,)))


def test_a_variable_of_an_included_file_is_handed_on_by_the_including_one(write: Callable[..., Path]) -> None:
    write(WHOLE, "arm.toml")
    path = write('schema = 1\ninclude = ["arm.toml"]\n')
    message = refused(path, Choices(("rate=1",)))
    said = "system.toml: --var rate=1: arm.toml has it, and it is not handed on; declare rate in system.toml"
    assert message.startswith(said)
    assert message.endswith('vars = { rate = "${rate}" }')


@pytest.mark.fault("F03")
@pytest.mark.parametrize(
    ("text", "message"),
    [
        (with_params('{ data = "a ${nme}" }', 'name = ""'), "6:19: components.one.params.data: unknown variable 'nme'"),
        (with_params('{ data = "${name" }', 'name = ""'), "6:19: components.one.params.data: ${name has no closing"),
        (
            with_params('{ data = "${name}" }'),
            "4:19: components.one.params.data: unknown variable 'name'; there are",
        ),
        (with_params('{ data = "a${n}" }', "n = [1]"), "6:19: components.one.params.data: n is a list, which stands"),
        (with_params("{}", "a = { b = 1 }"), "3:5: variables.a: expected text, a number, true, false or a list, got"),
        (with_params("{}", '"a b" = 1'), "3:1: variables.a b: variable name 'a b': allowed are letters"),
        (with_params("{}", 'a = "${b}"\nb = 1'), "3:5: variables.a: b stands below it, and a default uses variables"),
        (with_params("{}", 'env = "HOME"'), "3:7: variables.env: env lists the variables that the environment may set"),
        (with_params("{}", "env = [3]"), "3:8: variables.env[1]: expected the name of a variable, got 3"),
        ("schema = 1\nvariables = 3\n", "2:13: variables: expected a table of defaults by name, got 3"),
    ],
)
def test_a_variable_of_a_file_that_is_wrong_says_so(write: Callable[..., Path], text: str, message: str) -> None:
    assert refused(write(text)).startswith(f"system.toml:{message}")


@pytest.mark.fault("F01")
@pytest.mark.parametrize("line", ["[components.motor{i}]", "if = ${sim}", "motor{i} = 1"])
def test_what_has_to_stand_in_quotes_is_told_so(write: Callable[..., Path], line: str) -> None:
    assert refused(write(f"schema = 1\n{line}\n")).endswith("what has {i} or ${name} in it stands in quotes")


def test_a_misspelt_table_of_variables_is_told_so(write: Callable[..., Path]) -> None:
    (finding,) = [one for one in check(write("schema = 1\n[variable]\na = 1\n")) if one.severity == "error"]
    assert finding.message == "unknown key 'variable'; did you mean 'variables'?"


def test_the_environment_is_read_by_name_alone(write: Callable[..., Path], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROBOT", "7")
    text = with_params('{ rate_limit = "${ROBOT}" }', "TABLE")
    assert params(load(write(text.replace("TABLE", "ROBOT = 1")))) == {"rate_limit": 1}
    assert params(load(write(text.replace("TABLE", 'env = ["ROBOT"]\nROBOT = 1')))) == {"rate_limit": 7}
    assert params(load(write(text.replace("TABLE", 'env = ["ROBOT"]')))) == {"rate_limit": "7"}
    assert params(load(write(text.replace("TABLE", 'env = ["ROBOT"]')), (), Choices(("ROBOT=8",)))) == {
        "rate_limit": "8"
    }
    monkeypatch.setenv("ROBOT", "many")
    message = refused(write(text.replace("TABLE", 'env = ["ROBOT"]\nROBOT = 1')))
    assert message == "system.toml:3:8: variables.env[1]: ROBOT of the environment: expected a number, got 'many'"
    monkeypatch.delenv("ROBOT")
    assert params(load(write(text.replace("TABLE", 'env = ["ROBOT"]\nROBOT = 1')))) == {"rate_limit": 1}
    message = refused(write(text.replace("TABLE", 'env = ["ROBOT"]')))
    assert message.endswith("ROBOT is not in the environment; set it, or write a default: ROBOT = ...")


def test_what_is_no_variable_is_written_with_two_dollars_and_saved_so(write: Callable[..., Path]) -> None:
    path = write(with_params('{ data = "$${a} $a $$ $$${a}" }', "a = 1"))
    system = load(path)
    assert params(system) == {"data": "${a} $a $$ $${a}"}
    again = write(system_text(system, path.parent), "again.toml")
    assert params(load(again)) == params(system)


def test_a_value_is_put_in_once(write: Callable[..., Path]) -> None:
    path = write(with_params('{ data = "${a}" }', 'a = ""\nb = "x"'))
    assert params(load(path, (), Choices(("a=${b}",)))) == {"data": "${b}"}


def test_a_variable_that_no_text_has_is_told_of(write: Callable[..., Path]) -> None:
    found = [one for one in check(write(WHOLE.replace('"${rate}"', "5.0"))) if one.code == "N-VARIABLE"]
    assert [(one.severity, one.line, one.where) for one in found] == [("note", 4, "variables.rate")]
    assert [one for one in check(write(WHOLE)) if one.code == "N-VARIABLE"] == []
