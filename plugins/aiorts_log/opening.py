"""Opens a recording whatever its form: MCAP by its magic, text and JSON lines by their form, and nothing else.

What is none of them is refused by its first octets; nothing that a file names is ever imported or run.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, Final, TypeAlias

from aiorts_log.errors import RecordingError
from aiorts_log.flat import FlatReader, open_regular
from aiorts_log.form import MAGIC
from aiorts_log.lines_form import LinesReader, looks_like_lines
from aiorts_log.reader import RecordingReader
from aiorts_log.source import Limits
from aiorts_log.text_form import TextReader, looks_like_text

__all__ = ("Recording", "form_of", "open_recording")

Recording: TypeAlias = RecordingReader | FlatReader
"""What reads a recording: `ports`, `start`, `end`, `count`, `samples(...)`, `records(...)`, `check()`, `close()`."""
_LOOKED_AT: Final = 65_536


def form_of(path: str | os.PathLike[str]) -> str:
    """The form of a recording: "mcap", "text" or "jsonl".

    Raises:
        RecordingError: it cannot be read, or is none of them; says what it looks like.
    """
    where = Path(path)
    file, size = open_regular(where)
    try:
        first = os.pread(file, min(size, _LOOKED_AT), 0)
    finally:
        os.close(file)
    if first[:5] == MAGIC[:5] or (first and MAGIC.startswith(first)):
        return "mcap"
    if looks_like_text(first):
        return "text"
    if looks_like_lines(first):
        return "jsonl"
    what = f"it begins with {first[:8]!r}" if first else "it is empty"
    raise RecordingError(
        f"{where}: no recording: {what}; a recording is MCAP, text or JSON lines (CSV: aiorts log convert)"
    )


def open_recording(path: str | os.PathLike[str], *, limits: Limits | None = None) -> Recording:
    """An open recording of any form.

    Raises:
        RecordingError: it cannot be read, or is no recording.
        DamagedError: not even its beginning can be read.
    """
    readers: dict[str, Any] = {"mcap": RecordingReader, "text": TextReader, "jsonl": LinesReader}
    reader: Recording = readers[form_of(path)](path, limits=limits)
    return reader
