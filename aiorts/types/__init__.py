"""Everything that travels between ports: records, how to declare and find them, conversion, field paths, plain data."""

from __future__ import annotations

from collections.abc import Callable as _Callable

from aiorts.late import provide as _provide
from aiorts.types import basic as _basic
from aiorts.types import extended as _extended
from aiorts.types import extra as _extra
from aiorts.types import interface as _interface
from aiorts.types import registry as _registry
from aiorts.types import samples as _samples
from aiorts.types import spelling as _spelling
from aiorts.types import structure as _structure
from aiorts.types.basic import *
from aiorts.types.convert import convert
from aiorts.types.extended import *
from aiorts.types.extra import *
from aiorts.types.interface import *
from aiorts.types.paths import path_type, read_path
from aiorts.types.plain import from_plain, to_plain
from aiorts.types.record import Stamped, field, record, zero
from aiorts.types.registry import *
from aiorts.types.rows import RecordArray
from aiorts.types.samples import *
from aiorts.types.spelling import *
from aiorts.types.stamps import Time
from aiorts.types.structure import *

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
    "RecordArray",
    "Time",
]
__all__ += _basic.__all__
__all__ += _extended.__all__
__all__ += _extra.__all__
__all__ += _interface.__all__
__all__ += _registry.__all__
__all__ += _samples.__all__
__all__ += _spelling.__all__
__all__ += _structure.__all__


def _ros(kind: str) -> _Callable[[str], object]:
    from aiorts.types.ros.names import names

    return names


_provide(("ros",), _ros)
