"""The checks and copies that samples of a port's type need: chosen when the port is bound."""

from __future__ import annotations

from dataclasses import is_dataclass
from typing import Any
from weakref import WeakKeyDictionary


class PortType:
    """The checks and copies that a port's type asks for.

    Raises:
        DeclarationError: a value of this type cannot travel.
    """

    __slots__ = ("_plain", "has_tm", "look")

    def __init__(self, cls: type[Any]) -> None:
        from aiorts.types import check_port_type, has_tm
        from aiorts.types.samples import look_at

        check_port_type(cls)
        self.look = look_at(cls)
        """Makes, from a value of exactly this class, the value that travels; None: the value itself travels."""
        self.has_tm = has_tm(cls)
        self._plain = None if is_dataclass(cls) else cls

    def check_shape(self, sample: Any, shape: tuple[int, ...]) -> None:
        """Raise RecordError unless the sample's data has this shape."""
        from aiorts.types import check_shape

        check_shape(sample, shape)

    def snapshot(self, sample: Any) -> Any:
        """The sample as it may travel: checked, and a copy where it could still change.

        A subclass of a plain type (numpy's float64 is a float) travels as the plain value. RecordError: the
        sample does not match its type.
        """
        from aiorts.types import snapshot

        return snapshot(sample if self._plain is None else self._plain(sample))

    def copy(self, sample: Any) -> Any:
        """A copy that shares nothing the writer could still change."""
        from aiorts.types import detached

        return detached(self.snapshot(sample))

    def stamped(self, sample: Any, tm: int) -> Any:
        """A copy with another time stamp."""
        return stamped(sample, tm)


def stamped(sample: Any, tm: int) -> Any:
    """A copy of the sample with another time stamp."""
    from aiorts.types import with_tm

    return with_tm(sample, tm)


_KNOWN: WeakKeyDictionary[type[Any], PortType] = WeakKeyDictionary()


def port_type(cls: type[Any]) -> PortType:
    """The checks and copies for ports of this type, made once.

    Raises:
        DeclarationError: a value of this type cannot travel.
    """
    if not isinstance(cls, type):
        return PortType(cls)  # says what is wrong
    known = _KNOWN.get(cls)
    if known is None:
        known = _KNOWN[cls] = PortType(cls)
    return known
