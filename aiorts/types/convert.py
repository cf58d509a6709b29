"""One conversion between all kinds of scalars, and of sequences of them: never a change that was not requested.

`overflow` decides what becomes of a number the target cannot hold: `error`, `saturate` (the nearest limit; infinity is
a limit) or `wrap` (modulo 2**bits for integers, infinity for floats). `rounding` decides how a fraction becomes an
integer: `round` (to nearest, halves to even, so that 1.001 m is 1001 mm), `truncate` or `floor`. bool counts as an
integer of one bit, a datetime as its nanoseconds since the epoch (a datetime becomes ISO 8601 text). Text is read as a
decimal number or as true/false; a value becomes the text that Python prints for it; a character is text of length one.
NaN, or text that is no number, cannot become an integer: that is an error under every policy.
"""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Any

from aiorts.errors import ConversionError, RecordError
from aiorts.types.kinds import SCALARS, DateTimeKind, IntKind, Kind, TextKind, datetime_ns, shown
from aiorts.types.rows import RecordArray

if TYPE_CHECKING:
    from collections.abc import Sequence
    from decimal import Decimal

    Number = int | float | Decimal

_OVERFLOWS = ("error", "saturate", "wrap")
_TO_INTEGER: dict[str, Any] = {"round": round, "truncate": math.trunc, "floor": math.floor}
_DECIMAL_ROUNDING = {"round": "ROUND_HALF_EVEN", "truncate": "ROUND_DOWN", "floor": "ROUND_FLOOR"}
_LARGEST = {"f64": 1.7976931348623157e308, "f32": 3.4028234663852886e38}
_NUMBER = re.compile(r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]{1,9})?", re.ASCII)
_SPECIAL = {"nan": math.nan, "inf": math.inf, "infinity": math.inf}
_TRUTH = {"true": True, "yes": True, "on": True, "false": False, "no": False, "off": False}
# Longer text is hardly a number, and the time to parse it grows with the square of its length.
_LONGEST_NUMBER = 1000


def convert(value: Any, to: str | Kind, *, overflow: str = "error", rounding: str = "round") -> Any:
    """`value` as the kind `to`: "i32", "f32", "bool", "str", "char", ..., or "seq[i32]" for a sequence.

    A sequence (list, tuple, bytes, array of any shape) is converted item by item, to a read-only numpy array of the
    same shape or, for text, to a tuple. ConversionError says where, what was expected and what was got.
    """
    if overflow not in _OVERFLOWS:
        raise ConversionError(f"overflow: expected {' | '.join(_OVERFLOWS)}, got {shown(overflow)}")
    if rounding not in _TO_INTEGER:
        raise ConversionError(f"rounding: expected {' | '.join(_TO_INTEGER)}, got {shown(rounding)}")
    spelling = to.base if isinstance(to, Kind) else to
    sequence = spelling.startswith("seq[") and spelling.endswith("]")
    target = spelling[4:-1] if sequence else spelling
    if target not in SCALARS:
        raise ConversionError(
            f"target: expected one of {', '.join(SCALARS)}, or seq[...] of one, got {shown(spelling)}"
        )
    if target == "bytes":
        return _bytes(value, overflow, rounding)
    if _is_sequence(value):
        return _sequence(value, target, overflow, rounding)
    if sequence:
        raise ConversionError(f"expected a sequence to make {spelling} of, got {shown(value)}")
    return _scalar(value, target, overflow, rounding)


def limits_of(target: str) -> tuple[int, int] | None:
    """Least and greatest integer of an integer kind, 0 and 1 for bool; None for all others."""
    kind = SCALARS[target]
    if isinstance(kind, IntKind):
        return kind.low, kind.high
    return {"bool": (0, 1), "stamp": (0, 2**32 * 10**9 - 1)}.get(target)


def _is_sequence(value: Any) -> bool:
    if isinstance(value, (list, tuple, bytes, bytearray, memoryview, RecordArray)):
        return True
    return hasattr(value, "__array__") and getattr(value, "shape", ()) != ()


def _bytes(value: Any, overflow: str, rounding: str) -> bytes:
    if isinstance(value, (bytes, bytearray, memoryview)):
        return bytes(value)
    if not _is_sequence(value):
        raise ConversionError(f"expected a sequence of numbers to make bytes of, got {shown(value)}")
    converted: bytes = _sequence(value, "u8", overflow, rounding).tobytes()
    return converted


def _sequence(value: Any, target: str, overflow: str, rounding: str) -> Any:
    if isinstance(value, RecordArray):
        value = value.array
    if isinstance(value, (bytes, bytearray, memoryview)) or hasattr(value, "__array__"):
        import numpy as np

        array = np.frombuffer(value, dtype="u1") if isinstance(value, (bytes, bytearray)) else np.asarray(value)
        if array.dtype.kind in "biuf" and array.dtype.itemsize <= 8 and not isinstance(SCALARS[target], TextKind):
            from aiorts.types.convert_arrays import convert_array

            return convert_array(array, target, overflow, rounding)
        if array.ndim == 1:
            value = array.tolist()
        else:
            raise ConversionError(f"an array of {array.dtype} with shape {array.shape} has no conversion to {target}")
    return _items(value, target, overflow, rounding)


def _items(items: Sequence[Any], target: str, overflow: str, rounding: str) -> Any:
    converted = []
    for index, item in enumerate(items):
        try:
            converted.append(_scalar(item, target, overflow, rounding))
        except ConversionError as error:
            raise ConversionError(f"[{index}]: {error}") from None
    if isinstance(SCALARS[target], TextKind):
        return tuple(converted)
    import numpy as np

    from aiorts.types.arrays import DTYPES, freeze

    return freeze(np.array(converted, dtype=DTYPES["i64" if target == "stamp" else target]))


def _scalar(value: Any, target: str, overflow: str, rounding: str) -> Any:
    if isinstance(SCALARS[target], TextKind):
        return _text(value, target)
    number = _number(value, target)
    limits = limits_of(target)
    if limits is None:
        return _floating(number, target, overflow)
    integer = _integer(number, target, overflow, rounding)
    low, high = limits
    if not low <= integer <= high:
        if overflow == "error":
            raise _refused(value, target)
        integer = min(max(integer, low), high) if overflow == "saturate" else (integer - low) % (high - low + 1) + low
    return bool(integer) if target == "bool" else integer


def _refused(value: Any, target: str) -> ConversionError:
    limits = limits_of(target)
    expected = f"{limits[0]}..{limits[1]}" if limits else f"at most {_LARGEST[target]!r}"
    return ConversionError(
        f"expected a value that {target} holds ({expected}), got {shown(value)}; see overflow and rounding"
    )


def _number(value: Any, target: str) -> Number:
    """The number in `value`: an int, a float, or a Decimal for text with a fraction, so that no digit is lost yet."""
    if isinstance(value, str):
        return _parse(value, target)
    if isinstance(value, bool):
        return int(value)
    if isinstance(value, (int, float)):
        return int(value) if isinstance(value, int) else float(value)
    if getattr(value, "shape", None) == () and hasattr(value, "item"):
        item = value.item()
        if isinstance(item, (bool, int, float, str)):
            return _number(item, target)
    if hasattr(value, "utcoffset"):
        return _nanoseconds(value, target)
    raise ConversionError(f"{shown(value)} has no conversion to {target}; expected a number, a truth value or text")


def _nanoseconds(moment: Any, target: str) -> int:
    try:
        return datetime_ns(DateTimeKind().check(moment, target))
    except RecordError as error:
        raise ConversionError(str(error)) from None


def _parse(text: str, target: str) -> Number:
    stripped = text.strip()
    unsigned = stripped.lower().lstrip("+-")
    if target == "bool" and stripped.lower() in _TRUTH:
        return int(_TRUTH[stripped.lower()])
    if unsigned in _SPECIAL and len(stripped) - len(unsigned) <= 1:
        return -_SPECIAL[unsigned] if stripped.startswith("-") else _SPECIAL[unsigned]
    if len(stripped) > _LONGEST_NUMBER or not _NUMBER.fullmatch(stripped):
        meant = "true, false, yes, no, on, off, 1 or 0" if target == "bool" else "a decimal number such as -1.5e3"
        raise ConversionError(f"expected {meant} to make {target} of, got {shown(text)}")
    if unsigned.isdecimal():
        return int(stripped)
    from decimal import Decimal  # late: 3 ms, for text alone

    return Decimal(stripped)


def _integer(number: Number, target: str, overflow: str, rounding: str) -> int:
    if isinstance(number, int):
        return number
    if not isinstance(number, float):
        # No target holds a number this large; its digits would only cost memory.
        if number.adjusted() > 400:
            number = math.copysign(math.inf, number)
        elif number.adjusted() < -400:
            number = math.copysign(5e-324, number) if number else 0.0
        else:
            return int(number.to_integral_value(_DECIMAL_ROUNDING[rounding]))
    if number != number:
        raise ConversionError(f"NaN has no conversion to {target}; filter it out first")
    if math.isinf(number):
        limits = limits_of(target)
        if overflow != "saturate" or limits is None:
            raise _refused(number, target)
        return limits[0] if number < 0 else limits[1]
    integer: int = _TO_INTEGER[rounding](number)
    return integer


def _floating(number: Number, target: str, overflow: str) -> float:
    try:
        result = float(number)
    except OverflowError:
        result = math.copysign(math.inf, number)
    if isinstance(number, int) and overflow == "error" and math.isfinite(result) and int(result) != number:
        raise ConversionError(f"expected an integer that {target} holds exactly (up to 2**53 all are), got {number}")
    finite = not (isinstance(number, float) and not math.isfinite(number))
    if target == "f32" and math.isfinite(result):
        try:
            result = SCALARS["f32"].check(result, target)
        except RecordError:
            result = math.copysign(math.inf, result)
    if finite and math.isinf(result):
        if overflow == "error":
            raise _refused(float(number) if isinstance(number, float) else str(number)[:60], target)
        if overflow == "saturate":
            return math.copysign(_LARGEST[target], result)
    return result


def _text(value: Any, target: str) -> str:
    if not isinstance(value, (str, bool, int, float)):
        value = value.item() if getattr(value, "shape", None) == () and hasattr(value, "item") else value
    if isinstance(value, str):
        text = str.__str__(value)
    elif isinstance(value, (bool, int, float)):
        text = repr(float(value)) if isinstance(value, float) else str(value if isinstance(value, bool) else int(value))
    elif hasattr(value, "isoformat"):
        text = str(value.isoformat())
    else:
        raise ConversionError(f"{shown(value)} has no conversion to {target}; expected a number, a truth value or text")
    try:
        checked: str = SCALARS[target].check(text, target)
    except RecordError as error:
        raise ConversionError(str(error)) from None
    return checked
