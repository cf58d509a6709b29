"""Reads the bytes of a file as TOML tables: every fault has file, line and column, and none takes longer than a second.

A system file is a regular file of at most 1 MiB. Nothing else is opened: a pipe would wait, a device never ends.
"""

from __future__ import annotations

import os
import re
import stat
import tomllib
from itertools import islice
from pathlib import Path
from typing import Any, Final

from aiorts.errors import SystemFileError
from aiorts.model.configuration.toml_lines import TOO_LARGE, excess, huge_number
from aiorts.spelling import meant
from aiorts.system.text.places import places_of
from aiorts.system.text.reading import spelled

LARGEST: Final = 1024 * 1024
"""The most bytes of a system file."""
_AT: Final = re.compile(r" \(at (?:line (\d+), column (\d+)|end of document)\)$")
_DIGITS: Final = re.compile(r"\d[\d_]{4000}")


class NotToml(SystemFileError):
    """The text is no TOML, or none that a system file may have. Attributes: `line`, `column` (from 1) and `reason`."""

    def __init__(self, path: Path, text: str, line: int, column: int, reason: str) -> None:
        self.path, self.line, self.column, self.reason, self.text = path, line, column, reason, text
        super().__init__(f"{path}:{line}:{column}: {reason}")
        if text:
            text = text.replace("\r\n", "\n")  # as tomllib counts
            self.at(text, sum(len(one) + 1 for one in text.split("\n")[: line - 1]) + column - 1)


class HugeNumber(NotToml):
    """A number has more digits than any value may have; as TOML it is right."""

    code = "E-CONFIG"


def read_text(path: Path) -> str:
    """The text of a file, without a byte-order mark.

    Raises:
        SystemFileError: the path cannot be read, is no file, is too large, or not UTF-8 (then with line and column).
    """
    try:
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    except OSError as error:
        raise SystemFileError(f"{path}: cannot be read: {error.strerror or error}{_near_file(path)}") from None
    except ValueError as error:
        raise SystemFileError(f"{str(path)!r}: cannot be read: {error}") from None
    try:
        if not stat.S_ISREG(mode := os.fstat(handle).st_mode):
            raise SystemFileError(f"{path}: cannot be read: it is {_kind_of(mode)}; give the name of a file")
        with open(handle, "rb", closefd=False) as file:
            data = file.read(LARGEST + 1)
    except OSError as error:
        raise SystemFileError(f"{path}: cannot be read: {error.strerror or error}") from None
    finally:
        os.close(handle)
    if len(data) > LARGEST:
        raise SystemFileError(f"{path}: larger than {LARGEST} bytes; a system file is not")
    try:
        return data.decode("utf-8").removeprefix("\ufeff")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        before = data[data.rfind(b"\n", 0, error.start) + 1 : error.start].decode("utf-8", "replace")
        reason = f"not UTF-8 (byte {data[error.start]:#04x}); save the file with that encoding"
        raise NotToml(path, "", line, len(before) + 1, reason) from None


def tables(text: str, path: Path) -> dict[str, Any]:
    """The tables of a text. NotToml: the text is no TOML, or none that is allowed."""
    if len(text.encode("utf-8", "surrogatepass")) > LARGEST:
        raise SystemFileError(f"{path}: larger than {LARGEST} bytes; a system file is not")
    if (more := excess(text)) is not None:
        raise NotToml(path, text, *_line_and_column(text, more[0]), more[1])
    try:
        found = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        # Line and column are attributes from Python 3.14 on; the message has them in all versions.
        message = str(error)
        at = _AT.search(message)
        end = _line_and_column(text, len(text.rstrip()))
        line, column = (int(at[1]), int(at[2])) if at is not None and at[1] else end
        reason = message[: at.start()] if at is not None else message
        if at is not None and at[1] is None:
            reason += ", the file ends here"
        if text.split("\n", line)[line - 1][column - 1 :].startswith(("{i", "${")):
            reason += "; what has {i} or ${name} in it stands in quotes"
        raise NotToml(path, text, line, column, f"not valid TOML: {reason}") from None
    except (ValueError, RecursionError) as error:
        # A number has more digits than Python converts, or a date does not exist.
        if (number := _DIGITS.search(text)) is not None:
            raise HugeNumber(path, text, *_line_and_column(text, number.start()), TOO_LARGE) from None
        raise NotToml(path, text, 1, 1, f"not valid TOML: {str(error) or 'nested too deeply'}") from None
    if (key := huge_number(found)) is not None:
        place = places_of(text).value(key)
        raise HugeNumber(path, text, place.line, place.column, f"{spelled(key)}: {TOO_LARGE}")
    return found


def _line_and_column(text: str, position: int) -> tuple[int, int]:
    return text.count("\n", 0, position) + 1, position - text.rfind("\n", 0, position)


def _kind_of(mode: int) -> str:
    kinds = (
        (stat.S_ISDIR, "a directory"),
        (stat.S_ISFIFO, "a pipe"),
        (stat.S_ISCHR, "a device"),
        (stat.S_ISBLK, "a device"),
        (stat.S_ISSOCK, "a socket"),
    )
    return next((word for test, word in kinds if test(mode)), "no regular file")


def _near_file(path: Path) -> str:
    """The hint at a file of nearly that name, for one that is not there."""
    try:
        files = [] if path.exists() else islice(path.parent.glob("*.toml"), 1000)
        names = {found.stem: found.name for found in files if found.name != path.name}  # which may be a dead link
    except (OSError, ValueError):
        return ""
    return meant(path.stem, names, lambda near: repr(str(path.parent / names[near])))
