"""Reads the bytes of a file that others wrote: a regular file of at most 10 MB, in an encoding that is known."""

from __future__ import annotations

import codecs
import os
import re
import stat
from pathlib import Path
from typing import Final

from aiorts_openrtm.errors import OpenRTMError

LARGEST: Final = 10_000_000
"""The most bytes of a file."""
DEEPEST: Final = 64
"""The most levels of elements, or of tables and lists, inside each other."""
_ENCODING: Final = re.compile(rb"""^<\?xml[^>]{0,200}?\bencoding\s*=\s*["']([A-Za-z0-9._-]{1,40})["']""")
_KNOWN: Final = frozenset(
    codecs.lookup(name).name
    for name in ("utf-8", "ascii", "latin-1", "utf-16", "shift_jis", "cp932", "euc_jp", "iso2022_jp")
)
_MARKS: Final = ((codecs.BOM_UTF8, "utf-8"), (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"))


def read_bytes(path: Path) -> bytes:
    """The bytes of a regular file.

    Raises:
        OpenRTMError: it cannot be read, is no regular file, or too large.
    """
    try:
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    except (OSError, ValueError) as error:
        what = getattr(error, "strerror", None) or error
        raise OpenRTMError(f"{path}: cannot be read: {what}") from None
    try:
        if not stat.S_ISREG(os.fstat(handle).st_mode):
            raise OpenRTMError(f"{path}: cannot be read: it is no regular file; give the name of a file")
        with open(handle, "rb", closefd=False) as file:
            data = file.read(LARGEST + 1)
    except OSError as error:
        raise OpenRTMError(f"{path}: cannot be read: {error.strerror or error}") from None
    finally:
        os.close(handle)
    if len(data) > LARGEST:
        raise OpenRTMError(f"{path}: larger than {LARGEST} bytes; a file of OpenRTM is not")
    return data


def decoded(data: bytes, path: Path | str) -> str:
    """The text of the bytes, by their byte-order mark, else by an XML declaration, else as UTF-8.

    Raises:
        OpenRTMError: the encoding is not known, or does not allow the bytes; the message has the line.
    """
    name = next((name for mark, name in _MARKS if data.startswith(mark)), "")
    if not name:
        declared = _ENCODING.match(data)
        name = "utf-8" if declared is None else declared[1].decode("ascii")
    try:
        known = codecs.lookup(name).name
    except LookupError:
        known = ""
    if known not in _KNOWN:
        raise OpenRTMError(f"{path}:1: encoding {name!r} is not known; save the file as UTF-8")
    try:
        return data.decode(known).removeprefix("\ufeff")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise OpenRTMError(f"{path}:{line}: not {known}; save the file as UTF-8") from None
