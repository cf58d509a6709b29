"""`--var` and `--remap`: the commands that read a system file read it with them."""

from __future__ import annotations

from pathlib import Path

import pytest

from run_parts import COMPONENTS, here

SYSTEM = """\
schema = 1
include = ["sinks.toml"]
[variables]
count = 2
loud = true
[components.counter]
type = "parts.py:Counter"
params.count = "${count}"
[[connections]]
from = "counter.out"
to = "first.numbers"
[contexts.loop]
kind = "periodic"
rate = 1000.0
members = ["counter", "first", "second"]
activate = "${loud}"
"""
SINKS = """\
schema = 1
[components.first]
type = "parts.py:Sink"
[components.second]
type = "parts.py:Sink"
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "parts.py").write_text(COMPONENTS)
    (tmp_path / "system.toml").write_text(SYSTEM)
    (tmp_path / "sinks.toml").write_text(SINKS)
    return tmp_path


@pytest.mark.slow(kept_by="test_plan_compares_a_file_with_itself")
def test_a_system_runs_with_its_variables(folder: Path) -> None:
    for arguments, count in (((), 2), (("--var", "count=5"), 5), (("--var", "count=5", "--set", "counter.count=4"), 4)):
        done = here(folder, "run", "system.toml", "--simulate", *arguments)
        assert (done.returncode, done.stderr) == (0, "")
        assert f"wrote {count} in periodic" in done.stdout


@pytest.mark.slow
def test_another_port_takes_the_place_of_one(folder: Path) -> None:
    for arguments, end in (((), "first"), (("--remap", "first.numbers=second.numbers"), "second")):
        drawn = here(folder, "graph", "system.toml", *arguments).stdout.splitlines()
        (node,) = [line.strip().partition("[")[0] for line in drawn if f"<b>{end}</b>" in line]
        (edge,) = [line for line in drawn if "-->" in line]
        assert edge.endswith(f" {node}")


def test_plan_compares_a_file_with_itself(folder: Path) -> None:
    done = here(folder, "plan", "system.toml", "system.toml", "--var", "count=5")
    assert (done.returncode, done.stdout) == (1, "~ configure counter: params.count 2 -> 5\n")
    done = here(folder, "plan", "system.toml", "system.toml", "--remap", "first.numbers=second.numbers")
    assert done.stdout == "+ connect counter.out -> second.numbers\n- disconnect counter.out -> first.numbers\n"


@pytest.mark.fault("F03")
@pytest.mark.parametrize("command", ["run", "check", "graph", "plan"])
@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("--var", "cuont=5", "system.toml: --var cuont=5: unknown variable 'cuont'; did you mean 'count'?"),
        ("--var", "loud=very", "system.toml: --var loud=very: expected true or false, got 'very'"),
        ("--remap", "first.number=a.b", "did you mean 'first.numbers'?"),
        ("--remap", "first", "system.toml: --remap first: expected COMPONENT.PORT=COMPONENT.PORT"),
    ],
)
def test_what_is_wrong_with_them_is_said_with_status_2(
    folder: Path, command: str, option: str, value: str, message: str
) -> None:
    files = ("system.toml", "system.toml") if command == "plan" else ("system.toml",)
    done = here(folder, command, *files, option, value)
    assert done.returncode == 2
    assert message in done.stdout + done.stderr
    assert f"{option} {value}: " in done.stdout + done.stderr


def test_a_component_alone_has_none_of_them(folder: Path) -> None:
    done = here(folder, "run", "parts.py:Counter", "--var", "count=5")
    assert done.returncode == 2
    assert "--var and --remap are for a system file, not for a component alone" in done.stderr


@pytest.mark.fault("F01")
@pytest.mark.parametrize("command", ["run", "check", "graph"])
def test_what_is_wrong_in_an_included_file_is_quoted_there(folder: Path, command: str) -> None:
    (folder / "sinks.toml").write_text(SINKS.replace("Sink", "Sinc", 1))
    done = here(folder, command, "system.toml")
    assert done.returncode == 2
    lines = (done.stdout if command == "check" else done.stderr).splitlines()
    at = next(number for number, line in enumerate(lines) if "sinks.toml:3:8: components.first.type: " in line)
    assert [line.strip() for line in lines[at + 1 : at + 3]] == ['type = "parts.py:Sinc"', "^" * 15]


def test_annotations_and_documents_name_the_included_file(folder: Path) -> None:
    (folder / "sinks.toml").write_text(SINKS.replace("Sink", "Sinc", 1))
    assert (
        "::error file=sinks.toml,line=3,col=8,endColumn=23"
        in here(folder, "check", "system.toml", "--format", "github").stdout
    )
    assert '"file": "sinks.toml", "line": 3, "column": 8' in here(folder, "check", "system.toml", "--json").stdout


def test_a_profile_is_made_of_the_system_with_its_variables(folder: Path) -> None:
    done = here(folder, "export", "system.toml", "--var", "count=5")
    assert (done.returncode, done.stderr) == (0, "")
    assert 'rts:name="count" rts:data="5"' in done.stdout
    assert done.stdout.count("<rts:Components ") == 3


@pytest.mark.slow
def test_a_page_of_a_system_has_the_types_of_included_files(folder: Path) -> None:
    (folder / "sinks").mkdir()
    (folder / "sinks.toml").rename(folder / "sinks" / "sinks.toml")
    (folder / "sinks" / "parts.py").write_text(COMPONENTS.replace("Fails at", "Elsewhere, fails at"))
    (folder / "system.toml").write_text(
        SYSTEM.replace("sinks.toml", "sinks/sinks.toml").replace("count = 2", "count = 7")
    )
    done = here(folder, "doc", "system.toml", "--remap", "first.numbers=second.numbers")
    assert (done.returncode, done.stderr) == (0, "")
    assert "Elsewhere, fails at the number" in done.stdout
    done = here(folder, "doc", "parts.py", "--var", "count=1")
    assert (done.returncode, "not for a component alone" in done.stderr) == (2, True)
