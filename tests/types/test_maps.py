"""What a map declares of its values is held at the writer: of records and dataclasses, nested."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from itertools import count
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aiorts import Component, InPort, Kernel, OutPort
from aiorts.errors import AiortsError, RecordError
from aiorts.testing import simulated
from aiorts.types import Map, describe, record
from aiorts.types.samples import snapshot
from aiorts.wire import MsgpackCodec

CODEC = MsgpackCodec()
VALUES: dict[str, Any] = {
    "bool": st.booleans(),
    "int": st.integers(-(2**53), 2**53),
    "float": st.floats(allow_nan=False),
    "str": st.text(st.characters(exclude_categories=["Cs"]), max_size=5),
    "bytes": st.binary(max_size=5),
    "array": st.lists(st.floats(allow_nan=False), max_size=3).map(np.array),
    "map": st.dictionaries(st.text("ab", max_size=2), st.integers(0, 9), max_size=2),
}
DECLARED: dict[str, tuple[Any, frozenset[str]]] = {
    "bool": (bool, frozenset({"bool"})),
    "int": (int, frozenset({"int"})),
    "float": (float, frozenset({"float", "int"})),
    "str": (str, frozenset({"str"})),
    "bytes": (bytes, frozenset({"bytes"})),
    "floats": (list[float], frozenset({"array"})),
    "ints of maps": (dict[str, int], frozenset({"map"})),
    "text or int": (str | int, frozenset({"str", "int"})),
    "float or int": (float | int, frozenset({"float", "int"})),
    "int or map": (int | dict[str, int], frozenset({"int", "map"})),
    "optional": (int | None, frozenset({"int"})),
    "any": (Any, frozenset(VALUES)),
    "object": (object, frozenset(VALUES)),
}


_numbers = count()


def classes(annotation: Any) -> list[tuple[type, bool]]:
    """A record and dataclasses, each with a map of these values, alone and (True) within another map."""
    made: list[tuple[type, bool]] = []
    for inner in (dict[str, annotation], Mapping[str, annotation], dict[str, dict[str, annotation]]):
        space = {"__annotations__": {"data": inner}, "__module__": __name__}
        for decorate in (record, dataclasses.dataclass, dataclasses.dataclass(frozen=True)):
            nested = inner == dict[str, dict[str, annotation]]
            made.append((decorate(type(f"Sample{next(_numbers)}", (), dict(space))), nested))
    return made


CLASSES = {name: classes(annotation) for name, (annotation, _) in DECLARED.items()}


@pytest.mark.parametrize("name", DECLARED)
@given(data=st.data())
def test_a_value_is_taken_if_it_is_as_declared(name: str, data: st.DataObject) -> None:
    _, allowed = DECLARED[name]
    cls, nested = data.draw(st.sampled_from(CLASSES[name]))
    sort = data.draw(st.sampled_from(sorted(VALUES)))
    value = data.draw(VALUES[sort])
    given_map = {"outer": {"inner": value}} if nested else {"inner": value}
    if sort not in allowed:
        with pytest.raises(RecordError, match="inner") as refused:
            snapshot(cls(given_map))
        assert "data" in str(refused.value)
        return
    kept = snapshot(cls(given_map))
    found = kept.data["outer"]["inner"] if nested else kept.data["inner"]
    if sort == "int" and name in ("float or int", "text or int", "int or map"):
        assert type(found) is int
    assert np.array_equal(found, value) if sort == "array" else found == value
    again = CODEC.decode(CODEC.encode(kept), cls)
    assert describe(cls).fields[0].kind.same(again.data, kept.data)


def test_a_writer_is_refused_and_its_reader_gets_nothing() -> None:
    @dataclasses.dataclass
    class Sample:
        counts: dict[str, int]

    class Writer(Component):
        out = OutPort(Sample)

    class Reader(Component):
        into = InPort(Sample)

    @simulated
    async def run() -> None:
        async with Kernel() as kernel:
            writer, reader = await kernel.create(Writer), await kernel.create(Reader)
            await kernel.connect(writer.out, reader.into)
            with pytest.raises(AiortsError, match=r"Sample\.counts\['a'\].*got 'b'"):
                writer.out.write_nowait(Sample({"a": "b"}))  # type: ignore[dict-item]
            with pytest.raises(AiortsError, match=r"Sample\.counts\['a'\]"):
                await writer.out.write(Sample({"a": 1.5}))  # type: ignore[dict-item]
            assert not reader.into.is_new
            writer.out.write_nowait(Sample({"a": 1}))
            assert reader.into.read_nowait().counts == {"a": 1}

    run()


def test_a_map_that_declares_nothing_takes_what_can_travel() -> None:
    @record
    class Sample:
        data: Map

    assert dict(Sample({"a": 1, "b": "text", "c": {"d": 1.5}}).data) == {"a": 1, "b": "text", "c": {"d": 1.5}}
