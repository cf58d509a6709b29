"""Turns a record into the cells of a table and back: a column for each number, text and truth value, JSON for the rest.

Numbers come back to the bit (a NaN as a NaN, -0.0 with its sign) and texts unchanged; a text that a spreadsheet would
run as a formula has an apostrophe in front. Sequences, maps and arrays are one cell of JSON. An absent value is an
empty cell; an empty text that may be absent is "", in its quotes. Cells of tables made elsewhere are parsed strictly:
the whole cell has to be a number, and fit its field.
"""

from __future__ import annotations

import base64
import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from decimal import Decimal, InvalidOperation
from operator import attrgetter
from typing import Any, Final, NamedTuple, TypeAlias

from aiorts.errors import ConfigurationError, RecordError
from aiorts.types import describe, from_plain, has_tm, to_plain
from aiorts.wire import json_text
from aiorts_log.text.csv_format import defused, original

VALUE: Final = "value"
"""The column of a port whose samples are bare values."""
_NUMBER: Final = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d{1,4})?", re.ASCII)
_INTEGER: Final = re.compile(r"[+-]?\d{1,40}", re.ASCII)
_ODD: Final = {"nan": math.nan, "inf": math.inf, "infinity": math.inf}
_ITEM: Final = re.compile(r"(.+)\[(\d{1,5})\]")
_LONGEST: Final = 40


class Column(NamedTuple):
    """A column: field path, content of its cells (float, int, bool, text or json; with ? maybe absent), kind's name."""

    path: str
    content: str
    spelling: str


def columns_of(cls: type) -> tuple[Column, ...]:
    """The columns of a type, in the order of its fields."""
    if not hasattr(cls, "__dataclass_fields__"):
        content = "text" if cls in (str, bytes) else cls.__name__
        return (Column(VALUE, content, cls.__name__),)
    return tuple(_columns(cls, ""))


def _columns(cls: type, front: str) -> list[Column]:
    found = []
    for field in describe(cls).fields:
        kind: Any = field.kind
        path = f"{front}{field.name}"
        if hasattr(kind, "structure") and kind.structure.fields:
            found += _columns(kind.cls, f"{path}.")
        else:
            found.append(Column(path, _content(kind), field.spelling))
    return found


def _content(kind: Any) -> str:
    if hasattr(kind, "inner"):
        return f"{_content(kind.inner)}?"
    spelling = str(kind.base)
    if hasattr(kind, "enumeration") or spelling in ("str", "char", "wchar", "bytes", "seq[u8]"):
        return "text"
    if spelling in ("f32", "f64"):
        return "float"
    if spelling == "bool":
        return "bool"
    return "int" if spelling == "stamp" or re.fullmatch(r"[iu]\d+", spelling) else "json"


# -- out -----------------------------------------------------------------------------------------------------------


def cells_of(cls: type) -> Callable[[Any], list[str]]:
    """A function that makes the cells of a record, in the order of `columns_of`. It raises RecordError."""
    columns = columns_of(cls)
    puts = [_putter(column.content) for column in columns]
    if not hasattr(cls, "__dataclass_fields__"):
        return lambda value: [puts[0](to_plain(value))]
    if is_numbers(columns):
        get = attrgetter(*(column.path for column in columns))  # numbers are the same in a record as in plain data
        return lambda record: [put(value) for put, value in zip(puts, get(record), strict=True)]
    paths = [column.path.split(".") for column in columns]

    def cells(record: Any) -> list[str]:
        plain = to_plain(record)
        found = []
        for path, put in zip(paths, puts, strict=True):
            value = plain
            for name in path:
                value = value[name]
            found.append(put(value))
        return found

    return cells


def is_numbers(columns: Sequence[Column]) -> bool:
    """Whether there are at least two columns, and each has a number that is the same in a record as in plain data."""
    return len(columns) > 1 and all(one.content in ("float", "int") and one.spelling != "datetime" for one in columns)


def _putter(content: str) -> Callable[[Any], str]:
    if not content.endswith("?"):
        return _PUT[content]
    put = _put_text if content == "text?" else _PUT[content[:-1]]
    return lambda value: "" if value is None else put(value)


def _put_text(text: str) -> str:
    """The cell of a text that may be absent: JSON where the text is empty or looks like JSON."""
    return json_text(text) if not text or text.startswith('"') else defused(text)


def _put_float(value: Any) -> str:
    return _NAMES[value] if isinstance(value, str) else repr(value)


_NAMES: Final = {"NaN": "nan", "Infinity": "inf", "-Infinity": "-inf"}
_PUT: Final[dict[str, Callable[[Any], str]]] = {
    "float": _put_float,
    "int": str,
    "bool": lambda value: "true" if value else "false",
    "text": lambda value: defused(str(value)),
    "json": json_text,
}


# -- in ------------------------------------------------------------------------------------------------------------


def taker_of(cls: type, fields: Mapping[str, int], empty_is_nan: bool = False) -> Callable[[Sequence[str], int], Any]:
    """A function that makes a record from the cells of a row.

    Args:
        fields: the number of the cell for each field path; items of a number sequence as `data[0]`, `data[1]`, ...
        empty_is_nan: take an empty cell as a NaN where a float stands.

    Returns:
        A function of the row and of the `tm` of a type that has one, where no cell gives it. It raises RecordError.

    Raises:
        ConfigurationError: a named field does not exist, or a needed one has no cell.
    """
    columns = {column.path: column for column in columns_of(cls)}
    places: dict[str, int | list[int]] = {}
    for path, number in fields.items():
        item = _ITEM.fullmatch(path)
        if path in columns:
            places[path] = number
        elif item is not None and item[1] in columns and columns[item[1]].spelling.startswith("seq["):
            _put_item(places.setdefault(item[1], []), int(item[2]), number, path)
        else:
            raise ConfigurationError(f"{cls.__name__} has no field {path[:60]!r}; it has {', '.join(columns)}")
    times = {"tm", "tm.sec"} & columns.keys() if has_tm(cls) else set()
    stamped = bool(times) and not any(path == "tm" or path.startswith("tm.") for path in places)
    missing = [path for path in columns if path not in places and not (stamped and path.split(".")[0] == "tm")]
    if missing:
        raise ConfigurationError(
            f"{cls.__name__}.{missing[0]}: has no column; --map COLUMN={missing[0]}, or --set {missing[0]}=VALUE"
        )
    leaves = {path: _leaf(columns[path], place, empty_is_nan) for path, place in places.items()}
    if stamped:
        leaves |= _TM_NESTED if "tm.sec" in times else _TM
    if not hasattr(cls, "__dataclass_fields__"):
        of_value = leaves[VALUE]
        return lambda row, tm: from_plain(cls, of_value(row))
    if all(column.content in ("float", "int", "bool") for column in columns.values()) and _is_checked(cls):
        build = _builder(cls, leaves, "")
        return lambda row, tm: build([*row, tm])
    paths = [(path.split("."), leaf) for path, leaf in leaves.items()]

    def take(row: Sequence[str], tm: int) -> Any:
        plain: dict[str, Any] = {}
        cells = [*row, tm]
        for path, leaf in paths:
            inner = plain
            for name in path[:-1]:
                inner = inner.setdefault(name, {})
            inner[path[-1]] = leaf(cells)
        return from_plain(cls, plain)

    return take


_Leaf: TypeAlias = Callable[[Sequence[Any]], Any]
"""A function that makes one value from the cells of a row, which the row's time follows."""
_TM: Final[dict[str, _Leaf]] = {"tm": lambda cells: cells[-1]}
_TM_NESTED: Final[dict[str, _Leaf]] = {
    "tm.sec": lambda cells: cells[-1] // 10**9,
    "tm.nsec": lambda cells: cells[-1] % 10**9,
}


def _leaf(column: Column, place: int | list[int], empty_is_nan: bool) -> _Leaf:
    path, take = column.path, _taker(_content_of(column, place), empty_is_nan)
    is_bytes = column.spelling == "seq[u8]"

    def leaf(cells: Sequence[Any]) -> Any:
        try:
            if isinstance(place, int):
                return take(cells[place])
            items = [take(cells[number]) for number in place]
            return _base64(items) if is_bytes else items
        except RecordError as error:
            raise RecordError(f"{path}: {error}") from None

    return leaf


def _is_checked(cls: type) -> bool:
    """Whether the constructor checks its arguments, and those of nested records do as well."""
    structure = describe(cls)
    kinds: list[Any] = [field.kind for field in structure.fields]
    return structure.checked and all(_is_checked(kind.cls) for kind in kinds if hasattr(kind, "structure"))


def _builder(cls: type, leaves: Mapping[str, _Leaf], front: str) -> _Leaf:
    """A faster `from_plain`, for records of numbers alone."""
    parts: list[_Leaf] = []
    for field in describe(cls).fields:
        kind: Any = field.kind
        path = f"{front}{field.name}"
        parts.append(leaves[path] if path in leaves else _builder(kind.cls, leaves, f"{path}."))
    return lambda cells: cls(*[part(cells) for part in parts])


def _put_item(places: int | list[int], index: int, number: int, path: str) -> None:
    if isinstance(places, int) or index != len(places):
        raise ConfigurationError(f"{path}: items are mapped in order, from [0]")
    places.append(number)


def _content_of(column: Column, place: int | list[int]) -> str:
    """The content of the cells of a field: the whole field, or an item each."""
    if isinstance(place, int):
        return column.content
    element = column.spelling[4:-1]
    return {"f": "float", "b": "bool"}.get(element[0], "int")


def _taker(content: str, empty_is_nan: bool) -> Callable[[str], Any]:
    if content.endswith("?"):
        take = _take_text if content == "text?" else _TAKE[content[:-1]]
        return lambda text: take(text) if (text if content == "text?" else text.strip()) else None
    taken = _TAKE[content]
    if empty_is_nan and content == "float":
        return lambda text: taken(text) if text.strip() else math.nan
    return taken


def _take_text(text: str) -> Any:
    return _json(text) if text.startswith('"') else original(text)


def _base64(values: list[int]) -> str:
    try:
        return base64.b64encode(bytes(values)).decode("ascii")
    except ValueError:
        raise RecordError(f"expected integers 0..255, got {max(values, key=abs)}") from None


def _float(text: str) -> float:
    text = text.strip()
    if _NUMBER.fullmatch(text):
        number = float(text)
        if math.isfinite(number):
            return number
        raise RecordError(f"{text[:_LONGEST]!r} is too large for a number of 64 bits")
    odd = _ODD.get(text.lstrip("+-").lower()) if len(text) - len(text.lstrip("+-")) < 2 else None
    if odd is None:
        raise RecordError(f"expected a number, got {_quoted(text)}")
    return -odd if text[0] == "-" else odd


def _integer(text: str) -> int:
    text = text.strip()
    if _INTEGER.fullmatch(text):
        return int(text)
    try:
        number = Decimal(text) if _NUMBER.fullmatch(text) else Decimal("0.5")
        # Bounded: int(Decimal("1e9999")) has ten thousand digits.
        if number == number.to_integral_value() and abs(number) < 10**40:
            return int(number)
    except InvalidOperation:
        pass
    raise RecordError(f"expected an integer, got {_quoted(text)}")


def _bool(text: str) -> bool:
    found = _BOOLS.get(text.strip().lower())
    if found is None:
        raise RecordError(f"expected true or false, got {_quoted(text)}")
    return found


def _json(text: str) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise RecordError(f"no JSON: {str(error)[:60]}: {_quoted(text)}") from None


def _quoted(text: str) -> str:
    return repr(text if len(text) <= _LONGEST else f"{text[:_LONGEST]}...") if text else "nothing"


_BOOLS: Final = {"true": True, "false": False, "1": True, "0": False}
_TAKE: Final[dict[str, Callable[[str], Any]]] = {
    "float": _float,
    "int": _integer,
    "bool": _bool,
    "text": original,
    "json": _json,
}
