"""`aiorts run FILE.py:Class`: one component, alone, in a context that fits it; and what is said of mistakes."""

from __future__ import annotations

from pathlib import Path

import pytest

from aiorts.cli.app import run_command
from run_parts import folder_of, here


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return folder_of(tmp_path)


@pytest.mark.slow(kept_by="first")
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["parts.py:Counter"], "wrote 3 in periodic 10.0\n"),
        (["parts.py:Counter", "--rate", "50"], "wrote 3 in periodic 50.0\n"),
        (["parts.py:Counter", "--set", "count=2"], "wrote 2 in periodic 10.0\n"),
        (["parts.py:Counter", "--set", "counter.count=4", "--simulate"], "wrote 4 in periodic 10.0\n"),
        (["parts:Counter", "--speed", "10"], "wrote 3 in periodic 10.0\n"),
        (["Counter", "--plugins", "."], "wrote 3 in periodic 10.0\n"),
        (["parts.py:Sink", "--for", "0.1"], "ready\nstopped in event\n"),
        (["parts.py:Sink", "--duration", "0.1", "--rate", "5"], "ready\nstopped in periodic\n"),
    ],
)
def test_one_component_runs_alone_in_a_context_that_fits_it(folder: Path, arguments: list[str], said: str) -> None:
    done = here(folder, "run", "--quiet", *arguments)
    assert (done.returncode, done.stdout, done.stderr) == (0, said, "")


def test_a_file_elsewhere_is_named_by_its_path(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    done = here(tmp_path_factory.mktemp("elsewhere"), "run", f"{folder}/parts.py:Counter", "--simulate", "-q")
    assert (done.returncode, done.stdout) == (0, "wrote 3 in periodic 10.0\n")


def test_one_that_cannot_be_made_is_named(folder: Path) -> None:
    (folder / "unmade.py").write_text(
        "from aiorts import Component\nclass Unmade(Component):\n"
        "    def on_initialize(self):\n        raise OSError('no')\n"
    )
    done = here(folder, "run", "unmade.py:Unmade")
    assert done.returncode == 1
    assert done.stderr == "aiorts: E-COMPONENT: unmade: OSError: no (unmade.py:4); --debug shows the traceback\n"


@pytest.mark.parametrize(
    ("source", "status", "said"),
    [
        ("import nix_to_be_found\n", 2, "bad.py:Bad cannot be loaded: ModuleNotFoundError"),
        ("x = 1\nraise SystemExit(9)\n", 2, "bad.py:Bad cannot be loaded: SystemExit: 9"),
        ("def (\n", 2, "bad.py:Bad cannot be loaded: SyntaxError"),
    ],
)
@pytest.mark.parametrize("home", ["bad.py", "bad"])
def test_a_module_that_does_not_load_is_named_with_its_line(
    folder: Path, home: str, source: str, status: int, said: str
) -> None:
    (folder / "bad.py").write_text(source)
    done = here(folder, "run", f"{home}:Bad")
    assert done.returncode == status
    assert done.stderr.count("\n") == 1
    assert said.replace("bad.py", home) in done.stderr
    assert f" (bad.py:{1 + source.startswith('x')})" in done.stderr


@pytest.mark.fault("F04")
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["parts.py:Conter"], "did you mean 'Counter'"),
        (["parts.py:Xyz"], "it has Counter, Sink, Blocked"),
        (["part.py:Counter"], "did you mean 'parts.py:"),
        (["prts:Counter"], "did you mean parts?"),
        (["aiorts.tpes:Counter"], "did you mean aiorts.types?"),
        (["parts.nix:Counter"], "'parts' is no package"),
        (["parts.py:time"], "no class derived from Component"),
        (["parts.py:"], "which class? write parts.py:CLASS; it has Counter, Sink"),
        ([":Counter"], "package.module:Class"),
        (["parts.py:Counter:x y"], "package.module:Class"),
        (["flexidump"], "did you mean 'FlexiDump'"),
        (["FlexiDum"], "did you mean 'FlexiDump'"),
        (["system"], "did you mean 'system.toml'"),
        (["sytem.toml"], "did you mean 'system.toml'"),
        (["nix/system.toml"], "No such file"),
        (["nix"], "SYSTEM.toml, FILE.py:Class"),
        ([""], "cannot be read"),
        ([":"], "package.module:Class"),
        (["parts.py:Counter", "--set", "cuont=1"], "did you mean count"),
        (["parts.py:Counter", "--set", "count=x"], "must be an int"),
        (["parts.py:Counter", "--set", "other.count=1"], "the component is called 'counter'"),
        (["parts.py:Counter", "--set", "count"], "PARAM=VALUE"),
        (["parts.py:Counter", "--set", "=1"], "PARAM=VALUE"),
        (["parts.py:Counter", "--rate", "-1"], "--rate"),
        (["parts.py:Counter", "--rate", "nan"], "--rate"),
        (["system.toml", "--rate", "5"], "[contexts.NAME]"),
        (["parts.py:Counter", "--plugins", "nix"], "Invalid value for '--plugins': Directory 'nix' does not exist"),
        (["parts.py:Counter", "--for", "0"], "--for"),
        (["parts.py:Counter", "--log-level", "warnin"], "did you mean 'warning'"),
        (["parts.py:Counter", "--log-level", "loud"], "there are debug, info"),
        (["parts.py:Counter", "--log-level", "conter=debug"], "did you mean 'counter'"),
        (["parts.py:Counter", "--log-level", "info,debug"], "COMPONENT=debug"),
        (["parts.py:Counter", "--log-level", "=debug"], "COMPONENT=LEVEL"),
        (["parts.py:Counter", "--log-level", "a=debug,a=info"], "twice"),
        (["parts.py:Counter", "--log-format", "xml"], "xml"),
        (["parts.py:Counter", "--log-file", "nix/log"], "no folder 'nix'"),
        (["parts.py:Counter", "--log-file", "."], "is a folder"),
        (["parts.py:Counter", "--log-file", "a\0b"], "NUL"),
        (["parts.py:Counter", "--log-file", "parts.py/x"], "Not a directory"),
    ],
)
def test_a_mistake_is_one_line_with_what_was_meant(
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    said: str,
) -> None:
    monkeypatch.chdir(folder)
    monkeypatch.syspath_prepend(folder)
    status = run_command(["run", *arguments])
    printed = capsys.readouterr()
    assert printed.err.count("did you mean") <= 1
    assert status == 2
    assert printed.out == ""
    assert said in printed.err
    assert printed.err.startswith("aiorts: E-")
    assert printed.err.count("\n") == 1
    assert len(printed.err) <= 241


UNMADE = """\
from aiorts import Component

class Unmade(Component):
    def __init__(self, name):
        super().__init__(name)
        raise LookupError("no camera")
"""
SYSTEM = 'schema = 1\n[components.eye]\ntype = "unmade_1.py:Unmade"\n[contexts.c]\nkind = "event"\nmembers = ["eye"]\n'


@pytest.mark.parametrize("target", ["unmade_1.py:Unmade", "eye.toml"])
def test_a_constructor_that_raises_is_told_with_the_way_to_its_traceback(folder: Path, target: str) -> None:
    (folder / "unmade_1.py").write_text(UNMADE)
    (folder / "eye.toml").write_text(SYSTEM)
    done = here(folder, "run", target)
    assert done.returncode == 1
    said = "Unmade cannot be constructed: LookupError: no camera (unmade_1.py:6); --debug shows the traceback"
    assert done.stderr.splitlines()[0].endswith(said)
    done = here(folder, "run", target, "--debug")
    assert "--debug shows" not in done.stderr
    assert 'raise LookupError("no camera")' in done.stderr
