"""Whatever values a wanted system has, its text is read back as the same system."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aiorts import Supervision
from aiorts.errors import ConfigurationError
from aiorts.model.configuration.sets import same
from aiorts.model.wanted.entries import ComponentEntry, ConnectionEntry, ContextEntry, Wanted
from aiorts.model.wanted.start_rules import StartRule
from aiorts.model.wanted.system_text import system_text
from aiorts.system import parse, wanted

FOLDER = Path(__file__).with_name("kinds")
KINDS = f"{FOLDER}/kinds.py:Kinds"


TEXTS = st.text(st.characters(exclude_categories=["Cs"]), max_size=8).filter(lambda text: text != "usual")
FLOATS = st.floats(allow_nan=False).filter(lambda number: number not in (1.0, 2.0))
VALUES: dict[str, st.SearchStrategy[Any]] = {
    "flag": st.just(True),
    "size": st.integers(-(2**53), 2**53).filter(lambda number: number != 3),
    "gain": FLOATS,
    "text": TEXTS,
    "colour": st.just("BLUE"),
    "names": st.lists(TEXTS, max_size=3).map(tuple),
    "pair": st.tuples(st.integers(5, 9), FLOATS),
    "table": st.dictionaries(TEXTS, FLOATS, max_size=3).filter(lambda table: table != {"a": 1.0}),
    "maybe": FLOATS | st.just("none"),
}
NAMES = st.from_regex(r"[A-Za-z0-9_][A-Za-z0-9_-]{0,6}", fullmatch=True)
SETS = NAMES.filter(lambda name: name[0] != "_" and name != "default")
PARAMS = st.fixed_dictionaries({}, optional=VALUES)
OPTIONS = st.fixed_dictionaries(
    {},
    optional={
        "name": NAMES,
        "full": st.just("block"),
        "length": st.integers(1, 19),
        "timeout": st.sampled_from([None, 0.5]),
        "stamp": st.just("send"),
        "lifespan": st.sampled_from([0.5, 1e-6]),
        "x.y": TEXTS.filter(bool),
    },
)


@st.composite
def systems(draw: st.DrawFn) -> Wanted:
    names = draw(st.lists(NAMES, min_size=1, max_size=3, unique_by=str.lower))
    components = {
        name: ComponentEntry(
            name,
            KINDS,
            draw(PARAMS),
            sets=draw(st.dictionaries(SETS, PARAMS, max_size=2)),
            supervision=draw(st.sampled_from([None, Supervision("reset", deadlines={"on_execute": 0.5})])),
            start=draw(st.sampled_from([None, StartRule(name, wait=1.5)])),
        )
        for name in names
    }
    pairs = draw(st.sets(st.tuples(st.sampled_from(names), st.sampled_from(names)), max_size=3))
    connections = tuple(
        ConnectionEntry((f"{out}.out", f"{in_}.inp"), draw(OPTIONS), number)
        for number, (out, in_) in enumerate(sorted(pairs), start=1)
    )
    contexts = {"work": ContextEntry("work", "periodic", tuple(names), draw(st.booleans()), {"rate": 10.0})}
    return Wanted(components, connections, contexts, plugin_paths=(FOLDER,))


@pytest.mark.slow(kept_by="planning/test_save.py::test_what_a_program_made_is_saved_without_what_is_so_by_default")
@given(systems())
def test_what_is_written_is_read_back(system: Wanted) -> None:
    text = system_text(system, FOLDER)
    again = wanted(parse(text, FOLDER / "system.toml"))
    for name, one in system.components.items():
        other = again.components[name]
        assert (other.sets.keys(), other.supervision, other.start) == (one.sets.keys(), one.supervision, one.start)
        for values, others in [(one.params, other.params), *((one.sets[key], other.sets[key]) for key in one.sets)]:
            assert {key: value for key, value in values.items() if not same(_as(value), _as(others.get(key)))} == {}
    assert again.connections == system.connections
    assert again.contexts == system.contexts
    assert wanted(parse(once := system_text(again, FOLDER), FOLDER / "system.toml")) == again
    assert system_text(again, FOLDER) == once


def _as(value: Any) -> Any:
    """A mapping as a dict: `same` goes by the type."""
    return dict(value) if isinstance(value, Mapping) else value


def test_text_that_utf_8_does_not_have_is_refused() -> None:
    entry = ComponentEntry("a", KINDS, {"text": "\udc80"})
    with pytest.raises(ConfigurationError, match=r"a\.params\.text: cannot be saved"):
        system_text(Wanted({"a": entry}), FOLDER)
