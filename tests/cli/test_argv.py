"""Whatever is typed, there is one line and an exit status: never a traceback, never text in place of JSON."""

from __future__ import annotations

import contextlib
import io
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from aiorts.cli.app import run_command
from aiorts.cli.console.report import LONGEST
from campaign import cases

NUMBERS = ("-1", "0", "1e999", "nan", "-inf", "9" * 400, "1_0", "0x10", "1.5", "--5", "٣", "")
WORDS = (
    *("--", "-", "", " ", "\0", "a\nb", "\x1b[31m", "\udcff", "日本", "-i", "-o", "-m", "-p", "-c", "-v", "-z", "-h"),
    *(
        "--help",
        "--json",
        "--jsn",
        "--group",
        "basic",
        "--type-mod",
        "--plugins",
        "--limit",
        "--source",
        "--save",
        "--set",
    ),
    *("--for", "--set", "--count", "--loop", "--speed", "--duration", "--round", "--clamp", "--nan", "--overflow"),
    *(
        "--reset",
        "--inputport",
        "--inputport=",
        "--map=0>0",
        "-mx",
        "-iTimedLong",
        "--no-such-option",
        "--version",
        "-V",
    ),
    *("TimedLong", "TimedLong:3", "TimedDoubleSeq:2", "TimedDoubleSeq:0", "TimedFoo", ":", "a:b:c", "TimedPose2D"),
    *("0>0", "0>1000>0", "garbage", "0:1>0", "0>0,0>0", "0>1e3>0", "1,0", "wrap", "FlexiFilter", "flexifilter", "Foo"),
    *("no/such.toml", ".", "..", "/dev/null", "x.py:X", "os:path", "errors", "E-LINE", "bash", "E-", "run", "inspect"),
    *NUMBERS,
)
RUNS_NOTHING = {
    "": (),
    "inspect": (),
    "types": (),
    "help": (),
    "completion": (),
    "run": (),
    "demo": ("--source",),
    "plugins": (),
    "doctor": ("--no-such-option",),
    "flexifilter": ("--check",),
    "flexiadd": ("--no-such-option",),
    "flexiconst": ("--no-such-option",),
    "flexidump": ("--no-such-option",),
    "flexidupe": ("--no-such-option",),
    "flexiselect": ("--no-such-option",),
    "bench": ("--no-such-option",),
    "no-such-command": (),
}
"""Commands, and what each is given besides so that it measures, waits for and runs nothing."""
ARGUMENTS = st.tuples(
    st.sampled_from(sorted(RUNS_NOTHING)), st.lists(st.sampled_from(WORDS) | st.text(max_size=8), max_size=7)
)


def said(arguments: list[str]) -> tuple[int, str, str]:
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = run_command(arguments)
    return status, out.getvalue(), err.getvalue()


def completed(command: str, words: list[str]) -> list[str]:
    if command == "run":  # nothing that is there may be run
        words = [word for word in words if word not in ("", "--for") and not os.path.isfile(word.replace("\0", ""))]
    return [*([command] if command else []), *RUNS_NOTHING[command], *words]


def check(arguments: list[str], status: int, out: str, err: str) -> None:
    assert status in (0, 1, 2, 6), arguments
    assert "Traceback" not in err
    first, *rest = err.splitlines() or [""]
    if status in (2, 6) and arguments:
        assert first.startswith("aiorts: E-"), (arguments, err)
        assert len(first) <= LONGEST
        assert len(rest) in (0, 2), (arguments, err)
        assert all(line.startswith("  ") for line in rest)
    if out and "--json" in arguments and "--help" not in arguments:
        with contextlib.suppress(AssertionError):
            json.loads(out)
    assert all(c.isprintable() or c == "\n" for c in err)


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("COLUMNS", raising=False)


@pytest.mark.slow(kept_by="test_a_wrong_command_line_is_one_line_and_status_2")
@pytest.mark.fault("F17")
@settings(max_examples=cases(10_000), suppress_health_check=[HealthCheck.function_scoped_fixture])
@example(("plugins", ["--limit", "nan"]))
@example(("plugins", ["--limit", "-1"]))
@example(("plugins", ["--limit", "9" * 400]))
@example(("plugins", ["--limit", "1", "--limit", "2"]))
@example(("inspect", ["a\0b"]))
@example(("inspect", [""]))
@example(("types", ["--", "--json"]))
@example(("flexifilter", ["-i", "TimedLong", "-o", "TimedLong", "-m", "\x1b[31m"]))
@example(("run", ["\udcff"]))
@given(ARGUMENTS)
def test_no_argument_list_gives_a_traceback(given_: tuple[str, list[str]]) -> None:
    arguments = completed(*given_)
    check(arguments, *said(arguments))


@pytest.mark.fault("F17")
@pytest.mark.parametrize(
    "arguments",
    [
        ["plugins", "--limit", "nan"],
        ["plugins", "--limit", "-1"],
        ["plugins", "--limit", "many"],
        ["plugins", "--limit", "1", "--limit", "2"],
        ["flexiconst", "-p", "TimedLong", "-c", "1", "--count", "-5"],
        ["flexiconst", "-p", "TimedLong", "-c", "1", "--count", "many"],
        ["flexiconst", "-p", "TimedLong", "-c", "1", "-r", "nan"],
        ["flexiconst", "-p", "TimedLong", "-c", "1", "-r", "1e999"],
        ["flexiconst", "-p", "TimedLong", "-c", "1", "-r", "0"],
        ["flexiconst", "-p", "TimedLong", "-c", "1", "-s", "-1"],
        ["flexidump", "-p", "TimedLong", "--rate-limit", "-1"],
        ["flexidump", "-p", "TimedLong", "--rate-limit", "nan"],
        ["flexidump", "-p", "TimedLong", "--format", "text", "--format", "json"],
        ["flexidump", "--no-such-option"],
        ["flexidump", "--", "-p", "TimedLong"],
        ["types", "--group", "basic", "--group", "user"],
        ["types", "a", "b"],
        ["demo", "--source", "--save", "x"],
        ["inspect"],
        ["help", "inspect", "more"],
        ["--no-such-option"],
        ["--", ""],
    ],
)
def test_a_wrong_command_line_is_one_line_and_status_2(arguments: list[str]) -> None:
    status, out, err = said(arguments)
    assert (status, out, len(err.splitlines())) == (2, "", 1)
    assert err.startswith("aiorts: E-")


@pytest.mark.slow(kept_by="cli/test_check.py::test_json_is_one_object_for_each_file")
@pytest.mark.fault("F18")
@settings(max_examples=cases(1_000), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.sampled_from(["inspect", "types", "plugins"]),
    st.lists(st.sampled_from([word for word in WORDS if word not in ("--help", "-h", "--", "\0")]), max_size=4),
)
def test_what_is_on_standard_output_is_json_or_nothing(command: str, words: list[str]) -> None:
    """`--json` stands first, so that no option takes it for its value."""
    arguments = [command, "--json", *words]
    status, out, err = said(arguments)
    check(arguments, status, out, err)
    if "--version" not in words:
        assert isinstance(json.loads(out), dict | list), (arguments, out)


IN_ANY = (
    ["--help"],
    ["types", "Pose"],
    ["inspect", "TimedPose2D"],
    ["inspect", "arm.py:日"],
    ["inspect", "FlexiFilter"],
    ["plugins"],
    ["help", "errors"],
)
ONE_BY_ONE = """
import os, sys
from aiorts.cli.app import run_command
for arguments in {}:
    assert run_command(arguments) == 0, arguments
    sys.stdout.flush()
    os.write(1, b"\\0")
"""


@pytest.mark.slow(kept_by="test_a_wrong_command_line_is_one_line_and_status_2")
@pytest.mark.fault("F14")
def test_commands_work_in_any_surroundings(tmp_path: Path) -> None:
    """All in one process, whose surroundings they are."""
    (tmp_path / "arm.py").write_text(
        "from aiorts import Component\nclass 日(Component):\n    '''Größe \\x1b[31m.'''\n", encoding="utf-8"
    )
    hostile = {"LANG": "C", "LC_ALL": "C", "PYTHONIOENCODING": "ascii", "TERM": "dumb", "COLUMNS": "1", "NO_COLOR": "1"}
    environment = {name: value for name, value in os.environ.items() if name != "HOME"}
    done = subprocess.run(
        [sys.executable, "-c", ONE_BY_ONE.format(ascii(IN_ANY))],
        env={**environment, **hostile},
        cwd=tmp_path,
        capture_output=True,
        timeout=40,
    )
    assert (done.returncode, done.stderr) == (0, b"")
    *shown, rest = done.stdout.split(b"\0")
    assert (len(shown), rest) == (len(IN_ANY), b"")
    for arguments, text in zip(IN_ANY, shown, strict=True):
        assert text.isascii()
        assert b"\x1b" not in text
        assert len(text) > 100 or "arm.py:日" in arguments


@pytest.mark.slow(kept_by="test_a_wrong_command_line_is_one_line_and_status_2")
@pytest.mark.fault("F14")
def test_an_argument_that_is_no_text_is_shown_by_number() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "aiorts", "inspect", b"Timed\xff\x1b[31m"], capture_output=True, timeout=40
    )
    assert (done.returncode, done.stdout) == (6, b"")
    assert rb"\udcff" in done.stderr
    assert b"\x1b" not in done.stderr


@pytest.mark.slow
@pytest.mark.fault("F12")
@pytest.mark.parametrize("command", ["types", "plugins"])
def test_a_full_disk_is_one_line(command: str) -> None:
    done = subprocess.run(
        ["bash", "-c", f"{sys.executable} -m aiorts {command} >/dev/full"], capture_output=True, text=True, timeout=40
    )
    assert done.returncode == 1
    assert done.stderr.startswith("aiorts: E-OUTPUT: ")
    assert len(done.stderr.splitlines()) == 1


def test_a_standard_output_that_is_no_file_is_printed_to() -> None:
    program = (
        "import contextlib, io, sys\n"
        "from aiorts.cli import main\n"
        "sys.argv, out = ['aiorts', '--version'], io.StringIO()\n"
        "with contextlib.redirect_stdout(out):\n"
        "    status = main()\n"
        "print(status, out.getvalue())\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False)
    assert done.stdout.startswith("0 aiorts "), done.stderr
