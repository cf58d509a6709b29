"""The values that a field may hold, and their only check: `kind.check(value, where)` returns the kept value or raises.

A kind is shared by all fields of its sort and knows no field name; `where` ("TimedLong.data") is used in messages only.
`exact` is the class whose instances need no check at all; constructors compare a value's class with it first.
"""

from __future__ import annotations

import operator
import struct
from typing import TYPE_CHECKING, Any, ClassVar

from aiorts.errors import RecordError, RecordTypeError

if TYPE_CHECKING:
    from datetime import datetime
    from enum import Enum

NS_PER_SEC = 1_000_000_000
STAMP_LIMIT = 2**32 * NS_PER_SEC
STRING_LIMIT = 120


class Unchecked:
    """A class that no value has: with it as `Kind.exact`, every value goes through `check`."""


def shown(value: object) -> str:
    """A value as messages quote it.

    Short, with its type where the text alone would mislead; foreign code is not run.
    """
    cls = type(value)
    if cls in (int, float, str, bytes):
        text = repr(value if cls is not str and cls is not bytes else value[:STRING_LIMIT])  # type: ignore[index]
        return text if len(text) <= STRING_LIMIT else text[:STRING_LIMIT] + "..."
    if cls.__name__ == "ndarray":
        return f"an array of {getattr(value, 'dtype', '?')} with shape {getattr(value, 'shape', '?')}"
    if cls in (list, tuple, dict, set, frozenset, bytearray):
        return f"a {cls.__name__} of {len(value)}"  # type: ignore[arg-type]
    if value is None:
        return "None"
    if cls.__module__ in ("builtins", "numpy", "decimal", "fractions", "datetime"):
        return f"{str(value)[:STRING_LIMIT]} ({cls.__name__})"
    return f"an instance of {cls.__qualname__}"


def wrong_type(where: str, expected: str, value: object) -> RecordTypeError:
    return RecordTypeError(f"{where}: expected {expected}, got {shown(value)}")


def wrong_value(where: str, expected: str, value: object) -> RecordError:
    return RecordError(f"{where}: expected {expected}, got {shown(value)}")


def is_bool(value: object) -> bool:
    return isinstance(value, bool) or _numpy_kind(value) == "b"


def _numpy_kind(value: object) -> str:
    """The dtype kind of a numpy scalar, without importing numpy; "" for everything else."""
    if type(value).__module__ == "numpy" and getattr(value, "shape", None) == ():
        return "" if type(value).__name__ == "ndarray" else str(getattr(getattr(value, "dtype", None), "kind", ""))
    return ""


class Kind:
    """Base of all kinds."""

    spelling: str = ""
    exact: type = Unchecked
    mutable: ClassVar[bool] = False
    element: str | None = None

    @property
    def base(self) -> str:
        """The spelling of the kind that a single value is converted to before `check`: "f64" for "optional[f64]"."""
        return self.spelling

    def check(self, value: Any, where: str) -> Any:
        """The value to keep; if it does not fit, a RecordError with `where`, the expected kind and the value."""
        raise NotImplementedError

    def zero(self) -> Any:
        """The value of a field that is left out."""
        raise NotImplementedError

    def same(self, left: Any, right: Any) -> bool:
        """Whether two kept values are equal; NaN equals NaN, so that a record equals its own copy."""
        return bool(left == right)

    def hashed(self, value: Any) -> Any:
        """A hashable value that replaces the kept one in a record's hash; TypeError if there is none."""
        return value

    def __repr__(self) -> str:
        return self.spelling


class IntKind(Kind):
    """An integer of a fixed width. A bool is refused, because a bool as a number is rarely intended."""

    def __init__(self, spelling: str, low: int, high: int) -> None:
        self.spelling, self.low, self.high = spelling, low, high
        self.element = spelling
        self.expected = f"an integer {low}..{high}"

    def check(self, value: Any, where: str) -> int:
        if type(value) is not int:
            value = self._integer(value, where)
        if not self.low <= value <= self.high:
            raise wrong_value(where, self.expected, value)
        return int(value)

    def _integer(self, value: Any, where: str) -> int:
        if is_bool(value):
            raise RecordTypeError(
                f"{where}: expected {self.expected}, got {shown(value)}; write int(...) if that is meant"
            )
        if not hasattr(value, "__array__") or _numpy_kind(value) in ("i", "u"):
            try:
                return int(operator.index(value))
            except TypeError:
                pass
        raise wrong_type(where, self.expected, value)

    def zero(self) -> int:
        return 0


class FloatKind(Kind):
    """A float of 64 or 32 bits; the latter holds the nearest float32 as a Python float."""

    def __init__(self, spelling: str, single: bool) -> None:
        self.spelling, self.single = spelling, single
        self.element = spelling
        self.exact = Unchecked if single else float

    def check(self, value: Any, where: str) -> float:
        if type(value) is not float:
            value = self._floating(value, where)
        return self._nearest(value, where) if self.single else value

    def _floating(self, value: Any, where: str) -> float:
        if isinstance(value, float):
            return float(value)
        numpy_kind = _numpy_kind(value)
        if is_bool(value) or isinstance(value, complex) or (hasattr(value, "__array__") and not numpy_kind):
            raise wrong_type(where, "a number", value)
        if numpy_kind == "f":
            return self._exact(value, where)
        try:
            return self._exact(int(operator.index(value)), where)
        except TypeError:
            raise wrong_type(where, "a number", value) from None

    @staticmethod
    def _exact(value: Any, where: str) -> float:
        try:
            number = float(value)
        except OverflowError:
            number = float("inf")
        if number != value and value == value:
            raise wrong_value(where, "a number that a float holds exactly (integers up to 2**53 always are)", value)
        return number

    @staticmethod
    def _nearest(value: float, where: str) -> float:
        try:
            nearest: float = _float32.unpack(_float32.pack(value))[0]
        except OverflowError:
            raise wrong_value(where, "a number that fits a 32-bit float (up to 3.4028235e38)", value) from None
        return value if nearest == value else nearest

    def zero(self) -> float:
        return 0.0

    def same(self, left: float, right: float) -> bool:
        return left == right or (left != left and right != right)

    def hashed(self, value: float) -> Any:
        return value if value == value else "NaN"


_float32 = struct.Struct("<f")


class BoolKind(Kind):
    """True or False; other values that are merely truthy or falsy are refused."""

    spelling = "bool"
    element = "bool"
    exact = bool

    def check(self, value: Any, where: str) -> bool:
        if not is_bool(value):
            raise wrong_type(where, "True or False", value)
        return bool(value)

    def zero(self) -> bool:
        return False


class TextKind(Kind):
    """Text that UTF-8 can encode; with a `limit`, one character whose code is at most the limit."""

    def __init__(self, spelling: str, limit: int | None = None) -> None:
        self.spelling, self.limit = spelling, limit
        self.expected = {None: "text", 0xFF: "one 8-bit character"}.get(limit, "one character")

    def check(self, value: Any, where: str) -> str:
        if not isinstance(value, str):
            raise wrong_type(where, self.expected, value)
        if type(value) is not str:
            value = str.__str__(value)
        if self.limit is not None and (len(value) != 1 or ord(value) > self.limit):
            raise wrong_value(where, self.expected, value)
        if not value.isascii():
            self._encodable(value, where)
        return str(value)

    @staticmethod
    def _encodable(value: str, where: str) -> None:
        try:
            value.encode()
        except UnicodeEncodeError as error:
            raise wrong_value(f"{where}[{error.start}]", "text without lone surrogates", value[error.start]) from None

    def zero(self) -> str:
        return "" if self.limit is None else "\0"


class BytesKind(Kind):
    """Bytes as `bytes`; what can change (bytearray, memoryview) is copied."""

    spelling = "bytes"
    exact = bytes

    def check(self, value: Any, where: str) -> bytes:
        if isinstance(value, (bytes, bytearray, memoryview)):
            return bytes(value)
        raise wrong_type(where, "bytes", value)

    def zero(self) -> bytes:
        return b""


class StampKind(Kind):
    """Nanoseconds since the epoch, 0 <= tm < 2**32 s; a Time is taken as its nanoseconds."""

    spelling = "stamp"
    expected = "nanoseconds since the epoch, 0 <= tm < 2**32 s"

    def check(self, value: Any, where: str) -> int:
        if type(value) is not int:
            value = self._nanoseconds(value, where)
        if not 0 <= value < STAMP_LIMIT:
            raise wrong_value(where, self.expected, value)
        return int(value)

    def _nanoseconds(self, value: Any, where: str) -> int:
        ns = getattr(value, "ns", None)
        if type(ns) is int:
            return ns
        if isinstance(value, float) or is_bool(value) or not hasattr(value, "__index__"):
            raise RecordTypeError(
                f"{where}: expected {self.expected}, got {shown(value)}; "
                "for seconds write Time.from_seconds(...) or round(s * 1e9)"
            )
        return IntKind("stamp", 0, STAMP_LIMIT - 1).check(value, where)

    def zero(self) -> int:
        return 0


class EnumKind(Kind):
    """A member of an enumeration, or its value."""

    def __init__(self, enumeration: type[Enum]) -> None:
        self.enumeration = enumeration
        self.spelling = enumeration.__name__
        self.exact = enumeration
        self.expected = " | ".join(list(enumeration.__members__)[:8])

    def check(self, value: Any, where: str) -> Enum:
        if isinstance(value, self.enumeration):
            return value
        if is_bool(value) or isinstance(value, float):
            raise wrong_type(where, self.expected, value)
        try:
            return self.enumeration(value)
        except (ValueError, TypeError):
            raise wrong_value(where, self.expected, value) from None

    def zero(self) -> Enum:
        return next(iter(self.enumeration))


class OptionalKind(Kind):
    """A value of another kind, or None."""

    def __init__(self, inner: Kind) -> None:
        self.inner = inner
        self.spelling = f"optional[{inner.spelling}]"
        self.mutable = inner.mutable  # type: ignore[misc]

    @property
    def base(self) -> str:
        return self.inner.base

    def check(self, value: Any, where: str) -> Any:
        return None if value is None else self.inner.check(value, where)

    def zero(self) -> None:
        return None

    def same(self, left: Any, right: Any) -> bool:
        return left is right if left is None or right is None else self.inner.same(left, right)

    def hashed(self, value: Any) -> Any:
        return None if value is None else self.inner.hashed(value)


class LiteralKind(Kind):
    """One of the values that the annotation lists: all of them texts, all integers, or all truth values."""

    def __init__(self, choices: tuple[Any, ...], kind: Kind) -> None:
        self.choices = choices
        self.spelling = " | ".join(map(repr, choices))
        self.expected = self.spelling if len(self.spelling) <= STRING_LIMIT else f"{self.spelling[:STRING_LIMIT]}..."
        self._kind = kind

    @property
    def base(self) -> str:
        return self._kind.spelling

    def check(self, value: Any, where: str) -> Any:
        kept = self._kind.check(value, where)
        if kept not in self.choices:
            raise wrong_value(where, self.expected, value)
        return kept

    def zero(self) -> Any:
        return self.choices[0]


def _integers() -> dict[str, Kind]:
    kinds: dict[str, Kind] = {}
    for bits in (8, 16, 32, 64):
        kinds[f"i{bits}"] = IntKind(f"i{bits}", -(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
        kinds[f"u{bits}"] = IntKind(f"u{bits}", 0, 2**bits - 1)
    return kinds


SCALARS: dict[str, Kind] = {
    **_integers(),
    "f64": FloatKind("f64", single=False),
    "f32": FloatKind("f32", single=True),
    "bool": BoolKind(),
    "char": TextKind("char", 0xFF),
    "wchar": TextKind("wchar", 0x10FFFF),
    "str": TextKind("str"),
    "bytes": BytesKind(),
    "stamp": StampKind(),
}


# -- moments -----------------------------------------------------------------------------------------------------------

_OF_64_BITS = IntKind("i64", -(2**63), 2**63 - 1)


class DateTimeKind(Kind):
    """A `datetime`, kept in UTC; it travels as nanoseconds since the epoch, and such an integer is accepted, too.

    A datetime counts whole microseconds: nanoseconds between two of them are refused, and nothing is rounded. 64 bits
    of nanoseconds reach from 1677 to 2262.
    """

    spelling = "datetime"
    expected = "a datetime with a time zone, from 1677-09-22 to 2262-04-11, or its nanoseconds since the epoch"

    @property
    def base(self) -> str:
        return "i64"

    def check(self, value: Any, where: str) -> datetime:
        from datetime import UTC, datetime, timedelta

        if isinstance(value, datetime):
            if value.utcoffset() is None:
                raise RecordError(f"{where}: expected {self.expected}, got {shown(value)} without one; add tzinfo=UTC")
            ns = datetime_ns(value) + getattr(value, "nanosecond", 0)  # which pandas adds to it
            if type(value) is datetime and value.tzinfo is UTC and -(2**63) <= ns < 2**63:
                return value
        elif isinstance(value, float) or not hasattr(value, "__index__"):
            raise wrong_type(where, self.expected, value)
        else:
            ns = _OF_64_BITS.check(value, where)
        if ns % 1000 or not -(2**63) <= ns < 2**63:
            raise wrong_value(where, f"{self.expected} (whole microseconds)", value)
        return datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=ns // 1000)

    def zero(self) -> datetime:
        return self.check(0, "datetime")


def datetime_ns(moment: datetime) -> int:
    """Nanoseconds from the epoch to a moment with a time zone, exactly."""
    from datetime import UTC, datetime

    since = moment - datetime(1970, 1, 1, tzinfo=UTC)
    return (since.days * 86_400 + since.seconds) * NS_PER_SEC + since.microseconds * 1000
