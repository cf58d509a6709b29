"""Everything that travels between ports: records, how to declare and find them, conversion, field paths, plain data."""

from __future__ import annotations

from collections.abc import Callable as _Callable

from aiorts.late import provide as _provide
from aiorts.types import basic as _basic
from aiorts.types import extended as _extended
from aiorts.types import extra as _extra
from aiorts.types import interface as _interface
from aiorts.types.basic import *
from aiorts.types.convert import convert
from aiorts.types.extended import *
from aiorts.types.extra import *
from aiorts.types.interface import *
from aiorts.types.paths import path_type, read_path
from aiorts.types.plain import from_plain, to_plain
from aiorts.types.record import Stamped, field, record, zero
from aiorts.types.registry import all_types, find_type, full_name, type_name, wire_name, wire_type
from aiorts.types.rows import RecordArray
from aiorts.types.samples import check_port_type, check_shape, detached, has_tm, is_mutable, snapshot, with_tm
from aiorts.types.spelling import (
    EMPTY,
    Array,
    Map,
    NDArray,
    Rows,
    Seq,
    char,
    f32,
    f64,
    i8,
    i16,
    i32,
    i64,
    u8,
    u16,
    u32,
    u64,
    wchar,
    wstr,
)
from aiorts.types.stamps import Time
from aiorts.types.structure import Field, Structure, describe, fields_of, units_of

__all__ = [
    "convert",
    "path_type",
    "read_path",
    "from_plain",
    "to_plain",
    "Stamped",
    "field",
    "record",
    "zero",
    "all_types",
    "find_type",
    "full_name",
    "type_name",
    "wire_name",
    "wire_type",
    "RecordArray",
    "check_port_type",
    "check_shape",
    "has_tm",
    "is_mutable",
    "snapshot",
    "with_tm",
    "Array",
    "EMPTY",
    "Map",
    "NDArray",
    "Rows",
    "Seq",
    "char",
    "f32",
    "f64",
    "i8",
    "i16",
    "i32",
    "i64",
    "u8",
    "u16",
    "u32",
    "u64",
    "wchar",
    "wstr",
    "Time",
    "Field",
    "Structure",
    "describe",
    "detached",
    "fields_of",
    "units_of",
]
__all__ += _basic.__all__
__all__ += _extended.__all__
__all__ += _extra.__all__
__all__ += _interface.__all__


def _ros(kind: str) -> _Callable[[str], object]:
    from aiorts.types.ros.names import names

    return names


_provide(("ros",), _ros)
