"""The language of the map: every text is either read in full or refused with the place of the mistake."""

from __future__ import annotations

import math
import re

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts.errors import ConfigurationError
from aiorts_flexi.mapping.grammar import LONGEST_MAP, Entry, parse_map
from campaign import cases


@pytest.mark.parametrize(
    ("text", "entry"),
    [
        ("0>0", Entry(0, 0, 0, 0)),
        ("2>0:2", Entry(2, 0, 0, 2)),
        ("0:1>0.1>0:3", Entry(0, 1, 0, 3, 0.1)),
        ("0>1000-5>0", Entry(0, 0, 0, 0, 1000, -5)),
        ("0>1+0.5>0", Entry(0, 0, 0, 0, 1, 0.5)),
        ("0>1-5e3>0", Entry(0, 0, 0, 0, 1, -5000.0)),
        ("0>1e3>0", Entry(0, 0, 0, 0, 1000.0)),
        ("0>1e-3>0", Entry(0, 0, 0, 0, 0.001)),
        ("0>1e3-5>0", Entry(0, 0, 0, 0, 1000.0, -5)),
        ("0>-.5+1.>0", Entry(0, 0, 0, 0, -0.5, 1.0)),
        ("0>+2>0", Entry(0, 0, 0, 0, 2)),
        (" 0 > 0 ", Entry(0, 0, 0, 0)),
        ("0 > 2 > 1", Entry(0, 0, 1, 0, 2)),
        ("0:position.x>0:heading", Entry(0, "position.x", 0, "heading")),
        ("0:ranges[3]>0", Entry(0, "ranges[3]", 0, 0)),
    ],
)
def test_a_good_entry_is_read_as_it_says(text: str, entry: Entry) -> None:
    assert parse_map(text) == (entry,)


def test_the_map_of_the_paper_is_three_entries() -> None:
    assert parse_map("2>0:2,0:1>0.1>0:3,0:1>1") == (
        Entry(2, 0, 0, 2),
        Entry(0, 1, 0, 3, 0.1),
        Entry(0, 1, 1, 0),
    )


@pytest.mark.fault("F07")
@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("garbage", 1),
        ("", 1),
        ("-1>0", 1),
        ("0:1>>0", 5),
        ("0>0>0>0", 6),
        ("0>1.2.3>0", 6),
        ("0>inf>0", 3),
        ("0>nan>0", 3),
        ("0>0,", 5),
        (",0>0", 1),
        ("0>0,,0>1", 5),
        ("0>0;1>1", 4),
        ("0>0 0>1", 5),
        ("0 :1>0", 3),
        ("0: 1>0", 3),
        ("0>1 +2>0", 5),
        ("0>1+ 2>0", 4),
        ("0>1e>0", 4),
        ("0>0x10>0", 4),
        ("0>\u0661>0", 3),
        ("0>2-1", 6),
        ("0>0\n0>1", 5),
    ],
)
def test_a_bad_map_is_refused_with_the_place(text: str, place: int) -> None:
    with pytest.raises(ConfigurationError, match=f"character {place}:"):
        parse_map(text)


@pytest.mark.fault("F07")
def test_a_map_of_a_million_entries_is_refused_at_once() -> None:
    with pytest.raises(ConfigurationError, match=f"at most {LONGEST_MAP}"):
        parse_map("0>0," * 1_000_000)


def test_a_number_too_large_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="too large"):
        parse_map("0>1e999>0")


pins = st.integers(0, 999) | st.from_regex(r"[a-z][a-z0-9_]{0,5}(\.[a-z]{1,5}|\[[0-9]{1,3}\])?", fullmatch=True)
numbers = st.integers(-(10**18), 10**18) | st.floats(allow_nan=False, allow_infinity=False)
entries = st.builds(
    lambda source, source_pin, target, target_pin, factor: Entry(source, source_pin, target, target_pin, *factor),
    st.integers(0, 99),
    pins,
    st.integers(0, 99),
    pins,
    st.just((None, None)) | st.tuples(numbers, st.none() | numbers),
)


@pytest.mark.slow(kept_by="test_a_good_entry_is_read_as_it_says")
@given(st.lists(entries, min_size=1, max_size=8))
@settings(max_examples=cases(10_000))
def test_every_entry_survives_being_written_and_read(made: list[Entry]) -> None:
    assert parse_map(" , ".join(map(str, made))) == tuple(made)


@given(st.text(alphabet="0123456789>:,+-.eE ax[]", max_size=24))
@settings(max_examples=cases(10_000))
def test_any_text_is_read_in_full_or_refused_with_a_place_in_it(text: str) -> None:
    try:
        made = parse_map(text)
    except ConfigurationError as error:
        place = re.search(r"character (\d+)", str(error))
        assert place is not None
        assert 1 <= int(place[1]) <= len(text) + 1
    else:
        assert len(made) == text.count(",") + 1
        for entry, part in zip(made, text.split(","), strict=True):
            assert part.count(">") == (1 if entry.mult is None else 2)
            assert all(math.isfinite(number) for number in (entry.mult, entry.off) if number is not None)


# -- a second reader of the same language, which knows nothing of the first --------------------------------------------


def is_map(text: str) -> bool:
    """Whether the text is a map: cut at its symbols, and each part looked at as a whole."""
    return all(is_entry(part) for part in text.split(","))


def is_entry(text: str) -> bool:
    parts = [part.strip(" \t\r\n") for part in text.split(">")]
    if len(parts) not in (2, 3) or not (is_address(parts[0]) and is_address(parts[-1])):
        return False
    return len(parts) == 2 or is_number(parts[1]) or is_factor_with_offset(parts[1])


def is_address(text: str) -> bool:
    port, colon, pin = text.partition(":")
    return are_digits(port, 6) and (not colon or are_digits(pin, 9) or is_path(pin))


def are_digits(text: str, most: int) -> bool:
    return 1 <= len(text) <= most and set(text) <= set("0123456789")


def is_path(text: str) -> bool:
    for name in text.split("."):
        plain, *indices = name.split("[")
        if not plain or not (plain[0].isascii() and (plain[0].isalpha() or plain[0] == "_")):
            return False
        if not all(character.isalnum() or character == "_" for character in plain):
            return False
        if not all(index.endswith("]") and are_digits(index[:-1].removeprefix("-"), 9) for index in indices):
            return False
    return True


def is_number(text: str) -> bool:
    if not set(text) <= set("0123456789.eE+-") or len(text) > 100:
        return False
    try:
        return math.isfinite(float(text)) or text.lstrip("+-").isdigit()
    except ValueError:
        return False


def is_factor_with_offset(text: str) -> bool:
    return any(
        text[place] in "+-" and is_number(text[:place]) and is_number(text[place:]) for place in range(1, len(text))
    )


@st.composite
def nearly_maps(draw: st.DrawFn) -> str:
    """Maps with a few characters put in, taken out or changed."""
    text = draw(st.sampled_from([",", " , ", ",\n"])).join(map(str, draw(st.lists(entries, min_size=1, max_size=3))))
    text = text.replace(":0", "") if draw(st.booleans()) else text
    for _ in range(draw(st.integers(0, 2))):
        place = draw(st.integers(0, len(text)))
        put = draw(st.sampled_from(["", *"0123456789>:,+-.eE _x[]\u0661\t"]))
        text = text[:place] + put + text[place + draw(st.integers(0, 1)) :]
    return text


@pytest.mark.slow(kept_by="test_the_examples_of_the_language_are_in_it_for_both")
@pytest.mark.fault("F07")
@given(nearly_maps() | st.text(alphabet="0123456789>:,+-.eE ax[]", max_size=24))
@settings(max_examples=cases(5_000))
def test_what_is_accepted_as_a_map_is_the_grammar(text: str) -> None:
    refused = ""
    try:
        parse_map(text)
    except ConfigurationError as error:
        refused = str(error)
    assert "too small for a number of 64 bits" in refused or is_map(text) is not bool(refused)


@pytest.mark.parametrize(
    "text",
    ["0>1000-5>0", "0>1+0.5>0", "0>1-5e3>0", "0>1e3>0", "2>0:2,0:1>0.1>0:3,0:1>1", "0 > 0", " 0:a.b[3] > -.5e-3+1. >1"],
)
def test_the_examples_of_the_language_are_in_it_for_both(text: str) -> None:
    assert is_map(text)
    assert parse_map(text)
    for place in range(len(text)):  # garbage anywhere is garbage
        spoilt = f"{text[:place]}#{text[place:]}"
        assert not is_map(spoilt)
        with pytest.raises(ConfigurationError):
            parse_map(spoilt)


@pytest.mark.parametrize("factor", ["1e-400", "-0.001e-330", "1-1e-400"])
def test_a_factor_that_would_become_zero_is_refused(factor: str) -> None:
    with pytest.raises(ConfigurationError, match="too small for a number of 64 bits"):
        parse_map(f"0>{factor}>0")


@pytest.mark.parametrize("factor", ["0.0", "0e-400", "0.00e5", "5e-324"])
def test_zero_as_it_is_written_stays_a_factor(factor: str) -> None:
    assert parse_map(f"0>{factor}>0")[0].mult == float(factor)
