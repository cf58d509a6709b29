"""What a port knows about the type that travels: decided when the port is bound, asked on the general path only."""

from __future__ import annotations

from dataclasses import is_dataclass
from typing import Any
from weakref import WeakKeyDictionary

__all__ = ("PortType", "port_type")


class PortType:
    """The checks and copies that a port's type asks for.

    Raises:
        DeclarationError: a value of this type cannot travel.
    """

    __slots__ = ("_plain", "has_tm", "mutable")

    def __init__(self, cls: type[Any]) -> None:
        from aiorts.types import check_port_type, has_tm, is_mutable

        check_port_type(cls)
        self.mutable = is_mutable(cls)
        self.has_tm = has_tm(cls)
        self._plain = None if is_dataclass(cls) else cls

    def check_shape(self, sample: Any, shape: tuple[int, ...]) -> None:
        """Raise RecordError unless the sample's data has this shape."""
        from aiorts.types import check_shape

        check_shape(sample, shape)

    def snapshot(self, sample: Any) -> Any:
        """An immutable copy of a mutable sample; the sample itself when it cannot change.

        A subclass of a plain type (numpy's float64 is a float) travels as the plain value.
        """
        from aiorts.types import is_mutable, snapshot

        if self._plain is not None:
            return self._plain(sample)
        return snapshot(sample) if is_mutable(sample.__class__) else sample

    def copy(self, sample: Any) -> Any:
        """A copy that shares nothing the writer could still change."""
        from aiorts.types import detached

        return detached(self.snapshot(sample))

    def stamped(self, sample: Any, tm: int) -> Any:
        """A copy with another time stamp."""
        from aiorts.types import with_tm

        return with_tm(sample, tm)


_KNOWN: WeakKeyDictionary[type[Any], PortType] = WeakKeyDictionary()


def port_type(cls: type[Any]) -> PortType:
    """What ports of this type know about it, made once.

    Raises:
        DeclarationError: a value of this type cannot travel.
    """
    if not isinstance(cls, type):
        return PortType(cls)  # says what is wrong
    known = _KNOWN.get(cls)
    if known is None:
        known = _KNOWN[cls] = PortType(cls)
    return known
