"""Messages of ROS 2 as parts that become records: definitions are read, checked, and only then used to decode.

The decoding is done by `rosbags` (pip install "aiorts[ros]"), loaded when it is needed. It was chosen since it gives
the fields of a definition, by which records are chosen, reads definitions in IDL as well as in .msg, and knows those of
the distributions, which older .db3 files do not hold. Measured in comparison, `mcap-ros2-support` 0.6.0 took 48 us for
an Imu (rosbags 0.11.9: 17 us) and 481 us for a LaserScan of 1,000 ranges (10 us), reads a char above 127 as negative,
and gives no types. The file readers of `rosbags` are not used: they verify no checksum and read YAML.

`rosbags` makes Python code of a definition and runs it. So only names of letters, digits and
underscores, and lists of a bounded length, are passed to it; the values of constants are not.
"""

from __future__ import annotations

import dataclasses
import re
import struct
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final

import numpy as np

from aiorts.errors import RecordError
from aiorts.types import TimedLongLong, TimedLongLongSeq, TimedNDArray
from aiorts_log.foreign.ros_records import library, maker, record_of, ros_name, standard_types, with_nested
from aiorts_log.foreign.ros_types import (
    FIELDS,
    LISTS,
    PARTS,
    PARTS_OF_FIELDS,
    SCALARS,
    TIMES,
    Column,
    Get,
    array_of,
    nanoseconds,
    scalar_of,
)

_BASE: Final = 1
_NAME: Final = 2
_ARRAY: Final = 3
_HEADER: Final = "std_msgs/msg/Header"
_LONGEST: Final = 262_144
"""Characters of a definition with all that it uses."""
_MOST_FIELDS: Final = 4_096
_UNROLLED: Final = 1_000
"""The most texts or messages of a list of fixed length: `rosbags` writes a line of code for each."""
_DEEPEST: Final = 20
_PACKED: Final = b"\x28\xb5\x2f\xfd"
"""The first bytes of what zstd compressed; no message in CDR begins with them."""
_TYPE: Final = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,99}(/[A-Za-z][A-Za-z0-9_]{0,99}){1,2}", re.ASCII)
_FIELD: Final = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,99}", re.ASCII)


class Unmapped(ValueError):
    """The reason why a part of another system's recording does not become records."""


class Messages:
    """Decodes the messages of one type.

    Args:
        name: the type's name ("sensor_msgs/msg/Imu").
        schema_format: of the definition: "ros2msg", "ros2idl", or "" for a type of the ROS 2 distributions.
        definition: its text, with all that it uses.
        whole: make one record of a message whose type has a record.

    Attributes:
        columns: the parts that become a port each; a path of "" is the message itself.
        left: by field, the reason why it becomes no port.

    Raises:
        Unmapped: the definition cannot be used.
        MissingExtra: the library is not installed.
    """

    def __init__(self, name: str, schema_format: str, definition: str, whole: bool = True) -> None:
        self._typesys, serde = library()
        self._faults = (
            *(serde.SerdeError, ValueError, KeyError, IndexError, TypeError, AssertionError, struct.error),
            *(AttributeError, RecursionError, OverflowError, MemoryError),
        )
        self.name = name if name.count("/") != 1 else name.replace("/", "/msg/")
        self._store = self._registered(schema_format, definition)
        self.columns: list[Column] = []
        self.left: dict[str, str] = {}
        self.stamped = False
        if whole and (cls := self._record()) is not None:
            self.columns = [Column("", cls, maker(cls))]
            return
        for field, attribute, desc in self._fields(self.name):
            if (field, desc) == ("header", (_NAME, _HEADER)) and self._is_header():
                self.stamped = True
                continue
            get = _attribute(attribute)
            self._add(field, desc, get, PARTS_OF_FIELDS.get((self.name, field)))
        well_known = self._whole(self.name)
        if well_known:
            self.columns = list(well_known)
        if len(self.columns) == 1 and not self.left:
            self.columns = [self.columns[0]._replace(path="")]

    def decode(self, data: bytes) -> Any:
        """Decode a message. Unmapped when the bytes are no message of the type."""
        if data[:4] == _PACKED:
            raise Unmapped("its messages are compressed one by one; ros2 bag convert unpacks them")
        try:
            return self._store.deserialize_cdr(data, self.name)
        except self._faults as error:
            raise Unmapped(f"no {self.name}: {type(error).__name__}: {str(error)[:80]}") from None

    def time(self, message: Any) -> int | None:
        """The message's time stamp in ns; None when it has none."""
        return nanoseconds(message.header.stamp) if self.stamped else None

    def frame(self, message: Any) -> str | None:
        """The name of the message's frame; None when it has none."""
        return str(message.header.frame_id) if self.stamped else None

    def parts(self, message: Any, lose: Callable[[str, str], None], topic: str) -> Iterator[tuple[str, type, Any]]:
        """Path, record type and data of each part that becomes a sample; calls `lose` for parts that become no sample.

        The data of a message that becomes one record are that record.
        """
        for column in self.columns:
            try:
                yield column.path, column.cls, column.get(message)
            except (ValueError, OverflowError, RecordError) as error:
                lose(f"{topic} {column.path}".rstrip(), str(error)[:120])

    def _record(self) -> type | None:
        """The record of the type, if the type and all within it are ROS 2's own: a file may give any type its name."""
        cls = record_of(self.name)
        standard, own = standard_types().fielddefs, self._store.fielddefs
        names = () if cls is None else map(ros_name, with_nested(cls))
        return cls if all(name in own and own[name][1] == standard[name][1] for name in names) else None

    def _registered(self, schema_format: str, definition: str) -> Any:
        typesys = self._typesys
        if not _TYPE.fullmatch(self.name):
            raise Unmapped(f"{self.name[:60]!r} is no name of a type")
        try:
            if not schema_format:
                store = standard_types()
                if self.name not in store.fielddefs:
                    raise Unmapped("the file does not hold its definition; record it with ROS 2 Iron or later")
                return store
            if len(definition) > _LONGEST:
                raise Unmapped(f"its definition has {len(definition)} characters; at most {_LONGEST} are read")
            if schema_format == "ros2msg":
                found = typesys.get_types_from_msg(definition, self.name)
            elif schema_format == "ros2idl":
                found = typesys.get_types_from_idl(definition)
            else:
                raise Unmapped(f"definitions in {schema_format[:20]!r} are not read; only ros2msg and ros2idl are")
            store = typesys.get_typestore(typesys.Stores.EMPTY)
            store.register(_checked(found))
        except (typesys.TypesysError, *self._faults) as error:
            if isinstance(error, Unmapped):
                raise
            raise Unmapped(f"its definition is not understood: {str(error)[:80]}") from None
        if self.name not in store.fielddefs:
            raise Unmapped("its definition is of another type")
        return store

    def _fields(self, name: str) -> Iterator[tuple[str, str, Any]]:
        """Fields of a type: name, attribute of the decoded message, and kind."""
        if name not in self._store.fielddefs:
            raise Unmapped(f"type {name[:60]} is not defined")
        fields = self._store.fielddefs[name][1]
        attributes = [one.name for one in dataclasses.fields(self._store.types[name])]
        for (field, desc), attribute in zip(fields, attributes, strict=False):
            if field != "structure_needs_at_least_one_member":
                yield field, attribute, (int(desc[0]), desc[1])

    def _is_header(self) -> bool:
        fields = [(field, desc) for field, _, desc in self._fields(_HEADER)]
        return fields[:1] == [("stamp", (_NAME, TIMES[0]))] and len(fields) == 2 and fields[1][0] == "frame_id"

    def _whole(self, name: str) -> tuple[Column, ...]:
        """The columns of a well-known type, if it has the fields of that type."""
        return PARTS[name] if name in PARTS and tuple(self._numbers(name)) == FIELDS[name] else ()

    def _numbers(self, name: str) -> Iterator[str]:
        """Paths of all fields of a type that consists of floating-point numbers; "" for a field of another kind."""
        for field, _, (kind, what) in self._fields(name):
            if kind == _NAME:
                yield from (_joined(field, inner) for inner in self._numbers(what))
            else:
                yield field if kind == _BASE and what[0] in ("float32", "float64") else ""

    def _add(self, path: str, desc: Any, get: Get, special: tuple[Column, ...] | None = None, depth: int = 0) -> None:
        kind, what = desc
        if depth > _DEEPEST:
            self.left[path] = f"lies deeper than {_DEEPEST} messages"
        elif kind == _BASE:
            self._add_scalar(path, what[0], get)
        elif kind == _NAME and what in TIMES:
            self.columns.append(Column(path, TimedLongLong, lambda m: nanoseconds(get(m))))
        elif kind == _NAME:
            whole = self._whole(what)
            for part in special if special and whole else whole:
                self.columns.append(Column(_joined(path, part.path), part.cls, _chained(get, part.get)))
            for field, attribute, inner in () if whole else self._fields(what):
                self._add(_joined(path, field), inner, _chained(get, _attribute(attribute)), depth=depth + 1)
        else:
            item = (int(what[0][0]), what[0][1])
            if item[0] == _BASE:
                self._add_list(path, item[1][0], get)
            else:
                self._add_rows(path, item, get, lambda m: m, depth)

    def _add_scalar(self, path: str, kind: str, get: Get) -> None:
        if kind not in SCALARS:
            self.left[path] = f"{kind} has no record here"
            return
        self.columns.append(Column(path, SCALARS[kind], _chained(get, scalar_of(kind))))

    def _add_list(self, path: str, kind: str, get: Get) -> None:
        if kind not in LISTS:
            self.left[path] = f"a list of {kind} has no record here"
            return
        self.columns.append(Column(path, LISTS[kind][0], lambda m: array_of(kind, get(m))))

    def _add_rows(self, path: str, desc: Any, rows: Get, inside: Get, depth: int) -> None:
        """Add columns of a list of messages: `rows` gives the list, `inside` the value within each of them."""
        kind, what = desc
        if depth > _DEEPEST:
            self.left[path] = f"lies deeper than {_DEEPEST} messages"
        elif kind == _BASE and what[0] in LISTS:
            each = scalar_of(what[0])
            make = lambda m: array_of(what[0], [each(inside(row)) for row in rows(m)])  # noqa: E731
            self.columns.append(Column(path, LISTS[what[0]][0], make))
        elif kind == _NAME and what in TIMES:
            make = lambda m: np.array([nanoseconds(inside(row)) for row in rows(m)], "i8")  # noqa: E731
            self.columns.append(Column(path, TimedLongLongSeq, make))
        elif kind == _NAME:
            for field, attribute, inner in self._fields(what):
                self._add_rows(_joined(path, field), inner, rows, _chained(inside, _attribute(attribute)), depth + 1)
        elif kind == _ARRAY and int(what[0][0]) == _BASE and LISTS.get(what[0][1][0], (None, ""))[1]:
            code, length = LISTS[what[0][1][0]][1], what[1]
            make = lambda m: np.array([inside(row) for row in rows(m)], code).reshape(-1, length)  # noqa: E731
            self.columns.append(Column(path, TimedNDArray, make))
        else:
            self.left[path] = "a list within a list has no record here"


def _attribute(name: str) -> Get:
    return lambda m: getattr(m, name)


def _chained(first: Get, second: Get) -> Get:
    return lambda m: second(first(m))


def _joined(path: str, part: str) -> str:
    return f"{path}.{part}" if path and part else path or part


def _checked(types: Mapping[str, Any]) -> dict[str, Any]:
    """Definitions that code may be generated from: without constants; Unmapped for a name or length not allowed."""
    checked: dict[str, Any] = {}
    count = 0
    for name, (_, fields) in types.items():
        if not _TYPE.fullmatch(name):
            raise Unmapped(f"{name[:60]!r} is no name of a type")
        count += len(fields)
        if count > _MOST_FIELDS:
            raise Unmapped(f"it has more than {_MOST_FIELDS} fields")
        for field, desc in fields:
            if not _FIELD.fullmatch(field):
                raise Unmapped(f"{field[:60]!r} is no name of a field")
            _check_kind(field, desc, types, name)
        checked[name] = ([], fields)
    _check_depth(types)
    return checked


def _check_kind(field: str, desc: Any, types: Mapping[str, Any], within: str) -> None:
    kind, what = int(desc[0]), desc[1]
    if kind == _NAME:
        if not isinstance(what, str) or not _TYPE.fullmatch(what):
            raise Unmapped(f"field {field}: {str(what)[:60]!r} is no name of a type")
        if what not in types and what.rpartition("/")[2] == "wstring":
            raise Unmapped(f"field {field} of {within}: a wstring is not read")
        if what not in types and what not in TIMES:
            raise Unmapped(f"field {field} of {within}: type {what[:60]} is not defined")
    elif kind != _BASE:
        inner, length = what
        _check_kind(field, inner, types, within)
        if int(inner[0]) not in (_BASE, _NAME):
            raise Unmapped(f"field {field}: a list of lists is no type of ROS 2")
        plain = int(inner[0]) == _BASE and inner[1][0] != "string"
        if kind == _ARRAY and length > (2**24 if plain else _UNROLLED):
            raise Unmapped(f"field {field}: a list of {length} items; at most {2**24 if plain else _UNROLLED} are read")


def _check_depth(types: Mapping[str, Any]) -> None:
    """Refuse types that contain themselves, or are nested too deep."""
    depths: dict[str, int] = {}

    def depth(name: str, above: tuple[str, ...]) -> int:
        if name in above or len(above) > _DEEPEST:
            raise Unmapped(f"type {name[:60]} is within itself, or {_DEEPEST} deep")
        if name not in depths:
            names: list[str] = []
            for _, desc in types[name][1] if name in types else ():
                inner: Any = desc if int(desc[0]) in (_BASE, _NAME) else desc[1][0]
                if int(inner[0]) == _NAME:
                    names.append(inner[1])
            depths[name] = 1 + max((depth(one, (*above, name)) for one in names), default=0)
        return depths[name]

    for name in types:
        depth(name, ())
