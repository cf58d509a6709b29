"""Output of a command: to standard output, or whole into a file."""

from __future__ import annotations

import os
from pathlib import Path

import click

from aiorts.errors import ConfigurationError


def give(output: str | None, text: str, *, force: bool = True) -> None:
    """Print the text, or write it to the file that `-o` names; an existing file needs `force`."""
    if output is None or output == "-":
        click.echo(text, nl=False)
    else:
        if not force and Path(output).is_file():
            raise ConfigurationError(f"-o {output}: is there already; --force overwrites it")
        _write(Path(output), text)


def _write(path: Path, text: str) -> None:
    """Write the whole text or nothing: an existing file is replaced when the new one is complete."""
    beside = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        if path.exists() and not path.is_file():
            path.write_text(text, encoding="utf-8")  # a device, a pipe
            return
        beside.write_text(text, encoding="utf-8")
        beside.replace(path)
    except OSError as error:
        beside.unlink(missing_ok=True)
        raise ConfigurationError(f"-o {path}: cannot be written: {error.strerror or error}") from None
