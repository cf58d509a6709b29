"""`Conf`: the keys and values of a .conf file, each with its line; nothing in a value is looked up or expanded."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final

from aiorts_openrtm.errors import OpenRTMError
from aiorts_openrtm.markup.source import read_bytes

_SEPARATOR: Final = re.compile(r"(?<!\\)(?:\\\\)*[:=]")
_BLANK: Final = re.compile(r"(?<!\\)(?:\\\\)*[ \t]")
_ABOUT: Final = re.compile(r"(conf\.__\w+__\.[^\s:=,]+)\s*,\s+(.*)", re.DOTALL)
"""The form conf.__widget__.NAME, WIDGET of the files that RTCBuilder writes."""
_CONTINUED: Final = re.compile(r"(?<!\\)(?:\\\\)*\\\s*$")
_ESCAPED: Final = re.compile(r"\\(.)", re.DOTALL)
_ESCAPES: Final = {"t": "\t", "n": "\n", "f": "\f", "r": "\r"}
_ENCODINGS: Final = ("utf-8-sig", "cp932", "euc_jp")
ENVIRONMENT: Final = re.compile(r"\$[({]\w*[)}]")
"""The places that OpenRTM replaces by a variable of the environment."""


@dataclass(frozen=True, slots=True)
class Entry:
    """One key and its value."""

    key: str
    value: str
    where: str
    """FILE:LINE where it begins."""

    @property
    def items(self) -> tuple[str, ...]:
        """The parts of a value that is a list."""
        return tuple(part.strip() for part in self.value.split(",") if part.strip())


@dataclass(frozen=True)
class Conf:
    """A .conf file."""

    path: Path
    entries: tuple[Entry, ...]
    """The entries, in the order of the file; of several entries of a key the last counts."""

    @cached_property
    def last(self) -> dict[str, Entry]:
        """The entry that counts for each key, by key."""
        return {one.key: one for one in self.entries}

    def value(self, key: str, default: str = "") -> str:
        """The value of a key."""
        found = self.last.get(key)
        return default if found is None or not found.value else found.value

    def below(self, prefix: str) -> Iterator[tuple[str, Entry]]:
        """The keys that begin with the prefix, each without the prefix and with its entry."""
        for key, one in self.last.items():
            if key.startswith(prefix):
                yield key[len(prefix) :], one

    @classmethod
    def read(cls, path: Path) -> Conf:
        """Read a file.

        Raises:
            OpenRTMError: the file cannot be read, or a line of it is no text.
        """
        return cls.parse(_text(read_bytes(path), path), path)

    @classmethod
    def parse(cls, text: str, path: Path) -> Conf:
        """The entries of a text."""
        entries = []
        parts: list[str] = []
        begin = 0
        for number, line in enumerate(re.split(r"\r\n|\n|\r", text), start=1):
            stripped = line.lstrip(" \t\f")
            if not stripped.strip() or stripped[0] in "#!":
                continue
            begin = begin or number
            if _CONTINUED.search(stripped):
                parts.append(stripped.rstrip()[:-1].rstrip())
                continue
            entries.append(_entry("".join([*parts, stripped]), f"{path}:{begin}"))
            parts, begin = [], 0
        if parts:
            entries.append(_entry("".join(parts), f"{path}:{begin}"))
        return cls(path, tuple(one for one in entries if one.key))


def _entry(line: str, where: str) -> Entry:
    about = _ABOUT.fullmatch(line)
    if about is not None:
        key, value = about[1], about[2]
    else:
        found = _SEPARATOR.search(line) or _BLANK.search(line.rstrip())
        key, value = (line, "") if found is None else (line[: found.end() - 1], line[found.end() :])
    if "\0" in line:
        raise OpenRTMError(f"{where}: a NUL is no text; take it away")
    return Entry(_unescaped(key).strip(), _unescaped(value).strip(), where)


def _unescaped(text: str) -> str:
    return _ESCAPED.sub(lambda found: _ESCAPES.get(found[1], found[1]), text)


def _text(data: bytes, path: Path) -> str:
    """The text of the bytes: UTF-8, or an encoding of Japanese editors."""
    start = 0
    for encoding in _ENCODINGS:
        try:
            return data.decode(encoding)
        except UnicodeDecodeError as error:
            start = max(start, error.start)
    line = data.count(b"\n", 0, start) + 1
    raise OpenRTMError(f"{path}:{line}: neither UTF-8 nor Shift JIS nor EUC-JP; save the file as UTF-8")
