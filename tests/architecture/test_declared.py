"""An option that is declared in one place is one everywhere: tried with a copy of aiorts that has one more of each."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path

import jsonschema
import pytest

from aiorts.model.declared import options_of
from aiorts.model.wanted.entries import ComponentEntry
from aiorts.planning.component_rows import ROWS

ROOT = Path(__file__).parents[2]
KNOB = '    knob: int = option(2, "How far the knob is turned.", low=0, high=10, end="reader")\n'
LEVER = '    lever: int = option(1, "How far the lever is pulled.", low=0, high=5, changes=True)\n'
SLACK = '    slack: int | None = option(None, "How slack it is.", unit="mm", low=1, high=7)\n'
LEVER_ROW = '        "lever": _kept("lever", lambda kernel, _: vars(kernel).setdefault("levers", {})),\n'
ADDED = {
    "model/profile.py": ("    extra: Mapping[str, str] = field(", KNOB),
    "model/wanted/entries.py": ('    isolation: Literal["", "process"] = option(', LEVER),
    "processes/values.py": ("    processes: int | None = option(", SLACK),
    "planning/component_rows.py": ('        "isolation": Row(', LEVER_ROW),
}
PARTS = """
from aiorts import Component, InPort, OutPort
from aiorts.types import TimedLong

class Source(Component):
    out = OutPort(TimedLong)

class Sink(Component):
    inp = InPort(TimedLong)
"""
SYSTEM = """
schema = 1

[components.a]
type = "parts.py:Source"

[components.b]
type = "parts.py:Sink"
lever = 3

[[connections]]
from = "a.out"
to = "b.inp"
knob = 4

[contexts.main]
kind = "periodic"
rate = 10.0
members = ["a", "b"]
"""
WRONG = (
    ("knob = 4", "knob = 11", "knob = 11: expected a whole number from 0 to 10"),
    ("knob = 4", "knop = 4", "unknown option 'knop'; did you mean 'knob'?"),
    ("lever = 3", "lever = 6", "lever: expected a whole number from 0 to 5, got 6"),
    ("lever = 3", "levr = 3", "unknown key 'levr'; did you mean 'lever'?"),
)
"""What is wrong in files, and what is said of it."""
COMMANDS = ("run", "check", "plan --live declared", "apply")
SEVERAL = """
import json, sys
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from aiorts.cli.app import run_command

said = []
for words in json.loads(sys.argv[1]):
    with redirect_stdout(StringIO()) as text, redirect_stderr(text):
        status = run_command(words.split())
    said.append([status, text.getvalue()])
print(json.dumps(said))
"""
"""Commands one after the other in one process, whose start takes longer than they do."""
Run = Callable[..., subprocess.CompletedProcess[str]]
Said = Callable[..., list[tuple[int, str]]]

pytestmark = pytest.mark.slow


def test_each_key_of_a_component_has_a_row() -> None:
    assert list(ROWS) == list(options_of(ComponentEntry))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a copy of aiorts in which a knob and a lever are declared, and a system that has both."""
    there = tmp_path_factory.mktemp("declared")
    shutil.copytree(ROOT / "aiorts", there / "aiorts", ignore=shutil.ignore_patterns("__pycache__"))
    for name, (before, text) in ADDED.items():
        path = there / "aiorts" / name
        old = path.read_text(encoding="utf-8")
        assert old.count(before) == 1, name
        path.write_text(old.replace(before, text + before), encoding="utf-8")
    (there / "run").mkdir(mode=0o700)
    (there / "parts.py").write_text(PARTS)
    (there / "system.toml").write_text(SYSTEM)
    for number, (right, wrong, _) in enumerate(WRONG):
        written(there, f"wrong{number}.toml", right, wrong)
    return there


def environment(folder: Path) -> dict[str, str]:
    """The variables of a process that imports the copy; its bytecode is kept, or each process compiled it anew."""
    own = {"PYTHONPATH": str(folder), "XDG_RUNTIME_DIR": str(folder / "run"), "NO_COLOR": "1", "COLUMNS": "200"}
    return {**{name: one for name, one in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}, **own}


@pytest.fixture(scope="module")
def run(folder: Path) -> Run:
    def of(*words: str) -> subprocess.CompletedProcess[str]:
        command, env = [sys.executable, *words], environment(folder)
        return subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True, timeout=60, check=False)

    return of


@pytest.fixture(scope="module")
def said(run: Run) -> Said:
    """What commands of aiorts end with, and what they print."""

    def of(*commands: str) -> list[tuple[int, str]]:
        found = run("-c", SEVERAL, json.dumps(commands))
        assert found.returncode == 0, found.stderr
        return [(status, text) for status, text in json.loads(found.stdout)]

    return of


@pytest.fixture(scope="module")
def running(folder: Path, said: Said) -> Iterator[None]:
    command = [sys.executable, "-m", "aiorts", "run", "system.toml", "--name", "declared"]
    quiet = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    process = subprocess.Popen(command, cwd=folder, env=environment(folder), **quiet)
    try:
        over = time.monotonic() + 60.0
        while said("ls declared")[0][0] != 0:
            assert time.monotonic() < over
        yield
    finally:
        process.terminate()
        process.wait(20)


def written(folder: Path, name: str, old: str, new: str) -> str:
    assert old in SYSTEM
    (folder / name).write_text(SYSTEM.replace(old, new))
    return name


# -- files -------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def refusals(said: Said, running: None) -> dict[tuple[str, int], tuple[int, str]]:
    """What each command says of each wrong file."""
    asked = [(command, number) for command in COMMANDS for number in range(len(WRONG))]
    names = {"apply": "apply declared="}
    answers = said(*(f"{names.get(command, command + ' ')}wrong{number}.toml" for command, number in asked))
    return dict(zip(asked, answers, strict=True))


@pytest.mark.parametrize("number", range(len(WRONG)), ids=[wrong for _, wrong, _ in WRONG])
@pytest.mark.parametrize("command", COMMANDS)
def test_a_file_with_it_is_refused_with_range_and_suggestion(
    refusals: dict[tuple[str, int], tuple[int, str]], command: str, number: int
) -> None:
    status, text = refusals[command, number]
    assert status == 2
    assert WRONG[number][2] in text


def test_a_file_with_it_is_accepted_also_with_a_variable_that_the_command_line_sets(folder: Path, said: Said) -> None:
    turned = SYSTEM.replace("knob = 4", 'knob = "${turned}"').replace("lever = 3", 'lever = "${turned}"')
    (folder / "turned.toml").write_text(f"{turned}[variables]\nturned = 1\n")
    right, *fine, wrong = said(
        "check system.toml", *(f"check turned.toml --var turned={n}" for n in ("4", "0x4", "11"))
    )
    assert [status for status, _ in (right, *fine)] == [0, 0, 0], fine
    assert wrong[0] == 2
    assert WRONG[0][2] in wrong[1]
    assert "lever: expected a whole number from 0 to 5, got 11" in wrong[1]


def test_the_schema_accepts_and_refuses_the_same(said: Said) -> None:
    validator = jsonschema.Draft202012Validator(json.loads(said("schema")[0][1]))
    assert validator.is_valid(tomllib.loads(SYSTEM))
    for right, wrong, _ in (*WRONG, ("knob = 4", 'knob = "much"', "")):
        assert not validator.is_valid(tomllib.loads(SYSTEM.replace(right, wrong))), wrong
    connection = validator.schema["$defs"]["connection"]["properties"]
    assert connection["knob"]["description"] == "How far the knob is turned."


# -- limits ------------------------------------------------------------------------------------------------------------


def test_a_limit_of_a_process_is_checked_and_described(folder: Path, said: Said) -> None:
    limited = SYSTEM + '[components.c]\ntype = "parts.py:Sink"\nisolation = "process"\nlimits = {slack = 5}\n'
    (folder / "limited.toml").write_text(limited)
    wrong = {
        "slack = 8": "8: expected a whole number from 1 to 7",
        "slak = 5": "did you mean 'slack'?",
    }
    for number, text in enumerate(wrong):
        (folder / f"limited{number}.toml").write_text(limited.replace("slack = 5", text))
    (_, schema), right, *refused = said("schema", "check limited.toml", "check limited0.toml", "check limited1.toml")
    validator = jsonschema.Draft202012Validator(json.loads(schema))
    assert right[0] == 0, right
    assert validator.is_valid(tomllib.loads(limited))
    for (status, answer), (text, what) in zip(refused, wrong.items(), strict=True):
        assert status == 2
        assert what in answer
        assert not validator.is_valid(tomllib.loads(limited.replace("slack = 5", text)))


# -- programs and links ------------------------------------------------------------------------------------------------


def test_a_program_connects_with_it_and_a_link_offers_it(run: Run) -> None:
    code = """
import asyncio
from aiorts import Kernel
from aiorts.errors import WiringError
from aiorts.links.transport import LinkOffer
from aiorts.links.reader_link import reader_options
from aiorts.model.names import Path
from parts import Sink, Source

async def main():
    async with Kernel() as kernel:
        a, b = await kernel.add(Source("a")), await kernel.add(Sink("b"))
        for wrong in ({"knob": 11}, {"knop": 1}):
            try:
                await kernel.connect(a.out, b.inp, **wrong)
            except WiringError as error:
                print(error)
        made = await kernel.connect(a.out, b.inp, knob="0007")
        print("knob", made.profile.knob, reader_options(made.profile)["knob"])
        offer = LinkOffer((1, 1), "l", Path.parse("k/a.out"), Path.parse("m/b.inp"), 1, 1, 1, b"", "x", None, None,
                          made.profile, 256, 1 << 20)
        print("offered", LinkOffer.from_bytes(offer.to_bytes()).profile.knob)
        for wrong in (b"knob\\x0b", b"knop\\x07"):
            try:
                LinkOffer.from_bytes(offer.to_bytes().replace(b"knob\\x07", wrong))
            except WiringError as error:
                print(error)
asyncio.run(main())
"""
    found = run("-c", code)
    assert found.returncode == 0, found.stderr
    connected, misspelt, taken, offered, *not_offered = found.stdout.splitlines()
    assert connected.endswith(WRONG[0][2])
    assert WRONG[1][2] in misspelt
    assert (taken, offered) == ("knob 7 7", "offered 7")
    assert not_offered[0].endswith(WRONG[0][2])
    assert WRONG[1][2] in not_offered[1]


# -- what runs ---------------------------------------------------------------------------------------------------------


def test_commands_show_change_and_save_it_while_it_runs(running: None, said: Said, folder: Path) -> None:
    wanted = written(folder, "wanted.toml", "knob = 4", "knob = 5")
    (folder / wanted).write_text((folder / wanted).read_text().replace("lever = 3", "lever = 2"))
    ends = "declared/a.out declared/b.inp"
    answers = said(
        *("cat declared/a.out-b.inp", "connect declared", f"plan --live declared {wanted}", f"apply declared={wanted}"),
        *(f"plan --live declared {wanted}", "connect declared", "save declared -o saved.toml", "check saved.toml"),
        *("disconnect declared/a.out-b.inp", f"connect {ends} --knob 9", f"connect {ends} knob=11", "connect --help"),
        f"connect {ends} knop=1",
    )
    shown, listed, planned, applied, again, changed, saved, checked, _, made, out, help_text, misspelt = answers
    assert "knob 4" in shown[1]
    assert "knob 4" in listed[1]
    for text in (planned[1], applied[1]):
        assert "renew a.out -> b.inp: knob 4 -> 5" in text
        assert "supervise b: lever 3 -> 2" in text
    assert (planned[0], applied[0], again[0]) == (1, 0, 0)  # 1: there is a difference
    assert "knob 5" in changed[1]
    assert (saved[0], checked[0]) == (0, 0)
    assert {"knob = 5", "lever = 2"} <= {*(folder / "saved.toml").read_text().splitlines()}
    assert "knob 9" in made[1]
    assert (out[0], misspelt[0]) == (2, 2)
    assert "knob = '11': expected a whole number from 0 to 10" in out[1]
    assert WRONG[1][2] in misspelt[1]
    assert "--knob X" in help_text[1]


def test_the_typed_keywords_and_the_reference_have_it(run: Run) -> None:
    code = f"""
import sys
sys.path.insert(0, {str(ROOT / "tests")!r})
import connect_options
from reference import PAGES
print(connect_options.text())
print(PAGES["system-file"]())
"""
    found = run("-c", code)
    assert found.returncode == 0, found.stderr
    assert "    knob: int\n" in found.stdout
    assert found.stdout.count("How far the knob is turned.") == 2
    assert "`slack`: whole number, at least 1, at most 7. How slack it is. Unit: mm." in found.stdout
    for key, high, text in (("knob", 10, "How far the knob is turned."), ("lever", 5, "How far the lever is pulled.")):
        assert re.search(rf"`{key}`.*0.*{high}.*{text}", found.stdout)
