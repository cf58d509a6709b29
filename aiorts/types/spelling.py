"""The annotations of a record's fields; nothing here checks anything.

Scalars are plain types with a tag (`f64` is a float to a type checker). The annotation of a sequence tells its type:
`Array[f64]` gives a numpy array, `Rows[Point3D]` an (n, k) array with record views, `Seq[str]` a tuple. To
type checkers alone these are descriptors, so that a field can accept a list and return an array.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Generic, TypeAlias, TypeVar, overload

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence  # noqa: F401 - in the texts below
    from typing import Self

    import numpy as np  # noqa: F401
    import numpy.typing as npt

    from aiorts.types.rows import RecordArray  # noqa: F401

__all__ = (
    "EMPTY",
    "Array",
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
)

T = TypeVar("T")
Given = TypeVar("Given")
Taken = TypeVar("Taken")


class Tag(str):
    """Names a kind inside `Annotated`; its class tells it from the metadata of other libraries."""

    __slots__ = ()


i8: TypeAlias = Annotated[int, Tag("i8")]
"""An integer of 8 bits."""
i16: TypeAlias = Annotated[int, Tag("i16")]
"""An integer of 16 bits."""
i32: TypeAlias = Annotated[int, Tag("i32")]
"""An integer of 32 bits."""
i64: TypeAlias = Annotated[int, Tag("i64")]
"""An integer of 64 bits."""
u8: TypeAlias = Annotated[int, Tag("u8")]
"""An integer of 8 bits, 0 to 255."""
u16: TypeAlias = Annotated[int, Tag("u16")]
"""An integer of 16 bits without sign."""
u32: TypeAlias = Annotated[int, Tag("u32")]
"""An integer of 32 bits without sign."""
u64: TypeAlias = Annotated[int, Tag("u64")]
"""An integer of 64 bits without sign."""
f32: TypeAlias = Annotated[float, Tag("f32")]
"""A float of 32 bits: the nearest to what is given."""
f64: TypeAlias = Annotated[float, Tag("f64")]
"""A float of 64 bits."""
char: TypeAlias = Annotated[str, Tag("char")]
"""One character of 8 bits (Latin-1)."""
wchar: TypeAlias = Annotated[str, Tag("wchar")]
"""One character of Unicode."""
wstr: TypeAlias = Annotated[str, Tag("str")]
"""Text; the same as `str`, for records that have two kinds."""

MapValue: TypeAlias = "bool | int | float | str | bytes | npt.ArrayLike | Mapping[str, MapValue]"

EMPTY: Any = ()
"""The default of a sequence field. Its type is Any, because no type of a default fits fields that are descriptors."""


class Spelled(Generic[Given, Taken]):
    """The base of annotations whose field gives and takes different types; only type checkers see a descriptor."""

    if TYPE_CHECKING:

        @overload
        def __get__(self, instance: None, owner: Any = None) -> Self: ...
        @overload
        def __get__(self, instance: object, owner: Any = None) -> Given: ...
        def __get__(self, instance: object, owner: Any = None) -> Any: ...
        def __set__(self, instance: object, value: Taken) -> None: ...


class Array(Spelled["npt.NDArray[Any]", "npt.ArrayLike"], Generic[T]):
    """A one-dimensional number sequence.

    Takes what numpy can read, gives a read-only array of exactly this element type. Annotate an optional array as
    `npt.NDArray[np.float64] | None`: type checkers support such descriptors only outside of a union.
    """


class NDArray(Spelled["npt.NDArray[Any]", "npt.ArrayLike"]):
    """An array of up to 8 dimensions and any allowed element type: takes an array, gives it read-only."""


class Seq(Spelled["Sequence[T]", "Iterable[T]"], Generic[T]):
    """A sequence of text, characters, enumeration members or records: takes any iterable, gives a tuple."""


class Rows(Spelled["RecordArray[T]", "Iterable[T] | npt.NDArray[np.generic]"], Generic[T]):
    """Records whose leaves all have one element type: takes records or an (n, k) array, gives a `RecordArray`."""


class Map(Spelled["Mapping[str, Any]", "Mapping[str, MapValue]"]):
    """Text to scalar, array or such a map: takes a mapping, gives a read-only copy."""
