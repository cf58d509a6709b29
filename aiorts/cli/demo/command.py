"""The command `aiorts demo`: runs the demo, prints its source, or saves its files without overwriting any."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import Final

import click

from aiorts import exits
from aiorts.cli.console.output import say, say_now
from aiorts.errors import ConfigurationError

_FILES: Final = {"motor.py": "motor.py", "system.toml": "system.toml", "test_motor.py": "test_motor.txt"}
"""Name of a saved file -> name in this package."""


@click.command(short_help="See a small system run; save it to begin with.")
@click.option("--source", is_flag=True, help="Print its components: one file that runs.")
@click.option("--save", "folder", type=click.Path(path_type=Path), metavar="DIR", help="Write its files into DIR.")
def demo(source: bool, folder: Path | None) -> int:
    """Run a motor and its controller for three seconds and draw what happens.

    Nothing is written but with --save, which makes DIR with a component file, a system file and tests.
    """
    if source and folder is not None:
        raise click.UsageError("--source and --save exclude each other")
    if source:
        say(_text("motor.py").rstrip("\n"))
        return exits.DONE
    if folder is not None:
        return _save(folder)
    from aiorts.cli.demo.show import show

    return show(say_now)


def _save(folder: Path) -> int:
    try:
        there = [name for name in _FILES if (folder / name).exists()]
        if there:
            raise ConfigurationError(f"{folder}: has {' and '.join(there)} already; nothing was written, name another")
        folder.mkdir(parents=True, exist_ok=True)
        for name, kept in _FILES.items():
            with (folder / name).open("x", encoding="utf-8", newline="\n") as file:
                file.write(_text(kept))
    except (OSError, ValueError) as error:
        if isinstance(error, ConfigurationError):
            raise
        raise ConfigurationError(f"{folder}: cannot be written: {getattr(error, 'strerror', None) or error}") from None
    saved = ", ".join(_FILES)
    say(f"{saved} are in {folder}. Try:\n")
    say(f"  aiorts run {folder / 'system.toml'}")
    say(f"  aiorts inspect {folder / 'motor.py'}:Motor")
    say(f'  python -m pytest {folder}      (pip install "aiorts[test]" first)')
    return exits.DONE


def _text(name: str) -> str:
    return files("aiorts.cli.demo").joinpath(name).read_text(encoding="utf-8")
