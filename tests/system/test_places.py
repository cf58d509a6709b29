"""Where keys and values stand: what the scanner cuts out of a text is, read alone, the value that TOML has there."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts.system.text.places import Place, Places
from campaign import cases, time_limit

EXAMPLES = sorted((Path(__file__).parents[2] / "examples").rglob("*.toml"))
TEXT = r"""# a comment with a = "b" and [x]
schema = 1
[components.a]   # here
type = 'x.py:X'
params.gain = 2.0
"params" . "q\u0075e" = "a # \" ]"
[[connections]]
from = "a.b"
to = [ "c.d", # one
  "e.f",
]
[[connections]]
from = { x = [1, {y = "]"}], z = 'it' }
[connections.deep]
er = 1979-05-27 07:32:00  # a time
"""


@pytest.mark.parametrize(
    ("key", "of_key", "place"),
    [
        (("schema",), True, Place(2, 1, 6)),
        (("schema",), False, Place(2, 10, 1)),
        (("components", "a"), True, Place(3, 13, 1)),
        (("components", "a", "type"), False, Place(4, 8, 8)),
        (("components", "a", "params", "gain"), True, Place(5, 8, 4)),
        (("components", "a", "params", "que"), False, Place(6, 25, 10)),
        (("connections", 0), True, Place(7, 1, 15)),
        (("connections", 0, "to"), True, Place(9, 1, 2)),
        (("connections", 0, "to", 1), False, Place(10, 3, 5)),
        (("connections", 1, "from", "x", 1, "y"), False, Place(13, 23, 3)),
        (("connections", 1, "deep", "er"), False, Place(15, 6, 19)),
        (("connections", 1, "missing"), True, Place(12, 1, 15)),
        (("nowhere",), True, Place(1, 1, 1)),
    ],
)
def test_a_key_and_its_value_have_a_place(key: tuple[str | int, ...], of_key: bool, place: Place) -> None:
    places = Places(TEXT)
    assert (places.key(key) if of_key else places.value(key)) == place


def test_a_part_of_a_value_has_a_place_unless_it_is_written_otherwise() -> None:
    text = 'm = """\n  0>1,\n  0:7>1"""\ne = "a\\u0062c"\n'
    places = Places(text)
    assert places.inside(("m",), "  0>1,\n  0:7>1", 11) == Place(3, 5, 1)
    assert places.inside(("e",), "abc", 1) is None
    assert places.line(3) == '  0:7>1"""'
    assert places.line(99) == ""


def leaves_of(value: Any, path: tuple[str | int, ...] = ()) -> list[tuple[tuple[str | int, ...], Any]]:
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else None
    if inner is None:
        return [(path, value)]
    return [leaf for key, one in inner for leaf in leaves_of(one, (*path, key))]


def check_all(text: str) -> int:
    """Each leaf of the text, cut out where the scanner says it stands, is the value that TOML has there."""
    text = text.replace("\r\n", "\n")
    places = Places(text)
    leaves = leaves_of(tomllib.loads(text))
    for path, value in leaves:
        start, end = places._values[path]
        alone = tomllib.loads(f"x = {text[start:end]}")["x"]
        assert repr(alone) == repr(value)
        assert path in places._keys or isinstance(path[-1], int)
    return len(leaves)


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.parent.name)
def test_every_value_of_the_examples_is_found(path: Path) -> None:
    assert check_all(path.read_text()) > 5


BLANKS = st.sampled_from(["", " ", "\t", "  "])
BREAKS = st.sampled_from(["", " ", "\n", " # ] } , comment\n", "\n\n  "])
BARE = st.sampled_from(["a", "b-1", "c_2", "type", "1"])
KEYS = st.one_of(BARE, BARE.map(json.dumps), st.sampled_from(["'x y'", '"a.b"', '"\\u0061b"', "''"]))
SCALARS = st.one_of(
    st.sampled_from(["true", "1", "-2.5e3", "0x1f", "inf", "1979-05-27", "1979-05-27T07:32:00Z", "07:32:00"]),
    st.text(st.sampled_from("ab\"\\'#][}{,=é\n"), max_size=6).map(json.dumps),
    st.text(st.sampled_from('ab"\\#][}{,= é'), max_size=6).map(lambda text: f"'{text}'"),
    st.sampled_from(
        ['"""a"b""c"""', '"""\n# x\n"""', "'''it's ''x'''", '"""x\\"""""""', "''''x'''", '""', "''", '""""""']
    ),
)


@st.composite
def values(draw: st.DrawFn, depth: int = 2) -> str:
    kind = draw(st.integers(0, 4)) if depth else 0
    if kind == 3:
        items = draw(st.lists(values(depth - 1), max_size=3))
        comma = f"{draw(BREAKS)},{draw(BREAKS)}"
        last = "," if items and draw(st.booleans()) else ""
        return f"[{draw(BREAKS)}{comma.join(items)}{draw(BREAKS)}{last}{draw(BREAKS)}]"
    if kind == 4:
        pairs = [
            f"k{number}{draw(BLANKS)}={draw(BLANKS)}{draw(values(depth - 1))}"
            for number in range(draw(st.integers(0, 3)))
        ]
        return f"{{{draw(BLANKS)}{f'{draw(BLANKS)},{draw(BLANKS)}'.join(pairs)}{draw(BLANKS)}}}"
    return draw(SCALARS)


@st.composite
def documents(draw: st.DrawFn) -> str:
    lines = []
    for _ in range(draw(st.integers(1, 8))):
        key = f"{draw(BLANKS)}.{draw(BLANKS)}".join(draw(st.lists(KEYS, min_size=1, max_size=3)))
        match draw(st.integers(0, 3)):
            case 0:
                lines.append(f"[{draw(BLANKS)}{key}{draw(BLANKS)}] # head")
            case 1:
                lines.append(f"[[{draw(BLANKS)}{key}{draw(BLANKS)}]]")
            case _:
                lines.append(f"{draw(BLANKS)}{key}{draw(BLANKS)}={draw(BLANKS)}{draw(values())}{draw(BLANKS)}")
    return "\n".join(lines)


@pytest.mark.slow(kept_by="test_every_value_of_the_examples_is_found")
@given(documents())
@settings(max_examples=cases(10_000))
@pytest.mark.timeout(time_limit(600))
def test_every_value_of_any_document_is_found(text: str) -> None:
    try:
        tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return
    check_all(text)
