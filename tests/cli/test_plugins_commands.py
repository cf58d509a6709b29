"""Folders of plugins for every command, and what plugins add to the command line itself."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from plugin_dists import COMPONENT, project
from run_parts import here

COMMAND = """
import click
@click.command()
@click.option("--times", default=1)
def hello(times):
    '''Greet.'''
    click.echo("hello " * times)
@click.command()
def fails(): raise ValueError("out of\\x1b[2J paint")
@click.command()
def status(): return 7
@click.command()
def ends(): raise SystemExit(5)
@click.command()
def usage(): raise click.UsageError("not like that")
no_command = 5
"""
ENTRIES = {f"commands/{name}": f"greets:{name}" for name in ("hello", "fails", "status", "ends", "usage", "no_command")}


def aiorts(*arguments: str, plugins: str = "", stdin: str = "") -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "aiorts", *arguments],
        input=stdin,
        capture_output=True,
        text=True,
        timeout=40,
        env={**os.environ, "AIORTS_PLUGINS": plugins},
    )


@pytest.fixture(scope="module")
def greets(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("plugins") / "greets"
    entries = {**ENTRIES, "commands/run": "greets:hello", "commands/two words": "greets:hello"}
    return project(folder, "greets", {"greets": COMMAND + COMPONENT}, {**entries, "components/Good": "greets:Good"})


@pytest.mark.slow(kept_by="test_inspect_sees_the_folders_named_for_every_command")
def test_a_folder_named_for_all_commands_or_in_the_environment_is_seen_by_each(greets: Path, tmp_path: Path) -> None:
    for done in (
        aiorts("--plugins", str(greets), "hello", "--times", "2"),
        aiorts("hello", "--times", "2", plugins=os.pathsep.join(("", str(tmp_path / "none"), str(greets)))),
    ):
        assert (done.returncode, done.stdout, done.stderr) == (0, "hello hello \n", "")
    assert here("hello").returncode == 2
    assert f"folder {greets}" in here("--plugins", str(greets), "plugins").stdout
    assert here("--plugins", str(greets), "good", "--for", "0.05").returncode == 0
    (tmp_path / "system.toml").write_text(
        'schema = 1\n[components.one]\ntype = "Good"\n[contexts.c]\nkind = "event"\nmembers = ["one"]\n'
    )
    run = here("--plugins", str(greets), "run", str(tmp_path / "system.toml"), "--duration", "0.05")
    assert (run.returncode, run.stderr) == (0, "")
    assert "no component named 'Good'" in here("run", str(tmp_path / "system.toml")).stderr


def test_a_folder_that_is_not_there_is_refused_where_it_is_typed_and_reported_where_it_is_not(tmp_path: Path) -> None:
    typed = here("--plugins", str(tmp_path / "none"), "plugins")
    assert (typed.returncode, typed.stdout) == (2, "")
    assert typed.stderr.startswith("aiorts: E-USAGE: ")
    assert "does not exist" in typed.stderr
    told = here("plugins", AIORTS_PLUGINS=str(tmp_path / "none"))
    assert told.returncode == 1
    assert "FlexiDump" in told.stdout
    assert "No such file or directory" in told.stderr
    assert here("--version", AIORTS_PLUGINS=str(tmp_path / "none")).returncode == 0


def test_help_names_commands_of_plugins_and_components_without_importing_them(greets: Path) -> None:
    (greets / "greets.py").rename(greets / "away.py")
    try:
        first = here("--plugins", str(greets), "--help")
        done = here("--plugins", str(greets), "help", "commands")
    finally:
        (greets / "away.py").rename(greets / "greets.py")
    assert (first.returncode, first.stderr) == (done.returncode, done.stderr) == (0, "")
    assert "hello" in first.stdout.partition("Commands of other plugins:")[2].partition(".")[0]
    assert re.search(rf"^  hello +Of folder {greets}"[:24], done.stdout, re.MULTILINE)
    assert "two words" not in done.stdout
    assert "log         Recordings: " in done.stdout
    assert done.stdout.count("Run a system file, or one component.") == 1
    assert "flexiselect" in done.stdout


@pytest.mark.slow(kept_by="first")
@pytest.mark.parametrize(
    ("name", "status", "expected"),
    [
        ("status", 7, ""),
        ("ends", 5, ""),
        ("usage", 2, "aiorts: E-USAGE: aiorts usage: not like that; see aiorts usage --help\n"),
        ("helo", 2, "aiorts: E-USAGE: aiorts: no command 'helo'; did you mean 'hello'?; see aiorts --help\n"),
    ],
)
def test_a_command_of_a_plugin_ends_as_it_wants(greets: Path, name: str, status: int, expected: str) -> None:
    done = aiorts("--plugins", str(greets), name)
    assert (done.returncode, done.stdout, done.stderr) == (status, "", expected)


@pytest.mark.slow(kept_by="first")
@pytest.mark.fault("F05")
def test_a_command_that_fails_is_one_line_and_its_traceback_is_there_on_demand(greets: Path) -> None:
    done = here("--plugins", str(greets), "fails")
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith("aiorts: E-PLUGIN: command 'fails' of folder ")
    assert done.stderr.count("\n") == 1
    assert "\x1b" not in done.stderr
    assert done.stderr.endswith("`aiorts --debug fails` shows the traceback\n")
    debug = aiorts("--plugins", str(greets), "--debug", "fails")
    assert debug.returncode == 1
    assert "greets.py" in debug.stderr
    assert "Traceback" in debug.stderr


def test_aiorts_own_commands_come_first_and_the_clash_is_reported(greets: Path) -> None:
    assert "SYSTEM.toml" in here("--plugins", str(greets), "run", "--help").stdout
    done = here("--plugins", str(greets), "plugins")
    assert done.returncode == 1
    faults = done.stderr.splitlines()
    assert len(faults) == 2
    assert any("command 'run'" in fault and "comes first; rename yours" in fault for fault in faults)
    assert any("command 'two words': such a name cannot be typed" in fault for fault in faults)


@pytest.mark.slow(kept_by="control/test_live_files.py::test_filter_reaches_a_component_with_the_name_of_a_command")
def test_a_component_with_the_name_of_a_command_is_reached_as_a_filter_and_the_clash_is_named(tmp_path: Path) -> None:
    part = "from aiorts import Component\nclass Ls(Component):\n    '''Not the command.'''\n"
    folder = str(project(tmp_path / "part", "part", {"part": part}, {"components/Ls": "part:Ls"}))
    assert "Not the command." in here("--plugins", folder, "filter", "ls", "--help").stdout
    assert "List what runs" in here("--plugins", folder, "ls", "--help").stdout
    done = here("--plugins", folder, "plugins", "--check")
    assert done.returncode == 1
    assert "component 'Ls': `aiorts ls` is a command of aiorts, which comes first; rename yours" in done.stderr
    assert done.stderr.endswith(", or write `aiorts filter ls`\n")


@pytest.mark.fault("F05")
def test_components_that_differ_in_capitals_alone_are_refused_as_a_command(tmp_path: Path) -> None:
    entries = {"components/Good": "greets:Good", "components/GOOD": "greets:Good"}
    project(tmp_path, "greets", {"greets": COMPONENT}, entries)
    done = here("--plugins", str(tmp_path), "good")
    assert done.returncode == 2
    assert "`aiorts good` is offered twice" in done.stderr
    assert "`aiorts good` is offered twice" in here("--plugins", str(tmp_path), "plugins").stderr


def test_nothing_that_is_listed_commands_the_terminal(tmp_path: Path) -> None:
    odd = "a\\u001b[31mb\\nc\\u202e\\u0000"
    (tmp_path / "pyproject.toml").write_text(
        f'[project]\nname = "odd"\n[project.entry-points."aiorts.components"]\n"{odd}" = "x\\u001b:y"\n"Ünï" = "x:y"\n'
        f'[project.entry-points."aiorts.{odd}"]\n"x" = "x:y"\n'
    )
    for arguments in (("plugins",), ("plugins", "--json"), ("--help",), ("help", "commands")):
        done = here("--plugins", str(tmp_path), *arguments)
        assert not [c for c in done.stdout + done.stderr if not c.isprintable() and c != "\n"]
    listed = here("--plugins", str(tmp_path), "plugins")
    assert listed.stdout.count("folder") == 2
    assert "Ünï" in listed.stdout


@pytest.mark.slow(
    kept_by="extensions/test_finders.py::test_a_type_is_imported_when_its_name_is_asked_for_and_no_other_is"
)
@pytest.mark.row(64)
def test_a_type_of_a_plugin_is_used_by_its_name_alone(tmp_path: Path) -> None:
    text = "from aiorts.types import record\n@record\nclass DepthOfPlugin:\n    tm: int = 0\n    below: float = 0.0\n"
    project(tmp_path, "depths", {"depths": text}, {"types/DepthOfPlugin": "depths:DepthOfPlugin"})
    line = '{"type": "DepthOfPlugin", "tm": 1000000000, "data": {"below": 2.5}}\n'
    done = aiorts("--plugins", str(tmp_path), "flexidump", "-p", "DepthOfPlugin", stdin=line)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == 'input0 DepthOfPlugin 1.000000000: {"below": 2.5}\n'
    mistyped = aiorts("--plugins", str(tmp_path), "flexidump", "-p", "DepthOfPlugn", stdin=line)
    assert mistyped.returncode == 2
    assert "did you mean DepthOfPlugin" in mistyped.stderr


@pytest.mark.slow(kept_by="test_a_module_of_types_that_cannot_be_had_is_one_line")
@pytest.mark.row(64)
@pytest.mark.parametrize("way", ["depths", "./depths.py"])
def test_a_module_of_types_is_named_on_the_command_line(tmp_path: Path, way: str) -> None:
    (tmp_path / "depths.py").write_text(
        "from dataclasses import dataclass\n@dataclass\nclass Deep:\n    below: float\n"
    )
    done = subprocess.run(
        [sys.executable, "-m", "aiorts", "flexidump", "-p", "Deep", "--type-mod", way, "--format", "values"],
        input='{"below": 2.5}\n',
        capture_output=True,
        text=True,
        timeout=40,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": os.environ.get("PYTHONPATH", "")},
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert "2.5" in done.stdout


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("raise SystemExit(3)", "SystemExit: 3"),
        ("def (:", "SyntaxError"),
        (None, "there is no such module"),
    ],
)
def test_a_module_of_types_that_cannot_be_had_is_one_line(tmp_path: Path, text: str | None, expected: str) -> None:
    if text is not None:
        (tmp_path / "depths.py").write_text(text)
    done = here("--plugins", str(tmp_path), "flexidump", "-p", "TimedLong", "--type-mod", "depths")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("aiorts: E-PLUGIN: ")
    assert "--type-mod" in done.stderr
    assert "depths" in done.stderr
    assert expected in done.stderr
    assert done.stderr.count("\n") == 1


def test_inspect_sees_the_folders_named_for_every_command(greets: Path) -> None:
    for done in (
        here("--plugins", str(greets), "inspect", "Good"),
        here("inspect", "Good", AIORTS_PLUGINS=str(greets)),
    ):
        assert done.returncode == 0, done.stderr
        assert f"folder {greets}" in done.stdout


@pytest.mark.slow(kept_by="test_inspect_sees_the_folders_named_for_every_command")
def test_doctor_sees_the_folders_named_for_every_command(tmp_path: Path) -> None:
    (tmp_path / "pyproject.toml").write_text("[project\n")
    assert str(tmp_path) in here("--plugins", str(tmp_path), "doctor").stdout


@pytest.mark.parametrize(
    "words",
    [
        ("flexidump", "-p", "DepthOfPlugin"),
        ("inspect", "DepthOfPlugin"),
        ("types", "DepthOfPlugin"),
        ("log", "info", "none.mcap"),
        ("new", "mine"),
        ("doctor",),
        ("replay", "none.mcap"),
    ],
)
def test_each_command_that_loads_types_has_the_option_of_all_commands_once(
    words: tuple[str, ...],
) -> None:
    page = here(*words[: 2 if words[0] == "log" else 1], "--help").stdout
    assert page.count("--plugins DIR") == 1
    done = here(*words, "--plugins", "nowhere")
    assert done.returncode == 2
    assert "Invalid value for '--plugins': Directory 'nowhere' does not exist" in done.stderr


def test_a_command_that_loads_no_type_has_no_such_option() -> None:
    assert "--plugins" not in here("ls", "--help").stdout
