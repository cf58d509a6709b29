"""What a record's fields may be annotated with; nothing here checks anything.

Scalars are plain types with a tag (`f64` is a float to a type checker). Sequences are spelled by what the reader gets:
`Array[f64]` gives a numpy array, `Rows[Point3D]` an (n, k) array with record views, `Seq[str]` a tuple. They are
descriptors to the type checkers only: that is how one field can accept a list and give back an array.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Generic, TypeAlias, TypeVar, overload

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from typing import Self

    import numpy as np
    import numpy.typing as npt

    from aiorts.types.rows import RecordArray

T = TypeVar("T")

__all__ = (
    "Array", "Map", "MapValue", "NDArray", "Rows", "Seq", "EMPTY",
    "char", "f32", "f64", "i8", "i16", "i32", "i64", "u8", "u16", "u32", "u64", "wchar", "wstr",
)  # fmt: skip


class Tag(str):
    """Names a kind inside `Annotated`; a class of its own so that foreign metadata is never taken for one."""

    __slots__ = ()


i8: TypeAlias = Annotated[int, Tag("i8")]
i16: TypeAlias = Annotated[int, Tag("i16")]
i32: TypeAlias = Annotated[int, Tag("i32")]
i64: TypeAlias = Annotated[int, Tag("i64")]
u8: TypeAlias = Annotated[int, Tag("u8")]
u16: TypeAlias = Annotated[int, Tag("u16")]
u32: TypeAlias = Annotated[int, Tag("u32")]
u64: TypeAlias = Annotated[int, Tag("u64")]
f32: TypeAlias = Annotated[float, Tag("f32")]
f64: TypeAlias = Annotated[float, Tag("f64")]
char: TypeAlias = Annotated[str, Tag("char")]
wchar: TypeAlias = Annotated[str, Tag("wchar")]
wstr: TypeAlias = Annotated[str, Tag("str")]

MapValue: TypeAlias = "bool | int | float | str | bytes | npt.ArrayLike"

# The default of every sequence field. Typed Any because a descriptor-typed field has no spelling for "empty" of its
# own.
EMPTY: Any = ()


class Array(Generic[T]):
    """A one-dimensional number sequence.

    Takes what numpy can read, gives a read-only array of exactly this element type.
    """

    if TYPE_CHECKING:

        @overload
        def __get__(self, instance: None, owner: Any = None) -> Self: ...
        @overload
        def __get__(self, instance: object, owner: Any = None) -> npt.NDArray[Any]: ...
        def __get__(self, instance: object, owner: Any = None) -> Any: ...
        def __set__(self, instance: object, value: npt.ArrayLike) -> None: ...


class NDArray:
    """An array of up to 8 dimensions and any allowed element type: takes an array, gives it read-only."""

    if TYPE_CHECKING:

        @overload
        def __get__(self, instance: None, owner: Any = None) -> Self: ...
        @overload
        def __get__(self, instance: object, owner: Any = None) -> npt.NDArray[Any]: ...
        def __get__(self, instance: object, owner: Any = None) -> Any: ...
        def __set__(self, instance: object, value: npt.ArrayLike) -> None: ...


class Seq(Generic[T]):
    """A sequence of text, characters, enumeration members or records: takes any iterable, gives a tuple."""

    if TYPE_CHECKING:

        @overload
        def __get__(self, instance: None, owner: Any = None) -> Self: ...
        @overload
        def __get__(self, instance: object, owner: Any = None) -> Sequence[T]: ...
        def __get__(self, instance: object, owner: Any = None) -> Any: ...
        def __set__(self, instance: object, value: Iterable[T]) -> None: ...


class Rows(Generic[T]):
    """A sequence of records whose leaves all have one element type: takes records or an (n, k) array, gives both."""

    if TYPE_CHECKING:

        @overload
        def __get__(self, instance: None, owner: Any = None) -> Self: ...
        @overload
        def __get__(self, instance: object, owner: Any = None) -> RecordArray[T]: ...
        def __get__(self, instance: object, owner: Any = None) -> Any: ...
        def __set__(self, instance: object, value: Iterable[T] | npt.NDArray[np.generic]) -> None: ...


class Map:
    """Text to scalar or array: takes a mapping, gives a read-only one of its own."""

    if TYPE_CHECKING:

        @overload
        def __get__(self, instance: None, owner: Any = None) -> Self: ...
        @overload
        def __get__(self, instance: object, owner: Any = None) -> Mapping[str, Any]: ...
        def __get__(self, instance: object, owner: Any = None) -> Any: ...
        def __set__(self, instance: object, value: Mapping[str, MapValue]) -> None: ...
