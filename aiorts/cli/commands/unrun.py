"""Shared by the commands that look at a system without running it."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

import click

from aiorts import Catalogue
from aiorts.cli.console.plugins_option import catalogue_of as named
from aiorts.system import SystemFile

plugins_option = click.option(
    "--plugins",
    multiple=True,
    metavar="DIR",
    type=click.Path(path_type=Path),
    help="A folder with plugins, besides those that the file names; may be repeated.",
)


def catalogue_of(system: SystemFile | None, plugins: Iterable[Path]) -> Catalogue:
    """The installed extensions, those of the system file's folders, and those of these folders."""
    folders = () if system is None else system.plugin_paths
    return named((*folders, *plugins))


@contextlib.contextmanager
def quietly() -> Iterator[None]:
    """Send what component files print at import to standard error: standard output belongs to the command."""
    if sys.stderr is None:
        yield
        return
    with contextlib.redirect_stdout(sys.stderr):
        yield
