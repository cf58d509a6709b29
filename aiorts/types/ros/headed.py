"""The common parts of ROS records: the time stamp in their header, and arrays of a fixed length."""

from __future__ import annotations

import dataclasses
from typing import Any, Self

from aiorts.errors import RecordError
from aiorts.types.record import Lazy, Stamped
from aiorts.types.ros.builtin_interfaces import Time
from aiorts.types.ros.std_msgs import Header


class Headed(Stamped):
    """Base of records with a `header`, whose stamp is their time stamp `tm`."""

    __slots__ = ()
    header: Header

    @property
    def tm(self) -> int:
        """The header's stamp in ns; 0, which means no time, for a stamp before 1970."""
        return max(0, self.header.stamp.ns)

    @property
    def frame_id(self) -> str:
        """The header's coordinate frame."""
        return self.header.frame_id

    def with_tm(self, tm: int) -> Self:
        """A copy with another time stamp, in ns; RecordError from 2**31 seconds on, which a header cannot hold."""
        header = Header(Time.from_ns(tm), self.header.frame_id)
        return dataclasses.replace(self, header=header)  # type: ignore[type-var]


def zeros(count: int) -> Any:
    """The default of an array: `count` zeros."""
    return Lazy(lambda: (0.0,) * count)


def check_length(record: Any, count: int, *names: str) -> None:
    """Raise RecordError unless each of these arrays of a record has `count` numbers."""
    for name in names:
        if (length := len(getattr(record, name))) != count:
            raise RecordError(f"{type(record).__qualname__}.{name}: expected {count} numbers, got {length}")
