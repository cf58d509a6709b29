"""What a port knows about the type that travels: decided when the port is bound, asked on the general path only."""

from __future__ import annotations

from copy import deepcopy
from typing import Any

__all__ = ("PortType",)


class PortType:
    """The checks and copies that a port's type asks for.

    Raises:
        DeclarationError: a value of this type cannot travel.
    """

    __slots__ = ("_shape", "mutable")

    def __init__(self, cls: type[Any], shape: tuple[int, ...] | None) -> None:
        from aiorts.types import check_port_type, is_mutable

        check_port_type(cls)
        self.mutable = is_mutable(cls)
        self._shape = shape

    def check_shape(self, sample: Any) -> None:
        """Raise RecordError unless the sample's data has the declared shape."""
        from aiorts.types import check_shape

        assert self._shape is not None  # noqa: S101 - asked only by ports that declare one
        check_shape(sample, self._shape)

    def snapshot(self, sample: Any) -> Any:
        """An immutable copy of a mutable sample; the sample itself when it cannot change."""
        from aiorts.types import is_mutable, snapshot

        return snapshot(sample) if is_mutable(sample.__class__) else sample

    def copy(self, sample: Any) -> Any:
        """A copy that shares nothing the writer could still change."""
        return deepcopy(sample)

    def stamped(self, sample: Any, tm: int) -> Any:
        """A copy with another time stamp."""
        from aiorts.types import with_tm

        return with_tm(sample, tm)
