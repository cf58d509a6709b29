"""The JSON Schema of system files: examples validate, what is broken does not, and what `parse` takes it takes."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts import Catalogue
from aiorts.errors import AiortsError
from aiorts.model import options
from aiorts.model.profile import ConnectorProfile
from aiorts.system import load, parse, prepare, schema
from aiorts.system.schemas.connection_schema import OPTIONS
from campaign import cases, time_limit
from system_parts import CHAIN

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted(path for path in (ROOT / "examples").rglob("*.toml") if path.name != "pyproject.toml")
CATALOGUE = Catalogue()
SCHEMA = schema(CATALOGUE)
PLAIN = schema(CATALOGUE, templates=False)
VALIDATOR = jsonschema.Draft202012Validator(SCHEMA)


def faults(text: str) -> list[str]:
    return [error.message for error in VALIDATOR.iter_errors(tomllib.loads(text))]


@pytest.mark.slow(kept_by="test_the_system_file_of_every_example_validates")
def test_it_is_a_schema() -> None:
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    json.dumps(SCHEMA, allow_nan=False)


@pytest.mark.row(78)
@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: f"{path.parent.name}-{path.stem}")
def test_the_system_file_of_every_example_validates(path: Path) -> None:
    own = schema(Catalogue(load(path).plugin_paths))
    assert jsonschema.Draft202012Validator(own).is_valid(tomllib.loads(path.read_text()))


GOOD = (
    CHAIN
    + """
[components.filter]
type = "FlexiFilter"
options = ["-i", "TimedDouble", "-o", "TimedLong", "-m", "0>1000>0"]
params.rounding = "floor"
params.clamp = [0, 10.5]
params.verbosity = 1
[components.const]
type = "FlexiConst"
params.rate = 50.0
[plugins]
path = ["."]
[clock]
kind = "scaled"
speed = 10.0
"""
)


def test_the_good_one_of_which_the_broken_ones_are_made_validates() -> None:
    assert faults(GOOD) == []


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("params.rate = 50.0", 'params.continuous = "enable"'),
        ("params.verbosity = 1", 'params.verbosity = "0x1"'),
        ("length = 4", 'length = 4\nfsm_event_name = "x"'),
    ],
)
def test_what_the_reader_takes_validates(old: str, new: str) -> None:
    assert old in GOOD
    assert faults(GOOD.replace(old, new, 1)) == []


@pytest.mark.row(78)
@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("schema = 1", "schema = 2"),
        ("schema = 1", 'schema = "1"'),
        ("schema = 1\n", ""),
        ("[plugins]", "[plugin]"),
        ('path = ["."]', 'path = "."'),
        ("speed = 10.0", "speed = 0"),
        ("speed = 10.0", ""),
        ('kind = "scaled"', 'kind = "system"'),
        ('type = "parts.py:Sink"', 'typ = "parts.py:Sink"'),
        ('type = "parts.py:Sink"', 'type = "FlexiFliter"'),
        ("[components.const]", '[components."const 1"]'),
        ('options = ["-i"', 'options = [true, "-i"'),
        ('params.rounding = "floor"', 'params.rounding = "up"'),
        ('params.rounding = "floor"', 'params.roundin = "floor"'),
        ("params.clamp = [0, 10.5]", "params.clamp = [[0], 10.5]"),
        ("params.verbosity = 1", "params.verbosity = 1.5"),
        ("params.verbosity = 1", 'params.verbosity = "much"'),
        ("params.rate = 50.0", "params.rate = 0.0"),
        ("length = 4", "length = -1"),
        ("length = 4", "lenght = 4"),
        ("length = 4", 'full = "blok"'),
        ("length = 4", "push_rate = true"),
        ('from = "source.out"', 'form = "source.out"'),
        ('from = "source.out"', 'from = "source"'),
        ('to = "middle.input"', "to = []"),
        ('kind = "periodic"', 'kind = "periodc"'),
        ("rate = 100.0\n", ""),
        ("rate = 100.0", "raet = 100.0"),
        ("rate = 100.0", 'rate = 100.0\noverrun = "wait"'),
        ('members = ["source"]', 'order = ["source"]'),
        ('members = ["source"]', 'members = ["source", "source"]'),
    ],
)
def test_thirty_broken_ones_do_not_validate(old: str, new: str) -> None:
    assert old in GOOD
    assert faults(GOOD.replace(old, new, 1)) != []


TEMPLATES = """
include = ["other.toml", { file = "arm.toml", prefix = "left{i}_", repeat = 2, if = "${sim}", vars = { a = 1 } }]
schema = 1
[variables]
sim = true
rate = 100.0
env = ["ROBOT"]
[clock]
kind = "scaled"
speed = "${speed}"
[components."source{i}"]
repeat = "${count}"
if = "not ${sim}"
type = "${type}"
options = "${options}"
[components.const]
type = "FlexiConst"
params.rate = "${rate}"
supervision = { restart = "${restart}", backoff = "${backoff}" }
start = { after = ["source{i} active"] }
[[connections]]
repeat = 3
from = "source{i}.out"
to = ["middle{i}.input", "${out}"]
length = "${length}"
[contexts.fast]
kind = "periodic"
rate = "${rate}"
members = "${members}"
[contexts."fast{i}"]
kind = "${kind}"
members = []
"""


@pytest.mark.row(78)
def test_templates_validate_wherever_a_value_does() -> None:
    assert faults(TEMPLATES) == []


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('if = "not ${sim}"', "if = 3"),
        ("repeat = 3", "repeat = -1"),
        ("repeat = 3", 'repeat = "often"'),
        ('file = "arm.toml"', 'fil = "arm.toml"'),
        ('speed = "${speed}"', 'speed = "fast"'),
        ('env = ["ROBOT"]', "env = 3"),
        ("sim = true\n", "sim = { a = 1 }\n"),
    ],
)
def test_templates_that_are_wrong_do_not_validate(old: str, new: str) -> None:
    assert old in TEMPLATES
    assert faults(TEMPLATES.replace(old, new, 1)) != []


@pytest.mark.slow
def test_it_has_every_option_of_a_connection_and_no_other() -> None:
    assert set(OPTIONS) == set(options.OWN_KEYS)
    for key, one in OPTIONS.items():
        for word in one.get("anyOf", [{}])[0].get("enum", ()):
            assert spelled(key, word.title()) == spelled(key, f" {word.upper()} ") == spelled(key, word)
            assert faults(GOOD.replace("length = 4", f'{key} = " {str(word).title()} "', 1)) == []
        assert one["description"]


def spelled(key: str, word: str) -> ConnectorProfile:
    return options.connector_profile("", {key: word, "push_rate": 1.0}, "", ())[0]


def test_an_editor_finds_types_parameters_units_defaults_and_docs() -> None:
    filters = next(
        one for one in PLAIN["$defs"]["component"]["oneOf"] if one["properties"]["type"].get("const") == "FlexiFilter"
    )
    rounding = filters["properties"]["params"]["properties"]["rounding"]
    assert rounding["enum"] == ["nearest", "truncate", "floor"]
    assert (rounding["default"], rounding["description"]) == ("nearest", "fraction to integer; nearest: halves to even")
    assert "-m, --map: in[:pin]" in filters["properties"]["options"]["description"]
    const = next(
        one for one in PLAIN["$defs"]["component"]["oneOf"] if one["properties"]["type"].get("const") == "FlexiConst"
    )
    rate = const["properties"]["params"]["properties"]["rate"]
    assert rate["title"] == "float | None [Hz]"
    number, text = rate["anyOf"][0]["anyOf"] if "anyOf" in rate["anyOf"][0] else rate["anyOf"]
    assert number == {"type": "number", "exclusiveMinimum": 0.0, "maximum": 1e6}
    assert text["type"] == "string"
    periodic = next(
        one for one in PLAIN["$defs"]["context"]["oneOf"] if one["properties"]["kind"]["const"] == "periodic"
    )
    assert periodic["required"] == ["kind", "rate", "members"]
    assert periodic["properties"]["rate"]["description"] == "Cycles per second, up to max_rate. Unit: Hz."


# -- what the program takes, the schema takes --------------------------------------------------------------------------

NUMBERS = st.one_of(
    st.integers(-3, 2000),
    st.floats(allow_nan=False, width=32),
    st.sampled_from(["5", "0x10", " 2.5 ", "1e3", "inf", "x"]),
)
WORDS = st.sampled_from(
    [
        "new",
        "flush",
        "periodic",
        "Flush",
        " NEW ",
        "all",
        "skip",
        "block",
        "overwrite",
        "push",
        "pull",
        "send",
        "on",
        "no",
    ]
)
PARAMS = st.one_of(
    NUMBERS,
    WORDS,
    st.booleans(),
    st.lists(st.one_of(NUMBERS, WORDS), max_size=3),
    st.sampled_from(["floor", "sum", "none"]),
)


def toml(value: Any) -> str:
    if isinstance(value, float):
        return repr(value) if value == value and abs(value) != float("inf") else ("-inf" if value < 0 else "inf")
    if isinstance(value, list):
        return f"[{', '.join(map(toml, value))}]"
    return json.dumps(value)


PARAMETERS = {
    "FlexiFilter": ["inputs", "map", "rounding", "clamp", "verbosity", "zero_old", "combine"],
    "FlexiConst": ["outputs", "rate", "seconds", "count", "continuous"],
    "FlexiDump": ["inputs", "rate_limit", "format", "stamp"],
    "FlexiSelect": ["port", "initial", "feedback"],
}
KEYS = st.sampled_from(
    [*OPTIONS, "dataport.buffer.length", "inport.buffer.write.timeout", "data_type", "io_mode", "lenght"]
)
OPTION_LISTS = st.sampled_from([*["[]", '"-v 1"', '["-v", 2]'] * 4, "[true]", "5"])
SPEEDS = st.sampled_from(["speed = 2\n", "speed = 0.5\n", "speed = -1\n"])
CLOCKS = ('"system"', '"scaled"', '"simulated"')
CONTEXT = {
    "periodic": ["overrun", "max_rate", "deadline", "timing", "raet"],
    "event": ["deadline", "timing", "rate"],
    "thread": ["rate", "overrun"],
    "realtime": ["priority", "cpus", "lock_memory", "spin"],
}


@st.composite
def systems(draw: st.DrawFn) -> str:
    names = [f"n{number}" for number in range(draw(st.integers(1, 3)))]
    text = "schema = 1\n"
    for name in names:
        kind = draw(st.sampled_from(sorted(PARAMETERS)))
        text += f'[components.{name}]\ntype = "{kind}"\n'
        for param in draw(st.lists(st.sampled_from(PARAMETERS[kind]), unique=True, max_size=1)):
            text += f"params.{param} = {toml(draw(PARAMS))}\n"
        if draw(st.booleans()):
            text += f"options = {draw(OPTION_LISTS)}\n"
    for _ in range(draw(st.integers(0, 2))):
        to = draw(st.sampled_from([*['"n0.a"', '["n0.a", "n0.b"]'] * 4, "[]", '"n0"']))
        text += f'[[connections]]\nfrom = "n0.x"\nto = {to}\n'
        for key in draw(st.lists(KEYS, unique=True, max_size=1)):
            text += f"{key} = {toml(draw(st.one_of(PARAMS, WORDS)))}\n"
    if draw(st.booleans()):
        kind = draw(st.sampled_from(sorted(CONTEXT)))
        members = json.dumps(draw(st.lists(st.sampled_from(names), unique=True, max_size=2)))
        text += f'[contexts.c]\nkind = "{kind}"\nmembers = {members}\n'
        if kind in ("periodic", "realtime"):
            text += "rate = 10\n"
        for key in draw(st.lists(st.sampled_from(CONTEXT[kind]), unique=True, max_size=1)):
            text += f"{key} = {toml(draw(st.one_of(NUMBERS, st.booleans(), st.just('skip'), st.just([0]))))}\n"
    if draw(st.booleans()):
        text += f"[clock]\nkind = {draw(st.sampled_from(CLOCKS))}\n"
        text += "" if "scaled" not in text and draw(st.booleans()) else draw(SPEEDS)
    return text


@pytest.mark.slow(kept_by="test_the_system_file_of_every_example_validates")
@pytest.mark.row(78)
@given(systems())
@settings(max_examples=cases(20_000))
@pytest.mark.timeout(time_limit(900))
def test_what_the_program_accepts_the_schema_accepts(text: str) -> None:
    """`prepare` is stricter than `parse`: types, parameters, options and contexts are checked with it."""
    try:
        prepare(parse(text, Path("nowhere/s.toml")), CATALOGUE)
    except AiortsError:
        return
    assert faults(text) == []
