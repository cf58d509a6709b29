"""Checks whether a file can be recorded into, without touching it."""

from __future__ import annotations

import os
import stat
from dataclasses import replace
from pathlib import Path
from typing import Final

from aiorts_log.errors import RecordingError
from aiorts_log.mcap.locked_file import Existing, held_by, part_path
from aiorts_log.recorder.options import RecordingOptions

_MOST_PARTS: Final = 1_000_000
_TEXT: Final = (".csv", ".tsv", ".txt", ".log", ".json", ".jsonl", ".ndjson")


def unfit_name(path: Path) -> str:
    """The reason why a recording cannot have a name with the ending of a text; "" where it can."""
    how = f"record run.mcap, and `aiorts log convert run.mcap {path}` after it"
    return f"{path}: a recording is MCAP; {how}" if path.suffix.lower() in _TEXT else ""


def check_target(path: str | os.PathLike[str], existing: Existing) -> None:
    """Refuse a target where a recording clearly cannot be made; nothing is made or changed.

    A full disk, or another recorder that is faster, is found only when the file is opened.

    Raises:
        RecordingError: with the reason.
    """
    where = Path(path)
    if not where.name or "\0" in str(where):
        raise RecordingError(f"{str(where)!r}: expected the name of a file, such as run.mcap")
    try:
        mode = os.lstat(where).st_mode
    except FileNotFoundError:
        _check_folder(where)
        return
    except OSError as error:
        raise RecordingError(f"{where}: cannot be written: {error.strerror or error}") from None
    if not stat.S_ISREG(mode):
        raise RecordingError(f"{where}: is no regular file; a recording needs one")
    holder = held_by(where)
    if holder:
        raise RecordingError(f"{where}: {holder} writes it; name another file")
    if existing == "refuse":
        raise RecordingError(
            f"{where}: exists already; --append continues it, --overwrite replaces it, or name another file"
        )
    if not os.access(where, os.R_OK | os.W_OK):
        raise RecordingError(f"{where}: cannot be written: permission denied")


def check_parts(path: str | os.PathLike[str], options: RecordingOptions) -> None:
    """Raise RecordingError when files of a recording in several would mix with those of another one."""
    rotates = options.max_bytes is not None or options.max_seconds is not None
    if rotates and options.existing == "refuse" and os.path.lexists(other := part_path(Path(path), 1)):
        raise RecordingError(
            f"{other}: exists already, of another recording; move it away, or name another file than {path}"
        )


def _check_folder(where: Path) -> None:
    folder = where.absolute().parent
    if not folder.is_dir():
        raise RecordingError(f"{where}: there is no folder {str(folder)!r}; make it, or name another file")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise RecordingError(f"{where}: cannot be written: no permission in {str(folder)!r}")


def continuing(options: RecordingOptions, path: Path) -> RecordingOptions:
    """The options with which an existing recording is continued in its last file, if they append."""
    part = options.part
    while options.existing == "append" and part < _MOST_PARTS and part_path(path, part + 1).exists():
        part += 1
    return replace(options, part=part)
