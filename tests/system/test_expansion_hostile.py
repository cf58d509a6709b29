"""Files that would grow without end are refused at once, and no text gives anything but a system or a named error."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts.errors import SystemFileError
from aiorts.system import AS_WRITTEN, Choices, load
from aiorts.system.expansion.expand import expand
from aiorts.system.file.parse import read
from aiorts.system.text.origins import Source
from aiorts.system.text.places import places_of
from aiorts.system.text.toml import LARGEST
from campaign import cases, time_limit

SECONDS = 5.0
"""Within which a file is refused, on a machine that others use too; it takes less than one."""


def refused_at_once(path: Path) -> str:
    begin = time.perf_counter()
    with pytest.raises(SystemFileError) as error:
        load(path)
    assert time.perf_counter() - begin < SECONDS
    return str(error.value)


def doubling(count: int, form: str) -> str:
    table = "\n".join(f"v{n} = {form.replace('X', f'${{v{n - 1}}}')}" for n in range(1, count))
    return (
        f'schema = 1\n[variables]\nv0 = ["x"]\n{table}\n'
        if "[" in form
        else (f'schema = 1\n[variables]\nv0 = "x"\n{table}\n')
    )


@pytest.mark.slow(kept_by="first")
@pytest.mark.fault("F01")
@pytest.mark.parametrize(
    ("text", "message"),
    [
        (doubling(60, '"XX"'), "has more than 1048576 characters"),
        (doubling(60, '["X", "X"]'), "has more than 1048576 characters"),
        (doubling(2000, '["X"]'), "nested deeper than 32 levels"),
        ('schema = 1\n[components."a{i}"]\nrepeat = 1000000000\ntype = "a"\n', "a whole number 0..10000"),
        ('schema = 1\n[components."a{i}"]\nrepeat = 10000\ntype = "' + "x" * 1000 + '"\n', "has more than 1048576"),
        ('schema = 1\n[[connections]]\nrepeat = 10000\nfrom = "' + "x" * 1000 + '"\n', "has more than 1048576"),
        (
            'schema = 1\n[variables]\nv = ["'
            + "x" * 60_000
            + '"]\n'
            + "".join(f'[components.a{n}]\ntype = "a"\nparams.p = "${{v}}"\n' for n in range(1000)),
            "has more than 1048576",
        ),
        (
            'schema = 1\n[components."a{i}"]\nrepeat = 3000\ntype = "a"\n'
            + "".join(f'[contexts.c{n}]\nmembers = ["a{{i}}"]\n' for n in range(5000)),
            "has more than 1048576",
        ),
        ("schema = 1\ninclude = [" + ",".join(f'"a{n}.toml"' for n in range(20_000)) + "]\n", "cannot be read"),
        ("schema = 1\n" + "".join(f'[components.a{n}]\ntype = "${{v}}"\n' for n in range(20_000)), "unknown variable"),
        (
            "schema = 1\n[variables]\n"
            + "".join(f"v{n} = 1\n" for n in range(50_000))
            + "".join(f'[components.a{n}]\ntype = "${{w{n}}}"\n' for n in range(300)),
            "unknown variable",
        ),
    ],
    ids=lambda text: text[:30] if text.startswith(("has", "nest", "a wh", "unk")) else "",
)
def test_what_grows_without_end_is_refused_at_once(write: Callable[..., Path], text: str, message: str) -> None:
    assert message in refused_at_once(write(text))


@pytest.mark.slow(kept_by="system/test_include.py::test_what_is_wrong_is_said_where_it_stands")
@pytest.mark.fault("F01")
def test_files_that_include_each_other_many_times_are_refused_at_once(put: Callable[..., Path]) -> None:
    def many(name: str) -> str:
        return "".join(f'[[include]]\nfile = "{name}.toml"\nprefix = "p{n}_"\n' for n in range(10))

    files = {f"a{depth}": many(f"a{depth + 1}") for depth in range(10)}
    message = refused_at_once(put(**files, a10='[components.a]\ntype = "a"\n'))
    assert "more than 1000 files are included; include less" in message
    chain = {f"b{depth}": f'include = ["b{depth + 1}.toml"]\n' for depth in range(20)}
    assert "more than 16 files include each other" in refused_at_once(put(**chain, b20=""))
    large = "# " + "x" * 100_000 + "\n"
    message = refused_at_once(put(robot=many("large") * 2, large=large))
    assert "have more than 1048576 characters together, each as often as it is" in message


def test_a_part_that_is_left_out_does_not_include_without_end(put: Callable[..., Path]) -> None:
    path = put(robot='[[include]]\nfile = "robot.toml"\nif = false\nprefix = "a"\n')
    assert load(path).components == {}


@pytest.mark.slow(kept_by="system/test_repeat.py::test_what_is_repeated_is_as_if_each_were_written_out")
def test_as_much_as_is_allowed_is_expanded(write: Callable[..., Path]) -> None:
    text = """\
schema = 1
[components."a{i}"]
repeat = 1000
type = "parts.py:Middle"
[[connections]]
repeat = 999
from = "a{i}.output"
to = "a{i+1}.input"
[[connections]]
repeat = 998
from = "a{i}.output"
to = "a{i+2}.input"
[contexts.loop]
kind = "event"
members = ["a{i}"]
"""
    system = load(write(text))
    assert (len(system.components), len(system.connections)) == (1000, 1997)
    assert len(system.contexts["loop"].members) == 1000
    assert len(system.text) < LARGEST


PIECES = st.sampled_from(
    [
        *(
            "${a}",
            "${b}",
            "$${a}",
            "${",
            "}",
            "{i}",
            "{i+1}",
            "{i-1}",
            "{{i}}",
            "$",
            "{",
            "not ",
            "a",
            "b",
            ".",
            "x",
            " ",
        ),
        *("active", ",", "|", "*", "{port}", "é", "\n", "left_", "x.toml", "main.toml"),
    ]
)
TEXTS = st.lists(PIECES, max_size=4).map("".join)
NAMES = st.one_of(st.sampled_from(["a", "b", "a{i}", "a{i+1}", "${a}", "${a}{i}"]), TEXTS)
SCALARS = st.one_of(TEXTS, st.booleans(), st.integers(-2, 5), st.sampled_from([1e9, 10**9, -0.5]))
VALUES = st.one_of(SCALARS, st.lists(st.one_of(SCALARS, st.lists(SCALARS, max_size=2)), max_size=3))
SWITCHES = st.fixed_dictionaries({}, optional={"if": VALUES, "repeat": VALUES})


def table(**keys: st.SearchStrategy[object]) -> st.SearchStrategy[dict[str, object]]:
    own = st.fixed_dictionaries({}, optional=keys)
    return st.tuples(own, SWITCHES).map(lambda both: {**both[0], **both[1]})


START = st.fixed_dictionaries({"after": VALUES})
PORTS = st.dictionaries(st.one_of(TEXTS, st.just("a.b")), st.one_of(TEXTS, st.just("b.c")), max_size=2)
INCLUDES = table(file=st.one_of(st.sampled_from(["x.toml", "main.toml", "y.toml"]), VALUES), prefix=NAMES, remap=PORTS)
DOCUMENTS = st.fixed_dictionaries(
    {"schema": st.just(1)},
    optional={
        "include": st.one_of(
            VALUES, st.lists(st.one_of(st.sampled_from(["x.toml", "main.toml"]), INCLUDES), max_size=2)
        ),
        "variables": st.one_of(VALUES, st.dictionaries(st.sampled_from(["a", "b", "env", "x y"]), VALUES, max_size=3)),
        "components": st.one_of(
            VALUES, st.dictionaries(NAMES, st.one_of(VALUES, table(type=TEXTS, params=PORTS, start=START)), max_size=3)
        ),
        "composites": st.dictionaries(
            NAMES, table(members=VALUES, groups=VALUES, exported=st.one_of(VALUES, PORTS)), max_size=2
        ),
        "connections": st.one_of(VALUES, st.lists(table(**{"from": VALUES, "to": VALUES, "name": VALUES}), max_size=3)),
        "contexts": st.dictionaries(NAMES, st.one_of(VALUES, table(kind=VALUES, members=VALUES)), max_size=2),
        "rules": st.one_of(VALUES, table(rules=VALUES), st.lists(table(**{"from": VALUES, "to": VALUES}), max_size=2)),
        "plugins": st.one_of(VALUES, st.fixed_dictionaries({"path": VALUES})),
        "clock": st.one_of(VALUES, table(kind=TEXTS)),
    },
)


def toml(value: object) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(key)} = {toml(one)}" for key, one in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    return json.dumps(value)


def as_text(document: dict[str, object]) -> str:
    return "".join(f"{key} = {toml(value)}\n" for key, value in document.items())


@pytest.mark.slow(kept_by="system/test_repeat.py::test_a_part_that_is_wrong_says_so")
@pytest.mark.fault("F01")
@pytest.mark.timeout(time_limit(900))
@settings(max_examples=cases(10_000), deadline=None)
@given(DOCUMENTS, DOCUMENTS, st.lists(st.tuples(st.sampled_from(["a", "b"]), TEXTS), max_size=2))
def test_any_text_gives_a_system_or_a_named_mistake_with_its_place(
    main: dict[str, object], other: dict[str, object], chosen: list[tuple[str, str]]
) -> None:
    files = {"main.toml": as_text(main), "x.toml": as_text(other)}

    def fetch(path: Path) -> tuple[Path, str]:
        if path.name not in files:
            raise SystemFileError(f"{path}: cannot be read")
        return path, files[path.name]

    source = Source(Path("main.toml"), files["main.toml"])
    choices = Choices(tuple(f"{name}={value}" for name, value in chosen), ("a.b=b.c",)) if chosen else AS_WRITTEN
    found = expand(source, choices, {"a": "1"}, fetch)
    for mistake in found.mistakes:
        if not mistake.typed:
            spot = mistake.spot(found.origins)
            lines = files[spot.source.path.name].split("\n")
            assert 1 <= spot.place.line <= len(lines)
            assert spot.place.column + spot.place.width <= len(lines[spot.place.line - 1]) + 2
        assert mistake.what
    if found.mistakes:
        assert found.top == {}
        return
    if "{i" in "".join(name for entries in found.top.values() if isinstance(entries, dict) for name in entries):
        return  # no name of a part, as the next who reads it says
    again = expand(Source(Path("again.toml"), found.text), AS_WRITTEN, {}, fetch)
    assert again.mistakes == ()
    assert again.top == found.top  # nothing is left to be expanded
    for name in ("components", "composites", "connections", "contexts"):
        entries = found.top.get(name, {})
        for key in entries if isinstance(entries, dict) else range(len(entries)) if isinstance(entries, list) else ():
            origin = found.origins.of((name, key))
            assert places_of(origin.source.text).known(origin.key) == origin.key
    read(found.text, Path("again.toml"))  # it names what is wrong, and raises nothing
