"""Converts whole arrays for `convert`, by the same rules as scalars."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from aiorts.errors import ConversionError
from aiorts.types.arrays import DTYPES, freeze, inexact_as_float
from aiorts.types.convert import _LARGEST, limits_of

if TYPE_CHECKING:
    import numpy.typing as npt

    AnyArray = npt.NDArray[Any]

_TO_INTEGER = {"round": np.rint, "truncate": np.trunc, "floor": np.floor}


def convert_array(array: AnyArray, target: str, overflow: str, rounding: str) -> AnyArray:
    """A bool, integer or float array as a read-only array of `target`.

    ConversionError names the first item that does not fit.
    """
    limits = limits_of(target)
    dtype = np.dtype(DTYPES["i64" if target == "stamp" else target])
    if not array.dtype.isnative:
        array = array.astype(array.dtype.newbyteorder("="))
    if limits is None:
        return freeze(_to_float(array, target, dtype, overflow))
    working = np.dtype("i8") if target == "bool" else dtype
    if array.dtype.kind == "f":
        result = _round(array, target, working, limits, overflow, rounding)
    else:
        result = _narrow(array, target, working, limits, overflow)
    return freeze(result.astype(dtype))


def _round(
    array: AnyArray, target: str, dtype: np.dtype[Any], limits: tuple[int, int], overflow: str, rounding: str
) -> AnyArray:
    low, high = limits
    _refuse(array, np.isnan(array), f"a number, which NaN is not, to make {target} of")
    whole = _TO_INTEGER[rounding](array.astype("f8"))
    # high + 1 is a power of two (or small), so both limits are exact as floats; high itself would not be.
    below, above = whole < float(low), whole >= float(high + 1)
    outside = below | above
    result: AnyArray = np.where(outside, 0, whole).astype(dtype)
    if not outside.any():
        return result
    if overflow == "error":
        _refuse(array, outside, f"{low}..{high}, which {target} holds")
    if overflow == "saturate":
        result[below], result[above] = low, high
        return result
    _refuse(array, np.isinf(array), f"a finite number to wrap into {target}")
    result[outside] = [(int(item) - low) % (high - low + 1) + low for item in whole[outside].tolist()]
    return result


def _narrow(array: AnyArray, target: str, dtype: np.dtype[Any], limits: tuple[int, int], overflow: str) -> AnyArray:
    low, high = limits
    if array.dtype.kind == "b":
        return array.astype(dtype)
    if not array.size or (low <= int(array.min()) and int(array.max()) <= high):
        return array.astype(dtype)
    source = np.iinfo(array.dtype)
    reachable = max(low, int(source.min)), min(high, int(source.max))
    if overflow == "error":
        _refuse(array, (array < reachable[0]) | (array > reachable[1]), f"{low}..{high}, which {target} holds")
    if overflow == "saturate":
        return np.clip(array, reachable[0], reachable[1]).astype(dtype)
    if target in ("bool", "stamp"):
        wrapped = [(int(item) - low) % (high - low + 1) + low for item in array.ravel().tolist()]
        return np.array(wrapped, dtype=dtype).reshape(array.shape)
    return array.astype(dtype)


def _to_float(array: AnyArray, target: str, dtype: np.dtype[Any], overflow: str) -> AnyArray:
    if array.dtype.kind in "iu":
        if overflow == "error":
            _refuse(array, inexact_as_float(array), f"an integer that {target} holds exactly (up to 2**53 all are)")
        array = array.astype("f8")
    with np.errstate(over="ignore", invalid="ignore"):
        result: AnyArray = array.astype(dtype)
    if array.dtype.kind == "b" or dtype.itemsize >= array.dtype.itemsize:
        return result
    over = np.isinf(result) & ~np.isinf(array)
    if over.any() and overflow == "error":
        _refuse(array, over, f"at most {_LARGEST[target]!r}, which {target} holds")
    if overflow == "saturate":
        result[over] = np.copysign(np.array(_LARGEST[target], dtype=dtype), array[over])
    return result


def _refuse(array: AnyArray, bad: AnyArray, expected: str) -> None:
    if not bad.any():
        return
    index = ", ".join(str(int(axis[0])) for axis in bad.nonzero())
    item = array[bad].ravel()[0].item()
    shown = "NaN" if isinstance(item, float) and math.isnan(item) else repr(item)
    raise ConversionError(f"[{index}]: expected {expected}, got {shown}; see overflow and rounding")
