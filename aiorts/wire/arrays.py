"""An array as one binary value: element type, number of dimensions and shape in front of its bytes.

Layout, little-endian: element code (1 byte), dimensions (1), six zeros, one u64 for each length, then the elements in
C order. The head is a multiple of eight bytes, so that the elements are aligned in the `bytes` of the parser; the
decoded array uses that memory directly.
"""

from __future__ import annotations

import math
import struct
from typing import TYPE_CHECKING, Any

from aiorts.errors import WireError
from aiorts.types.arrays import DTYPES, MAX_DIMENSIONS, element_name
from aiorts.types.kinds import shown

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt


# Codes are part of the format: append, never renumber.
ELEMENTS = ("bool", "i8", "i16", "i32", "i64", "u8", "u16", "u32", "u64", "f16", "f32", "f64", "c64", "c128")
_CODES = {name: code for code, name in enumerate(ELEMENTS, start=1)}
_HEADS = tuple(struct.Struct(f"<BB6x{dimensions}Q") for dimensions in range(MAX_DIMENSIONS + 1))
_LONGEST = 2**62
_empty: dict[bytes, npt.NDArray[Any]] = {}
"""Empty arrays of one dimension, by their bytes: one shared array for each element type."""


_little: dict[str, np.dtype[Any]] = {}
"""The little-endian types of numpy, by names without byte order; making a type takes as long as making an array."""


def pack_array(array: npt.NDArray[np.generic]) -> bytes:
    """The bytes of a checked array (contiguous, an element type that may travel)."""
    head, little = _head(array), _little_endian(array)
    return head + little.tobytes() if array.size < 4096 else b"".join((head, little.data))


def array_part(array: npt.NDArray[np.generic]) -> tuple[bytes, memoryview]:
    """The head of a checked array, and its elements, which are not copied."""
    import numpy as np

    return _head(array), _little_endian(array).reshape(-1).view(np.uint8).data


def _head(array: npt.NDArray[np.generic]) -> bytes:
    code = _CODES[element_name(array.dtype) or ""]
    return _HEADS[array.ndim].pack(code, array.ndim, *array.shape)


def _little_endian(array: npt.NDArray[np.generic]) -> npt.NDArray[np.generic]:
    return array if array.dtype.isnative and _LITTLE else array.astype(array.dtype.newbyteorder("<"))


def unpack_array(data: Any, where: str) -> npt.NDArray[Any]:
    """A read-only array on the memory of `data`.

    WireError, before anything is allocated, if the head in `data` does not describe the elements.
    """
    return _array(data, None, where)


def array_of_part(head: Any, part: bytes | bytearray | memoryview, where: str) -> npt.NDArray[Any]:
    """A read-only array on the memory of `part`, which is contiguous bytes.

    WireError, before anything is allocated, if the head does not describe the part.
    """
    return _array(head, part, where)


def _array(data: Any, part: bytes | bytearray | memoryview | None, where: str) -> npt.NDArray[Any]:
    if type(data) is not bytes:
        raise WireError(f"{where}: expected an array as binary, got {shown(data)}")
    if part is None and len(data) == 16 and (empty := _empty.get(data)) is not None:
        return empty
    if len(data) < 8:
        raise WireError(f"{where}: expected the head of an array, 8 bytes or more, got {len(data)}")
    code, dimensions = data[0], data[1]
    if not 1 <= code <= len(ELEMENTS) or dimensions > MAX_DIMENSIONS or data[2:8] != b"\0\0\0\0\0\0":
        raise WireError(
            f"{where}: expected an element code 1..{len(ELEMENTS)}, at most {MAX_DIMENSIONS} dimensions, six zeros; "
            f"got {data[:8]!r}"
        )
    head = _HEADS[dimensions]
    if len(data) < head.size or (part is not None and len(data) != head.size):
        raise WireError(f"{where}: expected {dimensions} lengths, got {len(data) - 8} bytes of them")
    shape = head.unpack_from(data)[2:]
    element = ELEMENTS[code - 1]
    dtype = DTYPES[element]
    elements, offset = (data, head.size) if part is None else (part, 0)
    size = math.prod(shape) * int(dtype[1:])
    if size != len(elements) - offset or (shape and max(shape) > _LONGEST):
        raise WireError(f"{where}: expected {size} bytes for {element} of shape {shape}, got {len(elements) - offset}")
    array = _view(elements, dtype, offset, shape, where)
    if part is None and shape == (0,):
        array.setflags(write=False)
        _empty[data] = array
    return array


def _view(
    data: bytes | bytearray | memoryview, dtype: str, offset: int, shape: tuple[int, ...], where: str
) -> npt.NDArray[Any]:
    import numpy as np

    if offset == len(data):
        # frombuffer refuses an empty buffer; numpy would multiply huge lengths next to a zero, which are harmless.
        if math.prod(length for length in shape if length) * int(dtype[1:]) > _LONGEST:
            raise WireError(f"{where}: expected a shape that an array can have, got {shape}")
        return np.empty(shape, dtype=dtype)
    if dtype == "b1" and int(np.frombuffer(data, dtype="u1", offset=offset).max()) > 1:
        raise WireError(f"{where}: expected truth values as bytes 0 and 1, got others")
    if (little := _little.get(dtype)) is None:
        little = _little[dtype] = np.dtype(f"<{dtype}")
    array = np.frombuffer(data, little, -1, offset)
    return array if len(shape) == 1 else array.reshape(shape)


_LITTLE = struct.pack("=H", 1) == b"\1\0"
