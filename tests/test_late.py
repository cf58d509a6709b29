"""`aiorts.late`: a face has the names that type checkers see, wherever its code lies; what a user sees of a frozen
value is what `dataclasses.dataclass` makes.
"""

from __future__ import annotations

import compileall
import copy
import dataclasses
import importlib
import inspect
import pickle
import sys
from dataclasses import field
from pathlib import Path
from threading import Thread
from typing import ClassVar
from zipfile import ZipFile

import pytest

from aiorts.late import dataclass

FACE = '''"""A face."""

from __future__ import annotations

from typing import TYPE_CHECKING
from aiorts.late import late as _late

if TYPE_CHECKING:
    from typing import Any as _Any

    from {package}.first import NUMBER, Thing as Renamed

__all__ = ("NUMBER", "Renamed")

_late("second")

REST = __name__
'''


@pytest.mark.parametrize("form", ["sources", "zip", "bytecode"])
def test_a_face_imports_its_names_one_by_one_wherever_it_lies(
    form: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = f"late_face_of_{form}"
    folder = tmp_path / package
    folder.mkdir()
    (folder / "__init__.py").write_text(FACE.format(package=package), encoding="utf-8")
    (folder / "first.py").write_text("NUMBER = 1\nclass Thing: pass\n", encoding="utf-8")
    (folder / "second.py").write_text("", encoding="utf-8")
    place = tmp_path
    if form != "sources":
        compileall.compile_dir(folder, quiet=1, legacy=True)
    if form == "zip":
        place = tmp_path / "all.zip"
        with ZipFile(place, "w") as archive:
            for path in folder.glob("*.py"):
                archive.write(path, f"{package}/{path.name}")
    if form != "sources":
        for path in folder.glob("*.py"):
            path.unlink()
    monkeypatch.syspath_prepend(str(place))

    face = importlib.import_module(package)
    assert {"NUMBER", "REST", "Renamed", "second"} <= set(dir(face))
    assert not {"Any", "_Any", "Thing"} & set(dir(face))
    assert (face.REST, f"{package}.first" in sys.modules) == (package, False)
    assert (face.NUMBER, face.Renamed.__name__, f"{package}.second" in sys.modules) == (1, "Thing", False)
    assert face.second.__name__ == f"{package}.second"
    with pytest.raises(AttributeError, match=f"module '{package}' has no attribute 'Thing'"):
        face.Thing  # noqa: B018 - asks for it


@dataclass(frozen=True, slots=True)
class Base:
    """A value."""

    quiet: ClassVar[bool] = False
    number: int = field(default=0, compare=False, repr=False, kw_only=True)


@dataclass(frozen=True, slots=True)
class Place(Base):
    """A value derived from another."""

    room: str
    seats: tuple[int, ...] = field(default_factory=tuple)


@dataclasses.dataclass(frozen=True, slots=True)
class Derived(Place):
    """What a user derives with the standard decorator."""

    floor: int = 1


@dataclass(slots=True)
class Counter:
    """A value that changes."""

    count: int = 0


@dataclass(frozen=True, slots=True, order=True)
class Ordered:
    """A value that can be sorted."""

    first: int


def test_a_late_dataclass_answers_as_one_of_the_standard_library() -> None:
    place = Place("hall", number=3)
    assert repr(place) == "Place(room='hall', seats=())"
    assert place == Place("hall", ()) != Place("yard")
    assert hash(place) == hash(Place("hall"))
    assert [one.name for one in dataclasses.fields(Place)] == ["number", "room", "seats"]
    assert dataclasses.asdict(place) == {"number": 3, "room": "hall", "seats": ()}
    assert dataclasses.replace(place, room="yard").room == "yard"
    assert str(inspect.signature(Place)).startswith("(room: 'str', seats: 'tuple[int, ...]' = <factory>, *, number")
    assert Derived("hall", floor=2).floor == 2
    assert Derived("hall").room == "hall"
    assert Ordered(1) < Ordered(2)
    match place:
        case Place(room, seats):
            assert (room, seats) == ("hall", ())
    with pytest.raises(TypeError, match="missing 1 required positional argument: 'room'"):
        Place()  # type: ignore[call-arg]


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))])
def test_a_late_dataclass_can_be_copied_and_pickled(copied: object) -> None:
    place = copied(Place("hall", (1, 2), number=4))  # type: ignore[operator]
    assert place == Place("hall", (1, 2))
    assert place.number == 4


@pytest.mark.parametrize("name", ["room", "number", "quiet", "unknown"])
def test_a_frozen_value_refuses_every_assignment(name: str) -> None:
    place = Place("hall")
    with pytest.raises(dataclasses.FrozenInstanceError, match=f"cannot assign to field '{name}'"):
        setattr(place, name, "x")
    with pytest.raises(dataclasses.FrozenInstanceError, match=f"cannot delete field '{name}'"):
        delattr(place, name)
    assert not hasattr(place, "__dict__")


def test_one_that_is_not_frozen_changes_and_has_no_hash() -> None:
    counter = Counter()
    counter.count += 1
    assert counter == Counter(1)
    with pytest.raises(TypeError, match="unhashable"):
        hash(counter)


@pytest.mark.slow
def test_many_threads_make_the_first_instances_of_a_class() -> None:
    for _ in range(50):

        @dataclass(frozen=True, slots=True)
        class ProfileSnapshot(Base):
            """Written by whoever comes first."""

            room: str

        made: list[object] = []
        threads = [Thread(target=lambda: made.append(ProfileSnapshot("hall"))) for _ in range(4)]  # noqa: B023
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(5)
        assert made == [ProfileSnapshot("hall")] * 4
