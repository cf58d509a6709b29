"""Formats a sample for FlexiDump: a line of text, JSON, CSV or bare values.

Every control character is replaced by its number, so that no sample can command a terminal.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator, Sequence
from typing import Any, Final

from aiorts.types import convert, fields_of, has_tm, read_path, to_plain
from aiorts.wire import json_text, split_sample

FORMATS: Final = ("text", "json", "csv", "values")


def line_of(
    style: str, name: str, type_name: str, sample: Any, fields: Sequence[str] = (), arrived: int | None = None
) -> str:
    """Format a sample of the port `name` as one line, without its end.

    `arrived`, in ns, replaces the sample's own time in the line.

    Raises:
        RecordError, InvalidNameError: the sample has no such field.
    """
    tm, data = (_time_of(sample), _chosen(sample, fields)) if fields else split_sample(sample)
    tm = tm if arrived is None else arrived
    if style == "json":
        line: dict[str, Any] = {"port": name, "type": type_name}
        return json_text({**line, **({} if tm is None else {"tm": tm}), "data": data})
    if style == "csv":
        return _csv([name, type_name, "" if tm is None else stamp_text(tm), *_leaves(data)])
    if style == "values":
        return " ".join(_value_text(value) for value in _leaves(data))
    stamp = "" if tm is None else f" {stamp_text(tm)}"
    return f"{printable(name)} {type_name}{stamp}: {_quoted(data, fields)}"


def news_of(name: str, type_name: str, sample: Any, arrived: int | None = None) -> str:
    """Format one line, without its end, that reports the arrival of a sample without its data."""
    tm = _time_of(sample) if arrived is None else arrived
    return f"{printable(name)} {type_name}{'' if tm is None else f' {stamp_text(tm)}'} has new data"


def stamp_text(tm: int) -> str:
    """Format nanoseconds as seconds with nine decimals."""
    return f"{tm // 1_000_000_000}.{tm % 1_000_000_000:09d}"


def printable(text: str) -> str:
    """The text with every control character, line ends and escapes included, as \\xNN or \\uNNNN."""
    if text.isprintable():
        return text
    return "".join(character if character.isprintable() else _number_of(character) for character in text)


def _number_of(character: str) -> str:
    code = ord(character)
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"


def _time_of(sample: Any) -> int | None:
    return int(sample.tm) if has_tm(type(sample)) else None


def _chosen(sample: Any, fields: Sequence[str]) -> Any:
    return {path: _plain(read_path(sample, full_path(type(sample), path))) for path in fields}


def full_path(cls: type, path: str) -> str:
    """A field path of `cls`; a path that the record does not have is looked for below its field `data`."""
    first = re.split(r"[.\[]", path, maxsplit=1)[0]
    names = {field.name for field in fields_of(cls)} if hasattr(cls, "__dataclass_fields__") else set()
    return f"data.{path}" if first not in names and "data" in names and first not in ("sec", "nsec") else path


def _plain(value: Any) -> Any:
    if isinstance(value, bool | int | float | str | bytes) or hasattr(value, "__dataclass_fields__"):
        return to_plain(value)
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if value is None or hasattr(value, "utcoffset"):
        return None if value is None else convert(value, "i64")
    return str(getattr(value, "name", value))


def _quoted(data: Any, fields: Sequence[str]) -> str:
    if fields:
        return " ".join(f"{path}={_quoted(data[path], ())}" for path in fields)
    return json_text(data)


def _leaves(data: Any) -> Iterator[Any]:
    if isinstance(data, dict):
        for value in data.values():
            yield from _leaves(value)
    elif isinstance(data, list):
        for value in data:
            yield from _leaves(value)
    else:
        yield data


def _value_text(value: Any) -> str:
    return printable(value) if isinstance(value, str) else json_text(value)


def _csv(values: Sequence[Any]) -> str:
    buffer = io.StringIO()
    csv.writer(buffer, lineterminator="").writerow([_value_text(value) for value in values])
    return buffer.getvalue()
