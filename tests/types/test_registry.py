"""Dataclasses of users travel like built-in records; names are found, and never guessed."""

from __future__ import annotations

import sys
import types as stdlib_types
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Annotated, Any, ClassVar

import pytest

from aiorts.errors import DeclarationError, UnknownTypeError
from aiorts.types import (
    Point2D,
    Rows,
    Seq,
    TimedDouble,
    TimedString,
    check_port_type,
    f32,
    fields_of,
    find_type,
    full_name,
    has_tm,
    record,
    snapshot,
    type_name,
    u16,
    with_tm,
)
from aiorts.wire import MsgpackCodec

CODEC = MsgpackCodec()


class Mode(Enum):
    SLOW = "slow"
    FAST = "fast"


@dataclass
class Wheel:
    tm: int
    counts: Annotated[int, "not ours"]
    ticks: u16 = 0
    mode: Mode = Mode.SLOW
    places: Seq[Point2D] = ()  # type: ignore[assignment]
    history: list[float] = field(default_factory=list)
    pair: tuple[int, str] = (0, "")
    KIND: ClassVar[str] = "wheel"


@record
class Track:
    tm: int = 0
    points: Rows[Point2D] = ()  # type: ignore[assignment]
    width: f32 = 0.0


@pytest.mark.row(64)
def test_a_users_dataclass_travels_as_a_built_in_record_does() -> None:
    check_port_type(Wheel)
    assert [(f.name, f.spelling) for f in fields_of(Wheel)] == [
        ("tm", "stamp"), ("counts", "i64"), ("ticks", "u16"), ("mode", "Mode"),
        ("places", "seq[Point2D]"), ("history", "seq[f64]"), ("pair", "(i64, str)"),
    ]  # fmt: skip
    wheel = Wheel(5, -7, 3, Mode.FAST, (), [1.0, 2.0], (1, "x"))  # type: ignore[arg-type]
    received = CODEC.decode(CODEC.encode(wheel))
    assert (received.mode, received.history, received.pair) == (Mode.FAST, [1.0, 2.0], (1, "x"))
    assert type(received) is Wheel
    assert has_tm(Wheel)
    assert with_tm(wheel, 9) == replace(wheel, tm=9)
    assert find_type("Wheel") is Wheel
    assert find_type(full_name(Wheel)) is Wheel


@pytest.mark.row(64)
def test_classes_defined_in_a_function_travel() -> None:
    @dataclass(frozen=True)
    class Inner:
        x: float

    @dataclass(frozen=True)
    class Outer:
        tm: int
        inner: Inner

    @record
    class Checked:
        inner: Inner
        track: Track = Track()

    sample = Outer(1, Inner(2.0))
    assert CODEC.decode(CODEC.encode(sample)) == sample
    assert CODEC.decode(CODEC.encode(Checked(Inner(1.0)))) == Checked(Inner(1.0))
    assert full_name(Outer).endswith("test_classes_defined_in_a_function_travel.Outer")


@dataclass
class Changing:
    number: int = 0


def test_a_snapshot_does_not_take_the_place_of_the_class_it_is_of() -> None:
    sample = snapshot(Changing(3))
    assert fields_of(type(sample)) == fields_of(Changing)
    frame = CODEC.encode(sample)
    assert find_type(full_name(Changing)) is Changing
    assert MsgpackCodec().decode(frame) == Changing(3)


def _module(name: str) -> type:
    module = stdlib_types.ModuleType(name)
    sys.modules[name] = module
    namespace = {"__module__": name, "__qualname__": "Gauge", "__annotations__": {"value": float}}
    cls = record(type("Gauge", (), namespace))
    module.Gauge = cls  # type: ignore[attr-defined]
    return cls


@pytest.mark.row(64)
def test_name_that_two_modules_define_is_refused_with_both() -> None:
    first, second = _module("plant.sensors"), _module("robot.sensors")
    with pytest.raises(UnknownTypeError, match=r"plant\.sensors\.Gauge and robot\.sensors\.Gauge; write the full name"):
        find_type("Gauge")
    assert find_type("plant.sensors.Gauge") is first
    assert find_type("robot.sensors.Gauge") is second
    assert type_name(first) == "plant.sensors.Gauge"
    assert type_name(TimedDouble) == "TimedDouble"
    assert type(CODEC.decode(CODEC.encode(first(1.0)))) is first
    assert type(CODEC.decode(CODEC.encode(second(1.0)))) is second
    del sys.modules["plant.sensors"], sys.modules["robot.sensors"]


@pytest.mark.row(64)
def test_a_users_type_of_a_built_in_name_does_not_disturb_the_wire() -> None:
    frame = CODEC.encode(TimedString(1, "a"))
    own = record(type("TimedString", (), {"__module__": "own", "__annotations__": {"text": str}}))
    with pytest.raises(UnknownTypeError, match=r"aiorts\.types\.TimedString and own\.TimedString"):
        find_type("TimedString")
    assert type(CODEC.decode(frame)) is TimedString
    assert type(CODEC.decode(CODEC.encode(own("a")))) is own
    _forget(own)


def _forget(cls: type) -> None:
    """Take a name out of the registry again, for the sake of the other tests."""
    from aiorts.types import registry

    registry._by_short_name[cls.__name__].pop(full_name(cls))
    registry._by_full_name.pop(full_name(cls))


def test_unknown_name_hints_at_near_ones() -> None:
    with pytest.raises(UnknownTypeError, match=r"unknown type 'TimeDouble'; did you mean TimedDouble"):
        find_type("TimeDouble")
    with pytest.raises(UnknownTypeError, match="import the module that defines it"):
        find_type("os.system")
    assert find_type("float") is float


@pytest.mark.parametrize(
    ("annotation", "message"),
    [
        ("float | str", r"Bad\.value: float \| str has more than one type"),
        ("Any", r"Bad\.value: a value of type Any cannot travel"),
        ("list", r"Bad\.value: a value of type list cannot travel"),
        ("dict[int, str]", r"Bad\.value: a value of type dict\[int, str\] cannot travel"),
        ("object", r"Bad\.value: a value of type object cannot travel"),
        ("complex", r"Bad\.value: a value of type complex cannot travel"),
        (
            "Annotated[Seq[u16], 3]",
            r"Bad\.value: Annotated\[\.\.\., 3\]: .*__post_init__, write tuple\[float, ",
        ),
        ("Annotated[u16, (0.0, 1.0)]", r"Bad\.value: Annotated\[\.\.\., \(0\.0, 1\.0\)\]: aiorts does not know"),
        ("Annotated[float, 1] | None", r"Bad\.value: Annotated\[\.\.\., 1\]: aiorts does not know"),
        ("Missing", r"Bad: the name 'Missing' in its annotations cannot be found"),
    ],
)
def test_annotation_that_cannot_travel_is_refused_naming_the_field(annotation: str, message: str) -> None:
    cls = type("Bad", (), {"__module__": __name__, "__annotations__": {"value": annotation}})
    with pytest.raises(DeclarationError, match=message):
        check_port_type(dataclass(cls))
    with pytest.raises(DeclarationError, match=message):
        record(type("Bad", (), {"__module__": __name__, "__annotations__": {"value": annotation}}))


def test_what_another_library_asks_of_a_dataclass_is_its_own_and_of_a_record_refused() -> None:
    class Positive:
        """As Field(gt=0) is."""

    body = {"__module__": __name__, "__annotations__": {"value": Annotated[float, Positive(), "m"]}}
    check_port_type(dataclass(type("Theirs", (), dict(body))))
    with pytest.raises(DeclarationError, match=r"Ours\.value: Annotated\[\.\.\., .*Positive\(\.\.\.\)\]"):
        record(type("Ours", (), dict(body)))
    noted = record(type("Noted", (), {"__annotations__": {"value": Annotated[float, "m, from below"]}}))
    assert noted(2).value == 2.0  # type: ignore[call-arg]


def test_only_records_dataclasses_and_plain_types_can_be_port_types() -> None:
    for cls in (bool, int, float, str, bytes, TimedDouble, Wheel):
        check_port_type(cls)
    bad: Any
    for bad in (list, object, 3, None, Mode, "TimedDouble"):
        with pytest.raises(DeclarationError, match="cannot be the type of a port"):
            check_port_type(bad)


@dataclass
class Parent:
    children: list[Child]


@dataclass
class Child:
    parent: Parent


def test_record_that_contains_itself_is_refused() -> None:
    with pytest.raises(DeclarationError, match="cannot contain its own type"):
        check_port_type(Parent)
