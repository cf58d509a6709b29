"""`aiorts --plugins DIR` and AIORTS_PLUGINS: folders whose plugins every command sees, besides what is installed."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Final

import click

from aiorts import Catalogue

__all__ = ("ENVIRONMENT", "catalogue_of", "plugins_option", "use_environment")

ENVIRONMENT: Final = "AIORTS_PLUGINS"
"""Folders, separated as in PATH; those of the command line come first."""


def catalogue_of(more: Iterable[Path] = ()) -> Catalogue:
    """All that this command may use: what is installed, the folders named for every command, and `more`."""
    known = Catalogue.default()
    added = [folder for folder in more if folder not in known.folders]
    return Catalogue((*known.folders, *added)) if added else known


def use_environment(folders: Iterable[Path] = ()) -> None:
    """Have every command see the folders that the environment names, after these."""
    named = (Path(folder) for folder in os.environ.get(ENVIRONMENT, "").split(os.pathsep) if folder)
    Catalogue((*folders, *named)).make_default()


def _named(context: click.Context, option: click.Parameter, folders: tuple[Path, ...]) -> None:
    use_environment(folders)


plugins_option = click.option(
    "--plugins",
    multiple=True,
    metavar="DIR",
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    help=f"A folder with plugins that are not installed; repeat for more, or set {ENVIRONMENT}.",
    is_eager=True,  # before --help, which lists the commands of plugins
    expose_value=False,
    callback=_named,
)
"""For the group of all commands."""
