"""F01: whatever is given as a system file is refused within a second, with line and column and the reason, or read."""

from __future__ import annotations

import os
import random
import sys
import time
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts.errors import ConfigurationError, SystemFileError
from aiorts.model.configuration.configuration_text import parse_document
from aiorts.system import check, check_text, load, parse
from aiorts.system.file.parse import read
from aiorts.system.text.toml import tables
from campaign import CAMPAIGN, cases, time_limit
from system_parts import CHAIN

ROOT = Path(__file__).parents[2]
HERE = Path("system.toml")
PIECES = (
    "[",
    "]",
    "[[",
    '"',
    "'",
    '"""',
    "=",
    ".",
    ",",
    "\n",
    "#",
    "{",
    "}",
    "\\",
    "\x00",
    "é",
    "true",
    "1e9",
    "schema",
    "type",
)


@pytest.mark.fault("F01")
@pytest.mark.parametrize(
    ("data", "place", "said"),
    [
        (b"schema = 1\nx = \n", "2:5", "not valid TOML: Invalid value"),
        (b"schema = 1\n[a\n", "2:3", "not valid TOML"),
        (b"schema = 1\nschema = 1\n", "2:", "not valid TOML: Cannot overwrite a value"),
        (b"schema = 1\nx = " + b"[" * 100_000, "2:5", "nesting so deep"),
        (b"schema = 1\nx = " + b"[# ]\n" * 100_000, "2:5", "nesting so deep"),
        (b"schema = 1\n" + b"a." * 20_000 + b"b = 1", "2:2", "a key of so many parts"),
        (b"schema = 1\n" + b"'!.'." * 20_000 + b"b = 1", "2:5", "a key of so many parts"),
        (b"schema = 1\nx = 'a'\ny = " + b"1" * 5_000, "3:5", "a number of so many digits"),
        (b"schema = 1\n# \xe9\n", "2:3", "not UTF-8 (byte 0xe9); save the file with that encoding"),
        ("schema = 1\n# é\xe9".encode() + b"\xff", "2:5", "not UTF-8 (byte 0xff)"),
        (b"schema = 1\nx = 'abc", "2:9", "the file ends here"),
        (b"\xff\xfeschema = 1", "1:1", "not UTF-8 (byte 0xff)"),
    ],
    ids=[
        "syntax",
        "bracket",
        "twice",
        "nested",
        "nested-comments",
        "dotted",
        "quoted",
        "digits",
        "latin-1",
        "after-text",
        "end",
        "utf-16",
    ],
)
def test_what_is_no_toml_has_line_column_and_reason(tmp_path: Path, data: bytes, place: str, said: str) -> None:
    path = tmp_path / "s.toml"
    path.write_bytes(data)
    begun = time.monotonic()
    with pytest.raises(SystemFileError) as caught:
        load(path)
    assert str(caught.value).startswith(f"{path}:{place}")
    assert said in str(caught.value)
    (finding,) = check(path)
    assert time.monotonic() - begun < 2.0  # twice
    assert f"{finding.line}:{finding.column}".startswith(place)
    assert said in finding.message
    assert finding.severity == "error"


HUGE = ("1" * 4000, "-" + "9" * 400, "0x" + "f" * 5000, "0b" + "1" * 2000, "1" * 5000)
ANYWHERE = """\
{top}
[components.source]
type = "parts.py:Source"
{component}
[components.sink]
type = "parts.py:Sink"
[[connections]]
from = "source.out"
to = "sink.inp"
{connection}
[contexts.loop]
kind = "periodic"
rate = {rate}
members = ["source", "sink"]
{context}
"""


@pytest.mark.parametrize("number", HUGE, ids=["decimal", "negative", "hexadecimal", "binary", "no decimal"])
@pytest.mark.parametrize(
    ("part", "line"),
    [
        ("top", "schema = "),
        ("rate", ""),
        ("context", "deadline = "),
        ("context", "max_rate = "),
        ("connection", "timeout = "),
        ("connection", "push.rate = "),
        ("component", "params.gain = "),
        ("component", "params.several = [1, {more = "),
        ("component", "supervision.backoff = "),
        ("component", "sets.soft.gain = "),
        ("top", "schema = 1\nwatch_loop.limit = "),
        ("top", "schema = 1\nclock.speed = "),
        ("top", "schema = 1\nunknown = "),
    ],
)
def test_a_number_of_very_many_digits_has_its_place_wherever_it_stands(part: str, line: str, number: str) -> None:
    filled = f"{line}{number}{'}]' if '{' in line else ''}"
    parts = {"top": "schema = 1", "rate": "10.0", "component": "", "connection": "", "context": "", part: filled}
    text = ANYWHERE.format(**parts)
    (finding,) = check_text(text, HERE)
    assert (finding.code, finding.severity) == ("E-CONFIG", "error")
    assert finding.cause.endswith("a number of so many digits has no place here (at most 308)")
    assert text.splitlines()[finding.line - 1][finding.column - 1 :].startswith(number.lstrip("-"), number[0] == "-")
    with pytest.raises(ConfigurationError) as caught:
        parse(text, HERE)
    assert caught.value.code == "E-CONFIG"
    assert str(caught.value).startswith(f"system.toml:{finding.line}:{finding.column}: ")


DOTS, BRACKETS = "." * 40, "[{" * 40


@pytest.mark.parametrize(
    "line",
    [
        f"# {DOTS} {BRACKETS} don't \"",
        f'doc = "{DOTS} {BRACKETS}\\" {BRACKETS}"',
        f"doc = '{DOTS} {BRACKETS}\\'",
        f'doc = """\n{BRACKETS} "" \n{DOTS}\\"""{BRACKETS}""""  # \'',
        f"doc = '''\n{BRACKETS} '' \n{DOTS}'''''",
    ],
    ids=["comment", "basic", "literal", "basic lines", "literal lines"],
)
def test_dots_and_brackets_in_comments_and_texts_are_neither_keys_nor_nesting(line: str) -> None:
    assert tables(f"schema = 1\n{line}\nx = 2\n", HERE)["x"] == 2
    assert (
        parse_document(f"schema = 1\n[components.a.sets.b]\n{line}\n", "a.toml").components["a"].sets["b"] is not None
    )


@pytest.mark.slow(kept_by="test_as_many_texts_as_five_minutes_allow_are_read_or_refused_by_name")
@given(st.text("ab.[]{}\"'#\\\n =1", max_size=60))
@settings(max_examples=cases(20_000))
def test_what_a_toml_reader_takes_with_little_in_it_is_taken(text: str) -> None:
    """So short a text has no 32 of anything but in a comment or a text."""
    padded = f"# {DOTS}{BRACKETS}\nq = '{DOTS}{BRACKETS}'\n{text}"
    try:
        expected = tomllib.loads(padded)
    except tomllib.TOMLDecodeError:
        return
    assert tables(padded, HERE) == expected


@pytest.mark.fault("F01")
def test_a_byte_order_mark_and_other_line_ends_are_no_mistake(tmp_path: Path) -> None:
    path = tmp_path / "s.toml"
    path.write_bytes(b"\xef\xbb\xbf" + b"schema = 1\r\n[components.a]\r\ntyp = 'x'\r\n")
    (finding,) = check(path)
    assert (finding.line, finding.column, finding.quote) == (3, 1, "typ = 'x'")
    path.write_bytes(b"\xef\xbb\xbfschema = 1\n")
    assert [one.code for one in check(path)] == ["W-EMPTY"]  # which is about what it says


@pytest.mark.fault("F01")
@pytest.mark.skipif(sys.platform == "win32", reason="no pipes and devices in the file system")
@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda path: (path.touch(), os.truncate(path, 100 * 1024 * 1024)), "larger than 1048576 bytes"),
        (lambda path: path.mkdir(), "it is a directory"),
        (os.mkfifo, "it is a pipe"),
        (lambda path: path.symlink_to("/dev/zero"), "it is a device"),
        (lambda path: path.symlink_to(path), "cannot be read"),
        (lambda path: path.with_name("ss.toml").write_text(""), "did you mean"),
    ],
    ids=["large", "directory", "fifo", "zero", "loop", "missing"],
)
def test_what_is_no_file_is_refused_at_once(tmp_path: Path, make: Callable[[Path], object], said: str) -> None:
    path = tmp_path / "s.toml"
    make(path)
    begun = time.monotonic()
    with pytest.raises(SystemFileError, match=said):
        load(path)
    assert time.monotonic() - begun < 1.0
    (finding,) = check(path)
    assert (finding.line, finding.severity) == (0, "error")


@pytest.mark.slow(kept_by="test_what_is_no_toml_has_line_column_and_reason")
def test_many_mistakes_take_no_longer_than_a_few() -> None:
    text = "schema = 1\n" + "".join(f"k{n} = {n}\n" for n in range(40_000))
    begun = time.thread_time()
    with pytest.raises(SystemFileError, match=r"system.toml:2:1: k0: unknown key 'k0'"):
        parse(text, HERE)
    assert time.thread_time() - begun < 5.0


def mutated(text: str, chance: random.Random) -> str:
    for _ in range(chance.randint(1, 4)):
        start = chance.randrange(len(text) + 1)
        end = min(len(text), start + chance.randrange(12))
        piece = chance.choice(PIECES) if chance.random() < 0.7 else chance.choice(text.split() or [" "])
        text = text[:start] + piece + text[end:]
    return text


@pytest.mark.slow(kept_by="test_what_is_no_toml_has_line_column_and_reason")
@pytest.mark.fault("F01")
@given(st.randoms(use_true_random=False))
@settings(max_examples=cases(20_000))
@pytest.mark.timeout(time_limit(900))
def test_any_text_gives_findings_and_never_an_exception(chance: random.Random) -> None:
    for finding in check_text(mutated(CHAIN.replace("parts.py:", "FlexiDump"), chance), HERE):
        assert finding.cause
        assert finding.severity in ("error", "warning", "note")
        assert finding.line >= 0


@pytest.mark.fault("F01")
@pytest.mark.campaign
@pytest.mark.skipif(not CAMPAIGN, reason="the long version; AIORTS_CAMPAIGN=1")
@pytest.mark.timeout(time_limit(900))
def test_as_many_texts_as_five_minutes_allow_are_read_or_refused_by_name() -> None:
    texts = [CHAIN, (ROOT / "examples" / "roomba" / "system.toml").read_text()]
    chance = random.Random(4)
    end = time.monotonic() + float(os.environ.get("AIORTS_FUZZ_SECONDS", "300"))
    count = good = 0
    while time.monotonic() < end and count < 1_000_000:
        count += 1
        try:
            text = mutated(chance.choice(texts), chance)
            _, mistakes = read(text, HERE)
            good += not mistakes
            if mistakes and count % 4 == 0:
                assert mistakes[0].place(text).line >= 1
        except SystemFileError as error:
            assert str(error).startswith("system.toml")  # noqa: PT017 - a million cases: no context manager
    print(f"{count} texts, {good} of them good systems")
    assert good
