"""The mark under a mistake stands under the mistake, whatever the text is made of and however long it is."""

from __future__ import annotations

import unicodedata

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from aiorts.cli.console.quote import cells_of, quote
from aiorts.cli.console.report import report_error
from aiorts.errors import AiortsError, ConfigurationError, Place, SystemFileError
from aiorts.system.file.parse import parse, parse_override
from campaign import cases

TEXTS = st.text(st.characters(), max_size=300) | st.text("ab\t\n\x1b日本é\u0301\udcff", max_size=300)


@pytest.mark.parametrize(
    ("text", "start", "end", "line", "mark"),
    [
        ("0>garbage", 2, 9, "0>garbage", "  ^^^^^^^"),
        ("0>", 2, 2, "0>", "  ^"),
        ("", 0, 0, "", "^"),
        ("a\tb!c", 3, 4, r"a\tb!c", "    ^"),
        ("\x1b[31m!", 5, 6, r"\x1b[31m!", "        ^"),
        ("日本!", 2, 3, "日本!", "    ^"),
        ("日本!", 1, 2, "日本!", "  ^^"),
        ("e\u0301!", 2, 3, r"e\u0301!", "       ^"),
        ("one\ntwo!\nthree", 7, 8, "two!", "   ^"),
        ("one\ntwo", 3, 4, "one", "   ^"),
        ("bad \udcff", 4, 5, r"bad \udcff", "    ^^^^^^"),
    ],
)
def test_the_mark_stands_under_the_mistake(text: str, start: int, end: int, line: str, mark: str) -> None:
    assert quote(Place(text, start, end)) == (line, mark)


def test_what_the_stream_cannot_write_is_measured_as_it_is_shown() -> None:
    assert quote(Place("日!", 1, 2), encoding="ascii") == ("\\u65e5!", "      ^")


@pytest.mark.parametrize("place", [0, 5_000, 9_999, 10_000])
def test_a_long_line_is_cut_round_the_place(place: int) -> None:
    text = "".join("!" if number == place else "abcdefghij"[number % 10] for number in range(10_000))
    line, mark = quote(Place(text, place, place + 1), 60)
    assert max(len(line), len(mark)) <= 60
    at = mark.index("^")
    assert line[at : at + 1] == ("!" if place < 10_000 else "")
    assert line.startswith("...") == (place > 60)
    assert line.endswith("...") == (place < 9_900)


@pytest.mark.slow(kept_by="test_the_mark_stands_under_the_mistake")
@settings(max_examples=cases(10_000))
@example("\udcff", 0, 1, 20, "ascii")
@example("日" * 100, 50, 2, 21, "utf-8")
@given(
    TEXTS, st.integers(0, 310), st.integers(0, 310), st.integers(1, 120), st.sampled_from(["utf-8", "ascii", "latin-1"])
)
def test_two_lines_that_fit_and_print_whatever_was_typed(
    text: str, start: int, count: int, width: int, encoding: str
) -> None:
    error = ConfigurationError("x").at(text, start, start + count)
    assert error.typed is not None
    line, mark = quote(error.typed, width, encoding)
    assert max(cells_of(line), len(mark)) <= max(width, 20)
    assert (line + mark).isprintable()
    line.encode(encoding)
    assert mark.strip(" ").strip("^") == ""
    assert "^" in mark
    at = error.typed.start
    if at < len(text) and text[at] != "\n":
        shown = text[at] if text[at].isprintable() and not unicodedata.combining(text[at]) else ascii(text[at])[1:-1]
        shown = shown.encode(encoding, "backslashreplace").decode(encoding)
        before = mark.index("^")
        rest, column = list(line), 0
        while rest and column < before:
            column += cells_of(rest.pop(0))
        assert column == before
        assert "".join(rest).startswith(shown)


def test_a_megabyte_is_quoted_at_once() -> None:
    line, mark = quote(Place("x" * 10**6 + "!" + "y" * 10**6, 10**6, 10**6 + 1))
    assert line[mark.index("^")] == "!"


# -- where places come from --------------------------------------------------------------------------------------------


def marked(error: AiortsError, capsys: pytest.CaptureFixture[str]) -> tuple[str, str]:
    """What stands over the mark, and the line."""
    report_error(error, verbose=False)
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 3, said
    assert said[0].startswith(f"aiorts: {error.code}: ")
    return said[1][said[2].index("^") : said[2].rindex("^") + 1], said[1]


@pytest.mark.parametrize(
    ("text", "over"),
    [
        ("hello", ""),
        ("hello=3", "="),
        ("=3", "="),
        (".gain=3", "."),
        ("pid.=3", "="),
        ("", ""),
    ],
)
def test_a_bad_change_of_a_parameter_is_marked(text: str, over: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemFileError) as caught:
        parse_override(text)
    assert marked(caught.value, capsys)[0].strip() == over


@pytest.mark.fault("F01")
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_bad_toml_is_marked_where_it_is_bad(end: str, capsys: pytest.CaptureFixture[str]) -> None:
    from pathlib import Path

    text = end.join(("schema = 1", "[components.a]", "\ttype = 日本 ?", "", "[x]"))
    with pytest.raises(SystemFileError) as caught:
        parse(text, Path("system.toml"))
    over, line = marked(caught.value, capsys)
    assert line.strip() == "\\ttype = 日本 ?"
    assert line.startswith("  \\ttype = ")
    assert caught.value.typed is not None
    assert caught.value.typed.text[caught.value.typed.start] == "日"
    assert over


def test_a_wrapped_error_keeps_its_place() -> None:
    inner = ConfigurationError("x").at("abc", 1)
    assert SystemFileError("y").like(inner).typed == Place("abc", 1, 2)
    assert SystemFileError("y").like(ValueError()).typed is None


def test_a_place_is_always_inside_its_text() -> None:
    assert ConfigurationError("x").at("abc", 9, 12).typed == Place("abc", 3, 3)
    assert ConfigurationError("x").at("abc", -4, 1).typed == Place("abc", 0, 1)
    assert ConfigurationError("x").at("abc", 2, 1).typed == Place("abc", 2, 2)
