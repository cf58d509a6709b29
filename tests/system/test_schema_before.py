"""The JSON Schema of system files takes the files that it took before options were declared once, and the reader's."""

from __future__ import annotations

import gzip
import json
import re
from collections.abc import Iterator
from pathlib import Path
from random import Random
from typing import Any

import jsonschema
import pytest

from aiorts import Catalogue
from aiorts.system import schema
from aiorts.system.file.parse import read
from aiorts.system.file.survey import survey
from campaign import CAMPAIGN
from schema_files import Maker, parts_of, toml
from system_parts import PARTS

BEFORE = json.loads(gzip.decompress((Path(__file__).parent / "golden" / "schema-before.json.gz").read_bytes()))
"""What `aiorts schema` printed at commit 23b0e4bc, without titles, descriptions and defaults."""
EMPTY = '"isolation" = ""'
"""What the reader takes for no such line, and the schema refused before, too."""
COUNT = 20_000 if CAMPAIGN else 2_000
TAKEN = ("on", "off", "0x10", "0o17", "0b101", "enable", "disable")
"""Texts, in any case and with blanks round them, of truth values and of whole numbers that one reading takes now."""
REFUSED = ("4.0", "1e3", "0.25", "1e-3", "_")
"""Texts that the schema took for whole numbers, and the reader never did."""
SETTINGS = {("control", "mode"): "a", ("record", "min_free"): 1e13, ("replay", "rate"): 0, ("replay", "speed"): -1}
"""Settings of services whose range or words the schema did not know, and the reader did; with a value out of range."""
OPTIONS = ("rate", "max_rate", "deadline", "every")
"""Options of contexts whose ranges the schema has now; the contexts refused such values before."""
UNSAID = {
    "what else there is": (
        *("^unknown component", "^unknown member", "no set ", "no member", "no component named ", "no such parameter"),
        *("has no variable", "is not in the environment", "cannot be read", "no file ", "no such folder"),
        *("outside the system file's folder", "no converter named "),
    ),
    "what goes together": (
        *("are connected already", "there is a component ", "there is '.*' already", "is a member of .* already"),
        *("would be a member of itself", "cannot wait for itself", "wait for each other", "in no group"),
        *("is less than backoff", "limits are those of a process", "nothing says (what to replay|where to record)"),
        *("known by certificates alone", "in its certificate, and no other", "are one option with two values"),
        "there are certificates as well",
        *("needs a push_rate", "both ports are in this kernel", "the (reader|writer) is in another kernel"),
        *("both ends are in other processes", "is never looked at"),
        *("no port is of this system", "(do|does|goes) not go with", "goes not with", "repeat needs a prefix"),
        *("a number only with repeat", "{i} is missing in the name"),
    ),
    "the range, or the form, of a text": (r"^[\w.-]+ = '.*': (expected a|must be|element )", r": element \d+ \("),
    "the form of a name or a pattern": (
        *("name '.*' not allowed", "name '.*starts with", "name '.*': allowed are", "expected component.port"),
        *("expected COMPONENT.PORT", "no pattern for ports", "expected what names may begin with", "a group is empty"),
        *("expected letters, digits", "expected the name of a file"),
    ),
    "a component's own command line": ("no option ", "expected an option such as"),
    "the ranges of a context's arguments": (
        r"(rate|max_rate|deadline|every|cpus|priority) = .*: expected (a number of Hz|seconds|numbers of|[\d.]+ to)",
        "spin = .*: expected",
    ),
    "OpenRTM's names": (
        "^(dataflow|stamp|subscription|allow_duplicate|sync_readwrite) = .*: expected",
        *("unknown option '", "is an empty table"),
    ),
    "the contents of a service's tables": ("expected (viewer, operator|host:port|names of components)",),
    "infinity": ("inf: expected",),
    "which whole numbers a float holds, and that 4.0 is none": (
        "holds this whole number",
        r"expected how often, .*, got 4\.0",
        r"\.0: (expected a whole|must be an int)",
    ),
    "that [plugins] has no condition": ("unknown key 'if'; there are path",),
}
"""What a schema that takes the same files as before can not say, with the messages of the reader."""


def known(now: Any, before: Any) -> Any:
    """A schema without the keys and the kinds that came later."""
    if not isinstance(now, dict) or not isinstance(before, dict):
        return now
    made = {word: known(one, before.get(word)) for word, one in now.items()}
    if "properties" in now and "properties" in before:
        made["properties"] = {key: one for key, one in made["properties"].items() if key in before["properties"]}
    if "oneOf" in now and "oneOf" in before:
        kinds = {kind(one): one for one in before["oneOf"]}
        made["oneOf"] = [known(one, kinds[kind(one)]) for one in now["oneOf"] if kind(one) in kinds]
    return made


def kind(node: dict[str, Any]) -> str:
    """The type of a component, or the kind of a context or a clock, which a choice is about."""
    keys = node.get("properties", {})
    return str(keys.get("type", keys.get("kind", {})).get("const", ""))


CATALOGUE = Catalogue()
NOW = known(schema(CATALOGUE), BEFORE)
TAKES_NOW = jsonschema.Draft202012Validator(NOW)
TOOK_BEFORE = jsonschema.Draft202012Validator(BEFORE)


@pytest.fixture(scope="module")
def makers() -> tuple[Maker, Maker]:
    chance = Random(42)
    return Maker(BEFORE, chance), Maker(NOW, chance)


@pytest.fixture(scope="module")
def files(makers: tuple[Maker, Maker]) -> list[dict[str, Any]]:
    """Right files, each followed by the same with something changed; in the place of each tenth is such a one, too."""
    made = []
    for number in range(COUNT // 2):
        maker = makers[number % 2]
        right = maker.file()
        made += [right if number % 10 else maker.marred(right), maker.marred(right)]
    return made


@pytest.fixture(scope="module")
def verdicts(files: list[dict[str, Any]]) -> list[tuple[bool, bool]]:
    """Of each file, whether the schema takes it now, and took it before."""
    return [(TAKES_NOW.is_valid(file), TOOK_BEFORE.is_valid(file)) for file in files]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a file of components, and a system file to include."""
    there = tmp_path_factory.mktemp("before")
    (there / "parts.py").write_text(PARTS)
    (there / "part.toml").write_text("schema = 1\n")
    return there


def places(error: jsonschema.ValidationError) -> Iterator[str | int]:
    """The keys of a value that is refused, and of what is wrong in it."""
    yield from error.absolute_path
    for inner in error.context or ():
        yield from places(inner)


def is_named(place: tuple[str | int, ...], value: Any, *, now: bool) -> bool:
    """Whether the value, or one in it, is in one of the lists of what is taken, or refused, now."""
    found = list(leaves(value))
    texts = {leaf.strip().lower() for _, leaf in found if isinstance(leaf, str)}
    of_context = place[:1] == ("contexts",) and any(key in OPTIONS for key in (*place[2:], *(key for key, _ in found)))
    return bool(texts & {*(TAKEN if now else REFUSED)}) or (not now and (place[:2] in SETTINGS or of_context))


def leaves(value: Any, key: str | int = "") -> Iterator[tuple[str | int, Any]]:
    """The values of a table or list that are neither, with the key of each."""
    if not isinstance(value, dict | list):
        yield key, value
        return
    for inner, one in value.items() if isinstance(value, dict) else enumerate(value):
        yield from leaves(one, inner)


@pytest.mark.slow
def test_two_thousand_files_are_taken_and_refused_as_before(
    files: list[dict[str, Any]], makers: tuple[Maker, Maker], verdicts: list[tuple[bool, bool]]
) -> None:
    assert len(TAKEN) + len(REFUSED) + len(SETTINGS) + len(OPTIONS) <= 20
    unrefused = {*NOW["properties"], "start", "supervision"}
    for file, (now, before) in zip(files, verdicts, strict=True):
        if now != before:
            for error in (TOOK_BEFORE if now else TAKES_NOW).iter_errors(file):
                assert is_named(tuple(error.absolute_path), error.instance, now=now), (error, file)
        elif not now and unrefused:
            unrefused -= {word for error in TAKES_NOW.iter_errors(file) for word in places(error)}
    assert len(files) == COUNT
    assert 0.4 * COUNT <= sum(now for now, _ in verdicts) <= 0.6 * COUNT
    assert unrefused == set()
    for made_of, maker in zip((BEFORE, NOW), makers, strict=True):
        keys = [part for part in parts_of(made_of) if part[-2:-1] in (("properties",), ("$defs",))]
        assert [key for key in keys if not maker.made[key]] == []


@pytest.mark.parametrize("word", TAKEN)
def test_what_is_taken_now_the_reader_takes(word: str, folder: Path) -> None:
    key = "length" if word.startswith("0") else "allow_duplicate"
    assert refused({**CONNECTED, "connections": [{**PAIR, key: word}]}, folder) == []


@pytest.mark.parametrize("word", REFUSED)
def test_a_text_that_is_refused_now_the_reader_refuses(word: str, folder: Path) -> None:
    said = refused({**CONNECTED, "connections": [{**PAIR, "length": word}]}, folder)
    assert said == [f"length = {word!r}: expected a whole number from 0 to 1000000"]


@pytest.mark.parametrize("place", SETTINGS, ids=".".join)
def test_a_setting_that_is_refused_now_the_reader_refuses(place: tuple[str, str], folder: Path) -> None:
    service, key = place
    file = {"schema": 1, service: {"file": "run.mcap", key: SETTINGS[place]}}
    if service == "control":
        del file[service]["file"]
    assert TOOK_BEFORE.is_valid(file)
    assert not TAKES_NOW.is_valid(file)
    assert len(refused(file, folder)) == 1


PAIR = {"from": "a.out", "to": "b.input"}
CONNECTED = {"schema": 1, "components": {"a": {"type": "parts.py:Source"}, "b": {"type": "parts.py:Sink"}}}


def refused(file: dict[str, Any], folder: Path) -> list[str]:
    """What the reader says of a file, until all of its parts are loaded."""
    system, mistakes = read(toml(file), folder / "system.toml")
    return [one.what for one in mistakes] or [str(one.error) for one in survey(system, CATALOGUE).faults]


def has_template(node: Any) -> bool:
    """Whether there is a text whose value comes from a variable or a number."""
    if isinstance(node, str):
        return "${" in node or "{i" in node
    if isinstance(node, dict):
        return any(map(has_template, node.values())) or any("${" in key for key in node)
    return isinstance(node, list) and any(map(has_template, node))


def whole(node: Any) -> Any:
    """A file of which nothing is left out, or there ten thousand times."""
    if isinstance(node, list):
        return [whole(one) for one in node]
    if not isinstance(node, dict):
        return node
    made = {key: whole(one) for key, one in node.items()}
    if made.get("if") is False:
        made["if"] = True
    if type(made.get("repeat")) is int and 0 <= made["repeat"] <= 10_000:
        made["repeat"] = 2
    return made


@pytest.mark.slow
def test_what_the_schema_takes_the_reader_takes_and_what_it_refuses_the_reader_refuses(
    files: list[dict[str, Any]], verdicts: list[tuple[bool, bool]], folder: Path
) -> None:
    reasons = re.compile("|".join(words for several in UNSAID.values() for words in several))
    unexplained, count = [], {True: 0, False: 0}
    for file, (takes, _) in zip(map(whole, files), verdicts, strict=True):
        if has_template(file):
            continue
        said = refused(file, folder)
        assert takes or said or EMPTY in toml(file), file
        count[takes and not said] += 1
        for text in said if takes else ():
            unexplained += [] if reasons.search(text) else [text]
    assert unexplained == []
    assert count[True] >= 300
    assert count[False] >= 300
