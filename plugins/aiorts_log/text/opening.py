"""Opens a recording of any format: recognises MCAP, text and JSON lines by their first bytes, and refuses the rest.

Nothing that a file names is ever imported or run.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, Final, Literal

from aiorts_log.errors import RecordingError
from aiorts_log.mcap.format import MAGIC
from aiorts_log.mcap.reader import Recording, RecordingReader
from aiorts_log.mcap.source import Limits, open_regular, read_at
from aiorts_log.text.lines_format import LinesReader, looks_like_lines
from aiorts_log.text.text_format import TextReader, looks_like_text

_LOOKED_AT: Final = 65_536
LINES_ENDINGS: Final = (".jsonl", ".ndjson")
"""The endings of files of JSON lines; an empty file with one is an empty recording."""


def format_of(path: str | os.PathLike[str]) -> Literal["mcap", "text", "jsonl"]:
    """The format of a recording: "mcap", "text" or "jsonl".

    Raises:
        RecordingError: it cannot be read, or is none of them.
    """
    where = Path(path)
    file, size = open_regular(where)
    try:
        first = read_at(where, file, min(size, _LOOKED_AT), 0)
    finally:
        os.close(file)
    if first[:5] == MAGIC[:5] or (first and MAGIC.startswith(first)):
        return "mcap"
    if looks_like_text(first):
        return "text"
    if looks_like_lines(first) or (not first and where.suffix.lower() in LINES_ENDINGS):
        return "jsonl"
    # The first bytes are not shown: a kernel passes the message on to clients that may not read the file.
    what = "it begins as no recording does" if first else "it is empty"
    raise RecordingError(
        f"{where}: no recording: {what}; a recording is MCAP, text or JSON lines (CSV: aiorts log convert)"
    )


def open_recording(path: str | os.PathLike[str], *, limits: Limits | None = None) -> Recording:
    """Open a recording of any format.

    Raises:
        RecordingError: it cannot be read, or is no recording.
        DamagedError: not even its beginning can be read.
    """
    readers: dict[str, Any] = {"mcap": RecordingReader, "text": TextReader, "jsonl": LinesReader}
    reader: Recording = readers[format_of(path)](path, limits=limits)
    return reader
