"""What the commands that look at a system without running it have in common."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

import click

from aiorts import Catalogue
from aiorts.cli.plugins_option import catalogue_of as named
from aiorts.system import SystemFile

__all__ = ("catalogue_of", "plugins_option", "quietly")

plugins_option = click.option(
    "--plugins",
    multiple=True,
    metavar="DIR",
    type=click.Path(path_type=Path),
    help="A folder with plugins, besides those that the file names; may be repeated.",
)


def catalogue_of(system: SystemFile | None, plugins: Iterable[Path]) -> Catalogue:
    """What is installed, what the system file's folders have, and what these folders have."""
    folders = () if system is None else system.plugin_paths
    return named((*folders, *plugins))


@contextlib.contextmanager
def quietly() -> Iterator[None]:
    """What component files print when they are imported goes to standard error: standard output is the command's."""
    if sys.stderr is None:
        yield
        return
    with contextlib.redirect_stdout(sys.stderr):
        yield
