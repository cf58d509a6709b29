"""`aiorts check` as a user meets it: three forms of output, exit status, and never a traceback."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from aiorts.cli.app import run_command
from aiorts.cli.console.report import LONGEST
from system_parts import CHAIN, PARTS

ROOT = Path(__file__).parents[2]
Out = pytest.CaptureFixture[str]


@pytest.fixture
def write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., str]:
    """Write a system file beside its components and go there; the name of the file."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "parts.py").write_text(PARTS)

    def write(text: str, name: str = "system.toml") -> str:
        (tmp_path / name).write_text(text)
        return name

    return write


LOOSE = CHAIN + '[components.lone]\ntype = "parts.py:Middle"\n'
WRONG = LOOSE.replace("length = 4", "lenght = 4")


def test_a_finding_is_a_line_and_two_that_quote_the_file_and_mark_the_place(
    write: Callable[..., str], capsys: Out
) -> None:
    assert run_command(["check", write(WRONG)]) == 2
    printed = capsys.readouterr()
    assert printed.err == ""
    assert printed.out.splitlines() == [
        "aiorts: E-CONNECT: system.toml:12:1: connections[1]: unknown option 'lenght'; did you mean 'length'?",
        "  lenght = 4",
        "  ^^^^^^",
        "aiorts: W-UNUSED: system.toml:23:13: components.lone: lone is in no context and never runs; "
        "name it among the members of one, or take it away",
        "  [components.lone]",
        "              ^^^^",
        "aiorts: N-OPEN: system.toml:23:13: components.lone: "
        "2 ports have no connection: input (in TimedLong), output (out TimedLong)",
        "  [components.lone]",
        "              ^^^^",
        "system.toml: 1 error, 1 warning, 1 note",
    ]


@pytest.mark.parametrize(
    ("text", "arguments", "status"),
    [
        (CHAIN, [], 0),
        (CHAIN, ["--strict"], 0),
        (LOOSE, [], 0),
        (LOOSE, ["--strict"], 1),
        (WRONG, ["--strict"], 2),
        (CHAIN, ["--set", "source.rate_limit=70"], 2),
        (CHAIN, ["--set", "source.rate_limit=7"], 0),
    ],
)
def test_the_exit_status_tells(
    write: Callable[..., str], capsys: Out, text: str, arguments: list[str], status: int
) -> None:
    assert run_command(["check", write(text), *arguments]) == status
    assert "system.toml: " in capsys.readouterr().out


def test_of_several_files_each_is_told_of(write: Callable[..., str], capsys: Out) -> None:
    assert run_command(["check", "-q", write(CHAIN, "a.toml"), write(WRONG, "b.toml"), "missing.toml"]) == 2
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "a.toml: no findings, it can run"
    assert "b.toml: 1 error, 1 warning" in lines
    assert lines[-2].startswith("aiorts: E-SYSTEM: missing.toml: cannot be read: No such file or directory")


@pytest.mark.fault("F18")
def test_json_is_one_object_for_each_file(write: Callable[..., str], capsys: Out) -> None:
    assert run_command(["check", "--format", "json", write(WRONG, "b.toml"), write("[", "c.toml"), "gone.toml"]) == 2
    first, second, third = (json.loads(line) for line in capsys.readouterr().out.splitlines())
    assert (first["errors"], first["warnings"], first["notes"]) == (1, 1, 1)
    assert first["findings"][0] == {
        "severity": "error",
        "code": "E-CONNECT",
        "file": "b.toml",
        "line": 12,
        "column": 1,
        "width": 6,
        "where": "connections[1]",
        "cause": "unknown option 'lenght'",
        "remedy": "did you mean 'length'?",
        "suggestion": "length",
        "copies": 0,
    }
    assert (second["findings"][0]["line"], third["findings"][0]["line"]) == (1, 0)


def test_a_suggestion_is_text_that_can_stand_in_the_place_or_be_added(write: Callable[..., str], capsys: Out) -> None:
    text = CHAIN.replace("parts.py:Sink", "parts.py:Snik").replace("length = 4", "lenght = 4")
    run_command(["check", "--format", "json", write(text)])
    found = json.loads(capsys.readouterr().out)["findings"]
    mended = text.split("\n")
    for one in found:
        if one["severity"] == "error":
            line = mended[one["line"] - 1]
            end = one["column"] - 1 + one["width"]
            mended[one["line"] - 1] = f"{line[: one['column'] - 1]}{one['suggestion']}{line[end:]}"
    assert "\n".join(mended) == CHAIN
    run_command(["check", "--format", "json", write('schema = 1\n[components.a]\ntype = "parts.py:Sink"\n')])
    first, *_ = json.loads(capsys.readouterr().out)["findings"]
    assert first["suggestion"] == '[contexts.main]\nkind = "periodic"\nrate = 10.0\nmembers = ["a"]'
    run_command(["check", "--format", "json", write("[components]\n")])
    assert json.loads(capsys.readouterr().out)["findings"][0]["suggestion"] == "schema = 1"


def test_github_annotations_are_escaped(write: Callable[..., str], capsys: Out) -> None:
    text = WRONG.replace("lenght", '"100%,x"').replace(
        'type = "parts.py:Sink"', 'type = "FlexiDump"\noptions = "-p TimedString"'
    )
    run_command(["check", "--format", "github", write(text.replace("sink.input", "sink.input0"), "a,b.toml")])
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith(
        "::error file=a%2Cb.toml,line=13,col=1,endColumn=9,title=E-CONNECT::connections[1]: unknown"
    )
    assert "'100%25,x'" in lines[0]
    kinds = [line.partition(" ")[0] for line in lines]
    assert kinds == ["::error", "::error", "::warning", "::notice"]
    assert '%0A[components.middle_to_sink_input0]%0Atype = "FlexiFilter"' in lines[1]


@pytest.mark.fault("F18")
def test_what_a_component_file_prints_is_no_part_of_the_findings(
    write: Callable[..., str], tmp_path: Path, capsys: Out
) -> None:
    (tmp_path / "loud.py").write_text(
        "print('hello')\nfrom aiorts import Component\nclass Loud(Component):\n    pass\n"
    )
    name = write(
        'schema = 1\n[components.a]\ntype = "loud.py:Loud"\n[components.b]\ntype = "loud.py:Loud"\n'
        '[contexts.loop]\nkind = "event"\nmembers = ["a"]\n'
    )
    assert run_command(["check", "--format", "json", name]) == 0
    printed = capsys.readouterr()
    assert json.loads(printed.out)["warnings"] == 1
    assert printed.err == "hello\n"


@pytest.mark.slow
def test_a_folder_of_plugins_can_be_named(write: Callable[..., str], tmp_path: Path, capsys: Out) -> None:
    other = tmp_path / "other"
    other.mkdir()
    (other / "far.py").write_text("from aiorts import Component\nclass FarAway(Component):\n    pass\n")
    name = write('schema = 1\n[components.a]\ntype = "FarAway"\n[contexts.loop]\nkind = "event"\nmembers = ["a"]\n')
    assert run_command(["check", name]) == 2
    assert run_command(["check", name, "--plugins", str(other)]) == 0
    capsys.readouterr()
    assert run_command(["graph", name, "--plugins", str(other)]) == 0
    assert "FarAway" in capsys.readouterr().out
    assert run_command(["schema", "--plugins", str(other)]) == 0
    assert '"FarAway"' in capsys.readouterr().out


@pytest.mark.parametrize("name", ["hello", "roomba"])
def test_the_examples_are_clean(capsys: Out, name: str) -> None:
    assert run_command(["check", "-q", "--strict", str(ROOT / "examples" / name / "system.toml")]) == 0
    assert "no findings, it can run" in capsys.readouterr().out


@pytest.mark.parametrize(
    "text", ['x = "\x1b[31m\t\x07"', 'x = "' + "é" * 5000 + '"', "[contexts.\x00]", "schema = 1\n\t\ty = 2"]
)
def test_no_text_of_a_file_commands_the_terminal(write: Callable[..., str], capsys: Out, text: str) -> None:
    assert run_command(["check", write(text)]) == 2
    printed = capsys.readouterr().out
    assert "\x1b" not in printed
    assert "\x07" not in printed
    assert max(map(len, printed.splitlines())) <= LONGEST


def processed(*arguments: object, **options: object) -> tuple[subprocess.CompletedProcess[str], float]:
    begun = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-m", "aiorts", *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=30,
        check=False,
        **options,  # type: ignore[call-overload]
    )
    return done, time.monotonic() - begun


@pytest.mark.fault("F01")
@pytest.mark.skipif(sys.platform == "win32", reason="no pipes and devices in the file system")
@pytest.mark.parametrize("command", ["check", "run", "graph"])
def test_a_file_that_is_none_ends_every_command_with_one_line(
    write: Callable[..., str], tmp_path: Path, capsys: Out, command: str
) -> None:
    os.mkfifo(tmp_path / "fifo")
    os.truncate(tmp_path / write("", "large.toml"), 100 * 1024 * 1024)
    write("schema = 1\nx = " + "[" * 100_000, "deep.toml")
    write("schema = 1\n" + "a." * 20_000 + "b = 1", "long.toml")
    (tmp_path / "latin.toml").write_bytes(b"schema = 1\n# \xe9\n")
    for name in ("fifo", "large.toml", "deep.toml", "long.toml", "latin.toml", "/dev/zero", ".", "gone.toml"):
        begun = time.monotonic()
        assert run_command([command, name]) == 2
        assert time.monotonic() - begun < 2.0
        printed = capsys.readouterr()
        lines = [line for line in (printed.out + printed.err).splitlines() if line.startswith("aiorts: E-")]
        assert len(lines) == 1, (name, printed)
        assert len(lines[0]) <= LONGEST


@pytest.mark.slow(kept_by="system/test_check.py::test_an_unknown_type_names_the_nearest_and_what_is_installed")
@pytest.mark.fault("F04")
@pytest.mark.parametrize("command", ["check", "run"])
def test_an_unknown_type_is_refused_at_once_with_the_nearest_and_the_installed(
    write: Callable[..., str], tmp_path: Path, command: str
) -> None:
    (tmp_path / "empty").mkdir()
    text = 'schema = 1\nplugins.path = ["empty"]\n[components.a]\ntype = "{}"\n'
    for kind, said in (
        ("FlexFilter", "did you mean FlexiFilter"),
        ("Zzz", "there are FlexiAdd, FlexiConst, FlexiDump"),
    ):
        done, took = processed(command, write(text.format(kind)), cwd=tmp_path)
        assert done.returncode == 2
        assert said in done.stdout + done.stderr
        assert "Traceback" not in done.stderr
        assert took < 10  # a second where nobody else works


@pytest.mark.slow(kept_by="test_a_file_that_is_none_ends_every_command_with_one_line")
def test_strange_surroundings_are_no_reason_to_fail(write: Callable[..., str], tmp_path: Path) -> None:
    name = write(WRONG.replace("lenght", '"länge"'))
    for extra in (
        {"LANG": "C", "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONIOENCODING": "ascii"},
        {"COLUMNS": "1", "TERM": "dumb"},
    ):
        done, _ = processed("check", name, cwd=tmp_path, env={**os.environ, **extra})
        assert done.returncode == 2
        assert "Traceback" not in done.stderr
        assert "E-CONNECT" in done.stdout


@pytest.mark.slow(kept_by="cli/test_demo.py::test_a_reader_that_has_seen_enough_ends_it_quietly")
@pytest.mark.fault("F11")
def test_a_reader_that_has_gone_is_no_error(write: Callable[..., str], tmp_path: Path) -> None:
    name = write("schema = 1\n" + "".join(f"k{n} = 1\n" for n in range(3000)))
    done = subprocess.run(
        f"{sys.executable} -m aiorts check {name} | head -1",
        shell=True,
        capture_output=True,
        text=True,
        timeout=30,
        check=False,
        cwd=tmp_path,
    )
    assert done.stderr == ""
    assert done.stdout.count("\n") == 1
