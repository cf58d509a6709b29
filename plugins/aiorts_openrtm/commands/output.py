"""The output that the commands share: files, and notes on what could not be carried over."""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterable
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Final

import click

from aiorts import exits
from aiorts.system import standard_output
from aiorts_openrtm.errors import OpenRTMError
from aiorts_openrtm.notes import Note

_MOST_LINES: Final = 200


def write(text: str, output: str, *, force: bool) -> None:
    """Write a file whole or not at all; "-" is standard output.

    Raises:
        OpenRTMError: the file is there already, or cannot be written.
    """
    if output == "-":
        standard_output().write(text)
        return
    path = Path(os.path.realpath(output))
    check_free(output, force=force)
    draft = ""
    try:
        with NamedTemporaryFile("w", encoding="utf-8", dir=path.parent, prefix=f".{path.name}.", delete=False) as file:
            draft = file.name
            file.write(text)
        mode = path.stat().st_mode & 0o777 if path.exists() else 0o666 & ~_umask()
        os.chmod(draft, mode)
        os.replace(draft, path)
    except OSError as error:
        with contextlib.suppress(OSError):
            os.unlink(draft)
        raise OpenRTMError(f"{output}: cannot be written: {error.strerror or error}") from None


def check_free(output: str, *, force: bool) -> None:
    """Raise OpenRTMError where a file is there already, unless it may be overwritten."""
    if output != "-" and not force and os.path.lexists(output):
        raise OpenRTMError(f"{output}: is there already; --force overwrites it")


def tell(text: str, notes: Iterable[Note], output: str, *, as_json: bool) -> int:
    """Print the notes, and the text if no file has it; return the exit status."""
    if as_json:
        _say_json(text, notes)
    else:
        if output == "-":
            standard_output().write(text)
        _say(notes)
    return exits.DONE


def _say(notes: Iterable[Note]) -> None:
    """Print the notes on standard error, one a line."""
    listed = sorted(notes, key=_place)
    for note in listed[:_MOST_LINES]:
        click.echo(f"note: {safe(note)}", err=True)
    if len(listed) > _MOST_LINES:
        click.echo(f"note: and {len(listed) - _MOST_LINES} more; --json has all", err=True)


def _say_json(text: str, notes: Iterable[Note]) -> None:
    """Print the text and the notes as one JSON document."""
    listed = [{"where": note.where, "text": note.text} for note in notes]
    standard_output().write(json.dumps({"text": text, "notes": listed}, ensure_ascii=False, indent=1) + "\n")


def safe(text: object) -> str:
    """A text with control characters escaped, so that it cannot command a terminal."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in str(text)[:1000])


def _place(note: Note) -> tuple[str, int]:
    """The key that sorts notes by file and line; notes without a line come first."""
    file, _, line = note.where.rpartition(":")
    return (file, int(line)) if file and line.isdigit() and len(line) < 12 else (note.where, 0)


def _umask() -> int:
    mask = os.umask(0o077)
    os.umask(mask)
    return mask
