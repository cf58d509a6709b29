"""An option that is declared in one place is one everywhere: tried with a copy of aiorts that has one more of each."""

from __future__ import annotations

import json
import os
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
LEVER_ROW = '        "lever": _kept("lever", lambda kernel, _: vars(kernel).setdefault("levers", {})),\n'
ADDED = {
    "model/profile.py": ("    extra: Mapping[str, str] = field(", KNOB),
    "model/wanted/entries.py": ('    isolation: Literal["", "process"] = option(', LEVER),
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
Run = Callable[..., subprocess.CompletedProcess[str]]

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
    return there


@pytest.fixture(scope="module")
def run(folder: Path) -> Run:
    env = {
        **os.environ,
        "PYTHONPATH": str(folder),
        "XDG_RUNTIME_DIR": str(folder / "run"),
        "NO_COLOR": "1",
        "COLUMNS": "200",
    }

    def of(*words: str, code: str = "") -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-c", code] if code else [sys.executable, "-m", "aiorts", *words]
        return subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True, timeout=60, check=False)

    return of


@pytest.fixture(scope="module")
def running(folder: Path, run: Run) -> Iterator[None]:
    env = {**os.environ, "PYTHONPATH": str(folder), "XDG_RUNTIME_DIR": str(folder / "run")}
    command = [sys.executable, "-m", "aiorts", "run", "system.toml", "--name", "declared"]
    process = subprocess.Popen(command, cwd=folder, env=env, stdin=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        over = time.monotonic() + 30.0
        while run("ls", "declared").returncode != 0:
            assert time.monotonic() < over
        yield
    finally:
        process.terminate()
        process.wait(20)


def written(folder: Path, name: str, old: str, new: str) -> str:
    assert old in SYSTEM
    (folder / name).write_text(SYSTEM.replace(old, new))
    return name


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("knob = 4", "knob = 11", "knob = 11: expected a whole number from 0 to 10"),
        ("knob = 4", "knop = 4", "did you mean 'knob'?"),
        ("lever = 3", "lever = 6", "expected a whole number from 0 to 5"),
        ("lever = 3", "levr = 3", "did you mean 'lever'?"),
    ],
)
def test_check_refuses_what_is_out_of_range_or_misspelt(run: Run, folder: Path, old: str, new: str, said: str) -> None:
    assert run("check", "system.toml").returncode == 0
    found = run("check", written(folder, "wrong.toml", old, new))
    assert found.returncode != 0
    assert said in found.stdout + found.stderr


def test_the_schema_accepts_and_refuses_the_same(run: Run) -> None:
    schema = json.loads(run("schema").stdout)
    jsonschema.validate(tomllib.loads(SYSTEM), schema)
    for old, new in (("knob = 4", "knob = 11"), ("knob = 4", 'knob = "much"'), ("lever = 3", "lever = 6")):
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate(tomllib.loads(SYSTEM.replace(old, new)), schema)


def test_a_program_connects_with_it(run: Run) -> None:
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
asyncio.run(main())
"""
    found = run(code=code)
    assert found.returncode == 0, found.stderr
    lines = found.stdout.splitlines()
    assert lines[0].endswith("knob = 11: expected a whole number from 0 to 10")
    assert "did you mean 'knob'?" in lines[1]
    assert lines[2:] == ["knob 7 7", "offered 7"]


@pytest.mark.usefixtures("running")
def test_commands_show_and_change_it_while_it_runs(run: Run, folder: Path) -> None:
    assert "knob 4" in run("cat", "declared/a.out-b.inp").stdout
    assert "knob 4" in run("connect", "declared").stdout
    assert "--knob X" in run("connect", "--help").stdout
    wanted = written(folder, "wanted.toml", "knob = 4", "knob = 5")
    planned = run("plan", "--live", "declared", wanted)
    assert "renew a.out -> b.inp: knob 4 -> 5" in planned.stdout, planned
    assert run("apply", f"declared={wanted}").returncode == 0
    assert "knob 5" in run("connect", "declared").stdout
    (folder / wanted).write_text((folder / wanted).read_text().replace("lever = 3", "lever = 2"))
    applied = run("apply", f"declared={wanted}")
    assert "supervise b: lever 3 -> 2" in applied.stdout, applied
    assert run("save", "declared", "-o", "saved.toml").returncode == 0
    saved = (folder / "saved.toml").read_text()
    assert "knob = 5" in saved
    assert "lever = 2" in saved
    assert run("plan", "--live", "declared", wanted).returncode == 0  # no difference
    assert run("disconnect", "declared/a.out-b.inp").returncode == 0
    made = run("connect", "declared/a.out", "declared/b.inp", "--knob", "9")
    assert "knob 9" in made.stdout, made
    refused = run("connect", "declared/a.out", "declared/b.inp", "knob=12", "allow_duplicate=yes")
    assert "knob = '12': expected a whole number from 0 to 10" in refused.stderr


def test_the_typed_keywords_and_the_reference_have_it(run: Run) -> None:
    code = f"""
import sys
sys.path.insert(0, {str(ROOT / "tests")!r})
import connect_options
text = connect_options.text()
assert "    knob: int\\n" in text and "How far the knob is turned." in text
from reference import PAGES
page = PAGES["system-file"]()
assert "knob" in page and "lever" in page and "How far the lever is pulled." in page
"""
    found = run(code=code)
    assert found.returncode == 0, found.stderr
