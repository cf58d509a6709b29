"""Whatever stands in a system file in the place of a value: check says so in words, and what it accepts is built."""

from __future__ import annotations

import copy
import json
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from aiorts import Kernel
from aiorts.errors import AiortsError
from aiorts.system import Finding, build, check, graph, load, prepare
from aiorts.system.checks.check import check_text
from aiorts.system.file.parse import parse
from aiorts.testing import simulate
from system_parts import TABLES

Write = Callable[..., Path]
GOOD = tomllib.loads(TABLES)


def toml(value: Any) -> str:
    """A value as TOML writes it in one line."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(key)} = {toml(one)}" for key, one in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    return json.dumps(value)


def document(tree: dict[str, Any]) -> str:
    return "".join(f"{json.dumps(key)} = {toml(value)}\n" for key, value in tree.items())


def keys(value: Any, way: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    """The way to each value of a tree, that of the whole left out."""
    pairs = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in pairs:
        yield (*way, key)
        yield from keys(inner, (*way, key))


def replaced(way: tuple[str | int, ...], value: Any) -> str:
    tree: Any = copy.deepcopy(GOOD)
    here = tree
    for key in way[:-1]:
        here = here[key]
    here[way[-1]] = value
    return document(tree)


def erring(found: tuple[Finding, ...]) -> list[Finding]:
    return [one for one in found if one.severity == "error"]


@pytest.mark.parametrize(
    ("text", "place", "cause"),
    [
        ('schema = 1\n[[components]]\nname = "a"\n', (2, 1), "expected tables such as [components.NAME], got "),
        ("schema = 1\ncomponents = 5\n", (2, 14), "expected tables such as [components.NAME], got 5"),
        ("schema = 1\ncomposites = 5\n", (2, 14), "expected tables such as [composites.NAME], got 5"),
        ("schema = 1\ncontexts = []\n", (2, 12), "expected tables such as [contexts.NAME], got []"),
        (
            TABLES.replace('["two.*"]', '[["two.*"]]'),
            (31, 13),
            "expected text such as \"arm.force\", got ['two.*']",
        ),
    ],
)
def test_a_table_of_another_form_is_named_with_its_place(
    write: Write, text: str, place: tuple[int, int], cause: str
) -> None:
    path = write(text)
    found = [one for one in erring(check(path)) if cause in one.cause]
    assert [(one.line, one.column) for one in found] == [place], check(path)
    with pytest.raises(AiortsError, match=r"system\.toml"):
        load(path)
    with pytest.raises(AiortsError, match=r"system\.toml"):
        graph(load(path), "dot")


@pytest.mark.parametrize(
    ("old", "new", "where"),
    [
        ('from = "source.out"', 'from = ""', "connections[1].from"),
        ('to = "arm.command"', 'to = ""', "connections[1].to"),
        ('to = "arm.command"', 'to = ["arm.command", ""]', "connections[1].to[2]"),
    ],
)
def test_an_empty_path_of_a_port_is_named(write: Write, old: str, new: str, where: str) -> None:
    path = write(TABLES.replace(old, new))
    assert [(one.where, one.cause, one.remedy, one.quote[one.column - 1 :][:2]) for one in erring(check(path))] == [
        (where, "is empty", "write COMPONENT.PORT", '""')
    ]
    with pytest.raises(AiortsError, match=r"is empty; write COMPONENT\.PORT"):
        load(path)


@pytest.mark.parametrize(
    ("old", "new", "quoted", "cause"),
    [
        (
            'members = ["arm", "sink"]',
            'members = ["arm"]',
            '"sink"',
            "waits for 'sink active' forever: sink is in no context",
        ),
        (
            'members = ["arm", "sink"]',
            'members = ["sink"]',
            '"arm active"',
            "waits for 'arm active' forever: arm is in no context",
        ),
        (
            'members = ["source"]',
            'members = ["two"]',
            "components.source.start",
            "source is in no context and cannot be started",
        ),
    ],
)
def test_a_start_that_can_never_be_is_named_before_it_is_waited_for(
    write: Write, old: str, new: str, quoted: str, cause: str
) -> None:
    text = TABLES.replace(old, new).replace('members = ["one", "hand"]', 'members = ["hand"]')
    text = text.replace('"one.input" = "command", ', "").replace('to = "arm.command"', 'to = "one.input"')
    if new == 'members = ["two"]':
        text = text.replace('members = ["arm", "sink"]', 'members = ["sink", "one"]').replace('"arm active", ', "")
    path = write(text)
    (found,) = (one for one in erring(check(path)))
    assert (found.cause, found.remedy) == (cause, "name it among the members of one")
    assert quoted.rpartition(".")[2] in found.quote[found.column - 1 : found.column - 1 + found.width]

    async def main() -> float:
        async with Kernel() as kernel:
            with pytest.raises(AiortsError, match=cause):
                await build(kernel, load(path))
            return kernel.clock.monotonic_ns() / 1e9

    assert simulate(main()) < 1.0


def test_somebody_in_no_context_may_be_waited_for_to_be_there(write: Write) -> None:
    path = write(TABLES.replace('members = ["arm", "sink"]', 'members = ["arm"]').replace('"sink"]', '"sink added"]'))
    assert erring(check(path)) == []


STRANGE = st.recursive(
    st.sampled_from([5, -1, 0.5, True, "", "x", "a.b"]),
    lambda inner: st.lists(inner, max_size=2) | st.dictionaries(st.sampled_from(["x", "value", "a.b", ""]), inner),
    max_leaves=4,
)


@pytest.mark.slow(kept_by="test_a_table_of_another_form_is_named_with_its_place")
@pytest.mark.parametrize("value", [5, "", [], {}, [[]], [{}], True, [["x", []]], {"x": [{}]}], ids=str)
def test_check_raises_of_no_value_anywhere(write: Write, value: Any) -> None:
    path = write(TABLES)
    for way in keys(GOOD):
        said_of(replaced(way, value), path)


@pytest.mark.slow(kept_by="test_a_table_of_another_form_is_named_with_its_place")
@given(way=st.sampled_from(list(keys(GOOD))), value=STRANGE)
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_check_raises_of_nothing_and_what_it_accepts_is_built(write: Write, way: Any, value: Any) -> None:
    path = write(TABLES)
    said_of(replaced(way, value), path)


def said_of(text: str, path: Path) -> None:
    found = check_text(text, path)
    assert all(one.cause for one in erring(found)), text
    if erring(found):
        return

    async def main() -> None:
        async with Kernel() as kernel:
            await build(kernel, parse(text, path))

    simulate(main())


def test_a_component_file_that_is_a_link_is_called_one(write: Write, tmp_path_factory: pytest.TempPathFactory) -> None:
    path = write(TABLES.replace("parts.py:Sink", "linked.py:Sink"))
    there = tmp_path_factory.mktemp("elsewhere") / "parts.py"
    there.write_text("")
    link = path.parent / "linked.py"
    link.symlink_to(there)
    (found,) = erring(check(path))
    assert found.cause == f"'linked.py': {link} is a link to {there}, outside the system file's folder"
    assert found.remedy == "put the file itself below it"


@pytest.mark.parametrize(
    ("old", "new", "quoted"),
    [
        ('to = "hand.input"', 'to = "two.inptu"', '"two.inptu"'),
        ("rate = 10.0", "raet = 10.0", "raet"),
        ('members = ["arm", "sink"]', 'members = ["arm"]', '"sink"'),
    ],
)
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_what_is_refused_when_it_is_built_is_quoted_as_check_does(
    write: Write, old: str, new: str, quoted: str, end: str
) -> None:
    path = write("")
    path.write_bytes(TABLES.replace(old, new).replace("\n", end).encode())
    with pytest.raises(AiortsError) as caught:
        prepare(load(path))
    typed = caught.value.typed
    assert typed is not None
    assert typed.text[typed.start : typed.end] == quoted


def test_a_condition_that_stands_alone_has_no_number(write: Write) -> None:
    path = write(TABLES.replace('after = ["arm active", "sink"]', 'after = "snik active"'))
    (found,) = erring(check(path))
    assert (found.where, found.remedy) == ("components.source.start.after", "did you mean 'sink'?")
