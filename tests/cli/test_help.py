"""Every error code is explained, every command is found, and `--version` says what it should."""

from __future__ import annotations

import re
import subprocess
import sys
import time
import tomllib

import pytest
from test_layers import ROOT, sources

import aiorts
import aiorts.errors
from aiorts.cli.app import run_command
from aiorts.cli.console.codes import CODES
from aiorts.errors import AiortsError, MissingExtra
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
    for word in ("Begin:", "demo", "Systems:", "run", "inspect", "doctor", "flexifilter", "Components, as filters:"):
        assert word in err
    assert run(capsys, "help")[1] == err


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
