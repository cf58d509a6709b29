"""Number sequences: input that numpy can read becomes a native, contiguous, owned, read-only array of the same values.

An array that already owns its memory is kept and frozen; a read-only view of immutable `bytes` counts as owned, so
that decoding adds no copy. All other input is copied once. A value that the element type cannot hold is an error,
never a wrap. numpy is imported here, and here only when the first array is checked.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from aiorts.errors import RecordError, RecordTypeError
from aiorts.types.kinds import SCALARS, IntKind, Kind, shown, wrong_type

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    AnyArray = npt.NDArray[np.generic]

MAX_DIMENSIONS = 8

# element name -> numpy's type code without byte order; also the allow-list of what may travel
DTYPES: dict[str, str] = {
    "bool": "b1",
    **{f"{sign}{bits}": f"{sign}{bits // 8}" for sign in "iu" for bits in (8, 16, 32, 64)},
    "f16": "f2",
    "f32": "f4",
    "f64": "f8",
    "c64": "c8",
    "c128": "c16",
}
_NAMES = {code: name for name, code in DTYPES.items()}


def element_name(dtype: np.dtype[Any]) -> str | None:
    """The element name of a numpy type ("f64"), whatever its byte order; None if it may not travel."""
    return _NAMES.get(f"{dtype.kind}{dtype.itemsize}")


def sealed_bytes(size: int) -> memoryview:
    """Memory of `size` bytes that a transport fills once, and that nothing writes to afterwards.

    A record keeps an array on a read-only view of this memory without a copy, as on `bytes`; but `bytes` cannot be
    filled from a socket. Unfilled pages take no memory, so that a false size from a peer costs only microseconds.
    """
    import numpy as np

    memory: Any = np.empty(size, np.uint8).view(_sealed_class())
    return memoryview(memory)


def sealed_view(memory: memoryview) -> memoryview:
    """A view of read-only memory that another process has filled, and that nothing writes to while this view is in use.
    A record keeps an array on this view without a copy, as on `sealed_bytes`.

    The view's `obj` lives as long as the last array or view that uses this memory.

    Raises:
        ValueError: the memory can be written to.
    """
    import numpy as np

    if not memory.readonly:
        raise ValueError("expected memory that can only be read")
    seen: Any = np.frombuffer(memory, np.uint8).view(_sealed_class())
    return memoryview(seen)


@functools.cache
def _sealed_class() -> type:
    """The class of the arrays behind the views that `sealed_bytes` and `sealed_view` return."""
    import numpy as np

    class Sealed(np.ndarray):
        """Memory that is filled once."""

    return Sealed


def freeze(array: AnyArray) -> AnyArray:
    """The array itself, read-only, if it is native, contiguous and owned; else a read-only copy that is."""
    flags = array.flags
    if type(array) is not _array_class() or not flags.c_contiguous or not array.dtype.isnative:
        import numpy as np

        array = np.array(array, dtype=array.dtype.newbyteorder("="), order="C", copy=True, subok=False)
    elif not (flags.owndata or _of_bytes(array)):
        array = array.copy()
    elif not flags.writeable:
        return array
    array.setflags(write=False)
    return array


@functools.cache
def _array_class() -> type:
    """Return numpy.ndarray; this cached call is cheaper than an import statement in each caller."""
    import numpy as np

    return np.ndarray


@functools.cache
def element_dtype(element: str) -> np.dtype[Any]:
    """numpy's native type for an element name."""
    import numpy as np

    return np.dtype(DTYPES[element])


def _of_bytes(array: AnyArray) -> bool:
    """Whether the array's memory cannot change: it belongs to `bytes`, or is sealed."""
    base: Any = array
    while type(base) is type(array):
        if base.flags.writeable:
            return False
        base = base.base
    if type(base) is memoryview:
        return base.readonly and type(base.obj) in (bytes, _sealed_class())
    return type(base) is bytes


class ArrayKind(Kind):
    """One-dimensional numpy array of one element type."""

    def __init__(self, element: str) -> None:
        self.element = element
        self._element = element
        self.spelling = f"seq[{element}]"

    def check(self, value: Any, where: str) -> AnyArray:
        array: Any = value if type(value) is _array_class() else as_array(value, self._element, where)
        if array.ndim != 1:
            raise RecordError(f"{where}: expected a sequence of {self.element}, shape (n,), got shape {array.shape}")
        return freeze(exact(array, self._element, where))

    def zero(self) -> Any:
        return ()

    def same(self, left: AnyArray, right: AnyArray) -> bool:
        return same_array(left, right)

    def hashed(self, value: AnyArray) -> Any:
        raise TypeError("a record that holds an array cannot be hashed")


class NDArrayKind(ArrayKind):
    """numpy array of up to eight dimensions, of one given element type or of any that may travel."""

    def __init__(self, element: str | None = None) -> None:
        self.element = element
        self.spelling = f"ndarray[{element}]" if element else "ndarray"

    def check(self, value: Any, where: str) -> AnyArray:
        array = _any_array(value, where) if self.element is None else as_array(value, self.element, where)
        if array.ndim > MAX_DIMENSIONS:
            raise RecordError(f"{where}: expected at most {MAX_DIMENSIONS} dimensions, got {array.ndim}")
        if self.element is not None:
            return freeze(exact(array, self.element, where))
        if element_name(array.dtype) is None:
            raise RecordTypeError(f"{where}: expected an array of {', '.join(DTYPES)}; got dtype {array.dtype}")
        return freeze(array)


def same_array(left: AnyArray, right: AnyArray) -> bool:
    """Equal shape, type and values, NaN equal to NaN."""
    import numpy as np

    if left.dtype != right.dtype or left.shape != right.shape:
        return False
    return bool(np.array_equal(left, right, equal_nan=left.dtype.kind in "fc"))


def _any_array(value: Any, where: str) -> AnyArray:
    """Any value as an array whose type numpy finds; lists of mixed or ragged content are refused."""
    import numpy as np

    if type(value) is np.ndarray:
        return value
    if isinstance(value, np.ndarray) or hasattr(value, "__array__") or isinstance(value, memoryview):
        return _unmasked(value, where)
    leaves = set(_leaf_types(value))
    if leaves == {int, float}:
        value, leaves = _floats(value, where), {float}
    if len(leaves) > 1:
        names = ", ".join(sorted(leaf.__name__ for leaf in leaves))
        raise RecordTypeError(f"{where}: expected elements of one type, got {names}; give a numpy array")
    try:
        return np.array(value)
    except ValueError as error:
        raise RecordError(f"{where}: expected rows of equal length, got {shown(value)}: {error}") from None


def _floats(value: Any, where: str) -> Any:
    """Nested lists of ints and floats, with each int converted to the float equal to it."""
    if isinstance(value, (list, tuple)):
        return [_floats(item, f"{where}[{index}]") for index, item in enumerate(value)]
    return SCALARS["f64"].check(value, where)


def _leaf_types(value: Any, depth: int = 0) -> Iterable[type]:
    if isinstance(value, (list, tuple)) and depth <= MAX_DIMENSIONS:
        for item in value:
            yield from _leaf_types(item, depth + 1)
    else:
        yield type(value)


def as_array(value: Any, element: str, where: str) -> AnyArray:
    """`value` as an array; whether its values fit the element type is not checked yet."""
    import numpy as np

    if type(value) is np.ndarray:
        return value
    if type(value) is bytes and element in ("u8", "i8"):
        return np.frombuffer(value, dtype=element.replace("8", "1"))
    if isinstance(value, (str, bytes, bytearray)) and not (isinstance(value, bytearray) and element == "u8"):
        raise wrong_type(where, f"a sequence of {element}", value)
    if hasattr(value, "__array__") or isinstance(value, (memoryview, bytearray)) or _is_buffer_array(value):
        return _unmasked(value, where)
    if not isinstance(value, Iterable) or isinstance(value, (dict, set, frozenset)):
        raise wrong_type(where, f"a sequence of {element}", value)
    return _from_items(list(value), element, where)


def _is_buffer_array(value: Any) -> bool:
    return type(value).__module__ == "array" and hasattr(value, "typecode")


def _unmasked(value: Any, where: str) -> AnyArray:
    import numpy as np

    if isinstance(value, np.ma.MaskedArray) and np.ma.is_masked(value):
        raise RecordTypeError(
            f"{where}: expected an array without masked elements; fill them first (value.filled(...))"
        )
    return np.asarray(value)


def _from_items(items: list[Any], element: str, where: str) -> AnyArray:
    """An array of items that all pass the scalar check; the common cases are checked as a whole, not item by item."""
    import numpy as np

    kind = SCALARS.get(element)
    dtype = DTYPES[element]
    found = set(map(type, items))
    if found == {float} and element == "f64":
        return np.array(items, dtype=dtype)
    if found == {int} and isinstance(kind, IntKind) and kind.low <= min(items) and max(items) <= kind.high:
        return np.array(items, dtype=dtype)
    if kind is None:
        return exact(np.array(items), element, where)
    checked = [kind.check(item, f"{where}[{index}]") for index, item in enumerate(items)]
    return np.array(checked, dtype=dtype)


def exact(array: AnyArray, element: str, where: str) -> AnyArray:
    """The array converted to the element type; RecordError if the conversion would change a value.

    Floats may be rounded to 32 bits (a float32 field is defined as the nearest value) but may not overflow.
    """
    target, source = element_dtype(element), array.dtype
    if source is target or source == target or (element_name(source) == element):
        return array
    import numpy as np

    if source.kind not in _ACCEPTS[target.kind]:
        raise RecordTypeError(
            f"{where}: expected elements of {element}, got an array of {source}; use aiorts.types.convert"
        )
    if array.size == 0:
        return array.astype(target)
    if target.kind in "iu":
        return _exact_integers(array, target, element, where)
    if source.kind in "iu":
        _refuse(array, inexact_as_float(array), element, where)
        return array.astype("f8").astype(target)
    with np.errstate(all="ignore"):
        cast = array.astype(target)
    _refuse(array, np.isinf(cast) & ~np.isinf(array), element, where)
    return cast


def inexact_as_float(array: AnyArray) -> npt.NDArray[np.bool_]:
    """The mask of integers that no 64-bit float equals. numpy itself calls a cast of them to float safe."""
    import numpy as np

    if array.dtype.itemsize < 8:
        return np.zeros(array.shape, dtype=bool)
    as_float = array.astype("f8")
    beyond = as_float >= (2.0**63 if array.dtype.kind == "i" else 2.0**64)
    back: npt.NDArray[np.bool_] = np.where(beyond, 0.0, as_float).astype(array.dtype) != array
    return back | beyond


def _exact_integers(array: AnyArray, target: np.dtype[Any], element: str, where: str) -> AnyArray:
    import numpy as np

    info = np.iinfo(target)
    if int(array.min()) < info.min or int(array.max()) > info.max:
        low, high = int(info.min), int(info.max)
        source = np.iinfo(array.dtype)  # type: ignore[type-var]
        bad = (array < max(low, int(source.min))) | (array > min(high, int(source.max)))  # type: ignore[operator]
        _refuse(array, bad, element, where)
    return array.astype(target)


def _refuse(array: AnyArray, bad: Any, element: str, where: str) -> None:
    if not bad.any():
        return
    index = ", ".join(str(int(part[0])) for part in bad.nonzero())
    kind = SCALARS[element]
    expected = getattr(kind, "expected", f"a number that {element} holds")
    raise RecordError(f"{where}[{index}]: expected {expected}, got {array[bad][0]}")


# the dtype kinds that are accepted for each kind of element; any other is refused, even if all its values would fit
_ACCEPTS = {"b": "b", "i": "iu", "u": "iu", "f": "fiu", "c": "cfiu"}
