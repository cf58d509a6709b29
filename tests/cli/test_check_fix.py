"""`aiorts check --fix`: what has one answer is mended, everything else of the text stays."""

from __future__ import annotations

import subprocess
import tomllib
from pathlib import Path

import pytest

from run_parts import folder_of, here

MISSPELT = """\
# The line stays.
schema = 1
[components.counter]
type = "parts.py:Conuter"   # of the file beside
[components.sink]
type = "prats.py:Sink"
[[connections]]
from = "counter.ouf"
to = "sink.nubmers" # read at once
[contexts.fast]
kind = "periodic"
rtae = 100.0
members = ["countre"]
[contexts.slow]
kind = "event"
members = [
    "sink",  # the only one
]
"""
MENDED = """\
# The line stays.
schema = 1
[components.counter]
type = "parts.py:Counter"   # of the file beside
[components.sink]
type = "parts.py:Sink"
[[connections]]
from = "counter.out"
to = "sink.numbers" # read at once
[contexts.fast]
kind = "periodic"
rate = 100.0
members = ["counter"]
[contexts.slow]
kind = "event"
members = [
    "sink",  # the only one
]
"""
TOGETHER = """\
schema = 1
[components.counter]
type = "parts.py:Counter"
isolation = "process"
[components.sink]
type = "parts.py:Sink"
[components.talker]
type = "parts.py:Talker"
isolation = "process"
[contexts.all]
kind = "periodic"
rate = 100.0   # as the arm wants it
members = [
    "counter",  # counts
    "sink",
    "talker"
]

# Nothing else.
"""


def test_an_array_of_arrays_is_no_heading_and_toml_stays_toml(tmp_path: Path) -> None:
    """A line that begins with a bracket ended the table: the new one came inside the array, as the one error left."""
    file = folder_of(tmp_path) / "nested.toml"
    file.write_text(TOGETHER.replace("rate = 100.0 ", "bogus = [\n  [1, 2],\n  [3, 4],\n]\nrate = 100.0 "))
    done = here(tmp_path, "check", "--fix", "--write", "nested.toml")
    assert done.returncode == 2, done.stderr  # `bogus` has no answer
    assert tomllib.loads(file.read_text())["contexts"]["all"]["bogus"] == [[1, 2], [3, 4]]
    assert "not valid TOML" not in done.stdout + done.stderr


def test_misspelt_names_are_mended_and_comments_stay(tmp_path: Path) -> None:
    file = folder_of(tmp_path) / "bad.toml"
    file.write_text(MISSPELT)
    shown = here(tmp_path, "check", "--fix", "bad.toml")
    assert (shown.returncode, shown.stderr) == (1, "")
    assert file.read_text() == MISSPELT
    (tmp_path / "copy").mkdir()
    (tmp_path / "copy" / "bad.toml").write_text(MISSPELT)
    subprocess.run(["patch", "-s", "-d", tmp_path / "copy"], input=shown.stdout, text=True, check=True, timeout=30)
    assert (tmp_path / "copy" / "bad.toml").read_text() == MENDED
    written = here(tmp_path, "check", "--fix", "--write", "bad.toml")
    assert (written.returncode, written.stdout, file.read_text()) == (0, shown.stdout, MENDED)
    again = here(tmp_path, "check", "--fix", "bad.toml")
    assert (again.returncode, again.stdout) == (0, "")


def test_a_member_with_a_process_of_its_own_gets_a_context_of_its_own(tmp_path: Path) -> None:
    file = folder_of(tmp_path) / "together.toml"
    file.write_text(TOGETHER)
    assert here(tmp_path, "check", "together.toml").returncode == 2
    done = here(tmp_path, "check", "--fix", "--write", "-q", "together.toml")
    assert (done.returncode, done.stderr) == (0, "")
    assert here(tmp_path, "check", "together.toml").returncode == 0
    contexts = tomllib.loads(file.read_text())["contexts"]
    own = {"kind": "periodic", "rate": 100.0}
    assert contexts == {
        "all": {**own, "members": ["sink"]},
        "all_counter": {**own, "members": ["counter"]},
        "all_talker": {**own, "members": ["talker"]},
    }
    for comment in ("# as the arm wants it", "# counts", "# Nothing else."):
        assert comment in file.read_text()


def test_what_has_no_answer_is_left_and_said(tmp_path: Path) -> None:
    file = folder_of(tmp_path) / "bad.toml"
    text = MISSPELT.replace('"sink.nubmers"', '"nobody.xyz"')
    file.write_text(text)
    done = here(tmp_path, "check", "--fix", "--write", "bad.toml")
    assert done.returncode == 2
    assert "nobody" in done.stderr
    assert file.read_text() == MENDED.replace('"sink.numbers"', '"nobody.xyz"').replace("counter.out", "counter.ouf")


def test_warnings_and_notes_that_are_left_are_said_and_strict_counts_them(tmp_path: Path) -> None:
    file = folder_of(tmp_path) / "unused.toml"
    file.write_text(MENDED.replace('    "sink",  # the only one\n', ""))
    plain = here(tmp_path, "check", "--strict", "unused.toml")
    assert (plain.returncode, "W-UNUSED" in plain.stdout) == (1, True)
    for words, status in (((), 0), (("--strict",), 1), (("--strict", "-q"), 1)):
        done = here(tmp_path, "check", "--fix", *words, "unused.toml")
        assert (done.returncode, done.stdout, "W-UNUSED" in done.stderr) == (status, "", True), done.stderr


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("--write", "system.toml"), "--write is for --fix"),
        (("--fix", "--json", "system.toml"), "--fix prints a difference, and goes not with --format json"),
        (("--fix", "none.toml"), "none.toml: cannot be read"),
    ],
)
def test_what_cannot_be_mended_is_refused(tmp_path: Path, words: tuple[str, ...], why: str) -> None:
    done = here(folder_of(tmp_path), "check", *words)
    assert done.returncode == 2
    assert why in done.stderr
