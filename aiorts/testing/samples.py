"""Samples for tests: made from bare values, read as bare values, compared bit by bit. Nothing here reads a clock."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from aiorts.errors import RecordTypeError
from aiorts.types import RecordArray, describe, fields_of, has_tm, with_tm
from aiorts.types.samples import PLAIN_TYPES, original

if TYPE_CHECKING:
    from collections.abc import Iterator


def sample_of(cls: type, value: Any, tm: int) -> Any:
    """A sample of `cls`: `value` itself if it is one, else a new one stamped `tm` (ns) with `value` as its data.

    A mapping gives the fields by name. The data of a record is its field `data`, else its only field besides `tm`.

    Raises:
        RecordTypeError: the record has several fields and `value` is no mapping.
        RecordError: `value` does not fit.
    """
    if isinstance(value, cls) or cls in PLAIN_TYPES:
        return value
    fields = dict(value) if isinstance(value, Mapping) and not _takes_mapping(cls) else {_data_field(cls): value}
    sample = cls(**fields)
    return with_tm(sample, tm) if has_tm(cls) and "tm" not in fields else sample


def value_of(sample: Any) -> Any:
    """The data of a sample: its field `data`, else its only field besides `tm`, else the sample itself."""
    if type(sample) in PLAIN_TYPES:
        return sample
    name = _find_data_field(original(type(sample)))
    return sample if name is None else getattr(sample, name)


def _find_data_field(cls: type) -> str | None:
    names = [field.name for field in fields_of(cls) if field.name != "tm"]
    if "data" in names:
        return "data"
    return names[0] if len(names) == 1 else None


def _data_field(cls: type) -> str:
    name = _find_data_field(cls)
    if name is None:
        names = ", ".join(field.name for field in fields_of(cls))
        raise RecordTypeError(f"{cls.__name__}: has the fields {names}; give a {cls.__name__} or a mapping of them")
    return name


def _takes_mapping(cls: type) -> bool:
    name = _find_data_field(cls)
    return name is not None and any(f.name == name and f.kind.base == "map" for f in fields_of(cls))


def difference(left: Any, right: Any, where: str = "") -> str | None:
    """The first difference of two samples, as "path: this, not that"; None when they are the same bit by bit.

    Stricter than `==`: -0.0 is not 0.0, a NaN equals only one with the same payload, an array has a type and a shape.
    """
    where = where or type(left).__name__
    if original(type(left)) is not original(type(right)):
        return f"{where}: a {type(left).__name__}, not a {type(right).__name__}"
    if isinstance(left, float):
        same = struct.pack("<d", left) == struct.pack("<d", right)
        return None if same else f"{where}: {_float(left)}, not {_float(right)}"
    parts = _parts(left, right, where)
    if parts is None:
        return None if left == right else f"{where}: {left!r:.80}, not {right!r:.80}"
    return next((found for one, other, at in parts if (found := difference(one, other, at)) is not None), None)


def _parts(left: Any, right: Any, where: str) -> Iterator[tuple[Any, Any, str]] | None:
    """The parts of two values of one class, in pairs; None for scalars."""
    if isinstance(left, RecordArray):
        left, right = left.array, right.array
    if type(left).__module__ == "numpy" and hasattr(left, "tobytes"):
        return _array_parts(left, right, where)
    if isinstance(left, (tuple, list)):
        lengths = [(len(left), len(right), f"len({where})")]
        return iter([*lengths, *((a, b, f"{where}[{i}]") for i, (a, b) in enumerate(zip(left, right, strict=False)))])
    if isinstance(left, Mapping):
        keys = [(tuple(left), tuple(right), f"keys of {where}")]
        return iter([*keys, *((left[key], right[key], f"{where}[{key!r}]") for key in left if key in right)])
    if hasattr(type(left), "__dataclass_fields__") or hasattr(type(left), "__aiorts_structure__"):
        names = [field.name for field in describe(original(type(left))).fields]
        return ((getattr(left, name), getattr(right, name), f"{where}.{name}") for name in names)
    return None


def _array_parts(left: Any, right: Any, where: str) -> Iterator[tuple[Any, Any, str]]:
    yield str(left.dtype.str), str(right.dtype.str), f"{where}.dtype"
    yield tuple(left.shape), tuple(right.shape), f"{where}.shape"
    if left.tobytes() == right.tobytes():
        return
    size = left.dtype.itemsize
    one, other = left.tobytes(), right.tobytes()
    index = next(i for i in range(0, len(one), size) if one[i : i + size] != other[i : i + size]) // size
    yield _item(left, index), _item(right, index), f"{where}[{index}]"


def _item(array: Any, index: int) -> str:
    value = array.reshape(-1)[index]
    return f"{value} (bytes {value.tobytes().hex()})"


def _float(value: float) -> str:
    return f"{value!r} (bits {struct.pack('>d', value).hex()})"
