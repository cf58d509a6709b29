"""Every error code is explained, every command is found, and `--version` says what it should."""

from __future__ import annotations

import re
import subprocess
import sys
import time
import tomllib
from importlib.metadata import entry_points
from pathlib import Path

import click
import pytest
from test_layers import ROOT, sources

import aiorts
import aiorts.cli.app
import aiorts.errors
from aiorts.cli.app import run_command
from aiorts.cli.console.codes import CODES
from aiorts.errors import AiortsError, MissingExtra
from aiorts.guide import pages
from aiorts.tiers import EXPERIMENTAL, NOT_STABLE, PROVISIONAL, tier_of_command
from run_parts import here

PRINTED = re.compile(r'"(?:aiorts: )?([EWN]-[A-Z][A-Z-]*)[":]')


def printed_codes() -> dict[str, set[str]]:
    """Every code that stands in the source, and in which files."""
    found: dict[str, set[str]] = {}
    for path in sources("aiorts", "plugins"):
        if path.name != "codes.py":
            for code in PRINTED.findall(path.read_text(encoding="utf-8")):
                found.setdefault(code, set()).add(path.relative_to(ROOT).as_posix())
    return found


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    capsys.readouterr()
    status = run_command(arguments)
    said = capsys.readouterr()
    return status, said.out, said.err


@pytest.mark.slow
def test_every_code_that_can_be_printed_is_explained_and_nothing_else() -> None:
    found = printed_codes()
    assert "E-LINE" in found
    assert "E-STOP" in found
    missing = {code: where for code, where in found.items() if code not in CODES}
    assert missing == {}
    assert set(CODES) - set(found) == set()
    for code, one in CODES.items():
        assert all(one), code
        assert all(part.isascii() and len(part) <= 120 and part.endswith(".") for part in one), code


def test_a_code_belongs_to_one_kind_of_error() -> None:
    """Only a class and what refines it share a code."""
    classes = [cls for cls in vars(aiorts.errors).values() if isinstance(cls, type) and issubclass(cls, AiortsError)]
    for one in classes:
        for other in classes:
            if one.code == other.code:
                assert issubclass(one, other) or issubclass(other, one), (one, other)
    assert all(cls.code in CODES for cls in classes)


def test_errors_are_listed_and_explained(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    status, out, err = run(capsys, "help", "errors")
    assert (status, err) == (0, "")
    assert [line.split()[0] for line in out.splitlines() if re.match(r"[EWN]-", line)] == sorted(CODES)
    assert max(map(len, out.splitlines())) <= 80
    for spelled in (("errors", "E-LINE"), ("errors", "e-line"), ("E-LINE",)):
        status, out, _ = run(capsys, "help", *spelled)
        assert status == 0
        assert CODES["E-LINE"].cause in out
        assert CODES["E-LINE"].remedy in out
    status, out, err = run(capsys, "help", "errors", "E-LINEE")
    assert (status, out, "did you mean E-LINE?" in err) == (2, "", True)


@pytest.mark.parametrize(
    "name", ["run", "inspect", "types", "demo", "doctor", "plugins", "help", "completion", "flexifilter"]
)
def test_help_of_a_command_is_its_help(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    status, out, err = run(capsys, "help", name)
    assert (status, err) == (0, "")
    assert out.split() == run(capsys, name, "--help")[1].split()
    assert out.startswith(f"Usage: aiorts {name} ")
    assert max(map(len, out.splitlines())) <= 120


def test_the_first_screen(capsys: pytest.CaptureFixture[str]) -> None:
    status, out, err = run(capsys)
    assert (status, out) == (2, "")
    assert err == run(capsys, "--help")[1]
    assert run(capsys, "help")[1] == err


def test_the_first_screen_has_the_daily_commands_on_sixty_lines_whatever_plugins_there_are(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    offered = "".join(f'part{n} = "x:y"\n' for n in range(200))
    groups = "".join(f'[project.entry-points."aiorts.{kind}"]\n{offered}' for kind in ("components", "commands"))
    (tmp_path / "pyproject.toml").write_text(f'[project]\nname = "many"\n{groups}')
    monkeypatch.setenv("COLUMNS", "100")
    for arguments in (("--help",), ("--plugins", str(tmp_path), "--help")):
        lines = run(capsys, *arguments)[1].splitlines()
        assert 40 < len(lines) <= 60
        assert max(map(len, lines)) <= 100
        named = [line.split()[0] for line in lines if re.match(r"  [a-z]+  +[A-Z]", line)]
        daily = ["run", "check", "ls", "cat", "conf", "connect", "top", "print", "record", "log", "bench"]
        assert [name for name in daily if name not in named] == []
        assert len(set(named)) == len(named) < 25


@pytest.mark.slow(kept_by="test_the_first_screen_has_the_daily_commands_on_sixty_lines_whatever_plugins_there_are")
def test_every_command_has_its_sentence_in_the_list_of_all_and_in_its_own_help(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("AIORTS_PLUGINS", raising=False)
    monkeypatch.setenv("COLUMNS", "100")
    root = aiorts.cli.app.aiorts
    listed = run(capsys, "help", "commands")[1]
    sentences = dict(re.findall(r"^  ([a-z]+) +([A-Z].*\.)$", listed, re.MULTILINE))
    context = click.Context(root, info_name="aiorts")
    names = [name for name in root.list_commands(context) if not name.startswith("flexi")]
    assert sorted(sentences) == sorted(names)
    assert [name for name, line in sentences.items() if line.startswith("Of ")] == []
    waiting, without = [(name, root, context) for name in names], []
    while waiting:
        name, group, parent = waiting.pop()
        command = group.get_command(parent, name)
        assert command is not None
        context = click.Context(command, parent=parent, info_name=name)
        if not re.match(r"[A-Z].*?[.:](\s|$)", (command.help or "").strip(), re.DOTALL):
            without.append(context.command_path)
        if isinstance(command, click.Group):
            waiting += [(below, command, context) for below in command.list_commands(context)]
    assert without == []


def test_the_help_of_run_leads_with_its_options(capsys: pytest.CaptureFixture[str]) -> None:
    said = run(capsys, "run", "--help")[1]
    before = said.partition("\nOptions:")[0]
    assert len(before.splitlines()) <= 8
    assert "aiorts help run-system" in before
    assert run(capsys, "help", "run-system")[0] == 0


def test_a_command_says_that_it_is_not_stable_in_one_line_of_its_help(capsys: pytest.CaptureFixture[str]) -> None:
    said = {
        name: run(capsys, name, "--help")[1] for name in (*PROVISIONAL.commands, *EXPERIMENTAL.commands, "run", "log")
    }
    for name, text in said.items():
        found = re.findall(r"^  (Provisional|Experimental): .*`aiorts help stability`\)\.$", text, re.MULTILINE)
        tier = tier_of_command(name)
        assert found == ([] if tier is None else [tier.name]), name


def test_what_the_tiers_name_exists_and_whatever_reaches_a_running_kernel_is_provisional_at_most() -> None:
    root = aiorts.cli.app.aiorts
    names = set(root.list_commands(click.Context(root)))
    for tier in NOT_STABLE:
        assert sorted(tier.commands - names) == []
        assert sorted(tier.pages - {page.name for page in pages()}) == []
    live = {name for name, (target, _) in root.own.items() if target.startswith("aiorts.cli.commands.live.")}
    assert sorted(live - PROVISIONAL.commands - EXPERIMENTAL.commands) == []
    plugins = {one.name: one.value for one in entry_points(group="aiorts.commands")}
    of_experimental = ("aiorts_zenoh", "aiorts_openrtm", "aiorts_foxglove", "aiorts_studio")
    assert {name for name, value in plugins.items() if value.startswith(of_experimental)} <= EXPERIMENTAL.commands


@pytest.mark.slow
@pytest.mark.parametrize(
    "command", [["-m", "aiorts"], ["-c", "import sys; from aiorts.cli import main; sys.exit(main())"]]
)
def test_version(command: list[str]) -> None:
    done = subprocess.run([sys.executable, *command, "--version"], capture_output=True, text=True, timeout=40)
    assert (done.returncode, done.stdout, done.stderr) == (0, f"aiorts {aiorts.__version__}\n", "")


@pytest.mark.fault("F04")
@pytest.mark.parametrize(
    ("typed", "meant"), [("inspct", "inspect"), ("flexifiler", "flexifilter"), ("docter", "doctor")]
)
def test_a_misspelt_command_is_told_the_nearest(typed: str, meant: str, capsys: pytest.CaptureFixture[str]) -> None:
    status, out, err = run(capsys, typed)
    assert (status, out) == (2, "")
    assert f"did you mean '{meant}'?" in err


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        (("plugins", "--chek"), "--check"),
        (("types", "--grup", "basic"), "--group"),
        (("demo", "--sorce"), "--source"),
        (("flexifilter", "--overflw", "wrap"), "--overflow"),
        (("inspect", "FlexiFilter", "--overflw", "wrap"), "--overflow"),
    ],
)
def test_a_misspelt_option_is_told_the_nearest(
    typed: tuple[str, ...], meant: str, capsys: pytest.CaptureFixture[str]
) -> None:
    status, out, err = run(capsys, *typed)
    assert (status, out, len(err.splitlines())) == (2, "", 1)
    assert meant in err


# -- extras ------------------------------------------------------------------------------------------------------------


def test_whatever_is_optional_is_in_an_extra_and_says_so() -> None:
    """Each `MissingExtra(what, package, extra)` of the source names a package that this extra has."""
    with open(ROOT / "pyproject.toml", "rb") as file:
        extras = tomllib.load(file)["project"]["optional-dependencies"]
    named = {extra: {re.split(r"[^\w.-]", one)[0] for one in wanted} for extra, wanted in extras.items()}
    text = "".join(path.read_text(encoding="utf-8") for path in sources("aiorts", "plugins"))
    calls = re.findall(r"MissingExtra\([^()]+?, ([^,()]+), [\"']([a-z]*)[\"']", text)
    assert len(calls) >= 3
    for package, extra in calls:
        assert extra in named
        if package.startswith(('"', "'")):
            assert package.strip("\"'") in named[extra]
    from aiorts_bench.push.peers import PACKAGES

    assert set(PACKAGES.values()) - {"dora-rs"} <= named["bench"]
    assert named["all"] == {"aiorts"}
    assert set(re.findall(r"[a-z]+", extras["all"][0].partition("[")[2])) == set(extras) - {
        "all",
        "test",
        "dev",
        "docs",
    }


def test_a_missing_extra_says_which_command_installs_it() -> None:
    error = MissingExtra("chart.png", "matplotlib", "plot", "name FILE.html")
    assert isinstance(error, ImportError)
    assert str(error) == (
        'chart.png needs matplotlib, which is not installed; pip install "aiorts[plot]", or name FILE.html'
    )


@pytest.mark.slow
def test_the_help_comes_at_once() -> None:
    """Nothing heavy is imported for the first screen: a generous bound, and what must not be there."""
    code = "import sys; from aiorts.cli.app import run_command; run_command(['--help']); print(*sys.modules)"
    began = time.monotonic()
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=40)
    assert time.monotonic() - began < 10
    loaded = set(done.stdout.splitlines()[-1].split())
    assert not loaded & {
        "numpy",
        "uvloop",
        "asyncio",
        "aiorts.kernel.kernel",
        "aiorts_flexi",
        "aiorts.types",
        "msgpack",
    }


@pytest.mark.parametrize("option", ["--for", "--record"])
def test_an_option_without_its_value_names_the_help_of_its_command(option: str) -> None:
    done = here("run", "system.toml", option)
    said = f"aiorts: E-USAGE: aiorts run: Option '{option}' requires an argument; see aiorts run --help\n"
    assert (done.returncode, done.stderr) == (2, said)
