"""`aiorts --plugins DIR` and AIORTS_PLUGINS: folders of plugins for every command, besides installed packages."""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import TYPE_CHECKING, Final

import click

from aiorts import Catalogue

if TYPE_CHECKING:
    from pathlib import Path


ENVIRONMENT: Final = "AIORTS_PLUGINS"
"""Folders, separated as in PATH; those of the command line come before them."""


def catalogue_of(more: Iterable[Path] = ()) -> Catalogue:
    """The extensions for this command: installed ones, those of the folders for every command, and of `more`."""
    known = Catalogue.default()
    added = [folder for folder in more if folder not in known.folders]
    return Catalogue((*known.folders, *added)) if added else known


def use_environment(folders: Iterable[str] = ()) -> None:
    """Make every command use the folders of the environment, after these."""
    named = [*folders, *filter(None, os.environ.get(ENVIRONMENT, "").split(os.pathsep))]
    Catalogue([_path(folder) for folder in named]).make_default()


def _path(folder: str) -> Path:
    from pathlib import Path  # late: 4 ms, and most who ask for help name no folder

    return Path(folder)


def _named(context: click.Context, option: click.Parameter, folders: tuple[str, ...]) -> None:
    use_environment(folders)


plugins_option = click.option(
    "--plugins",
    multiple=True,
    metavar="DIR",
    type=click.Path(exists=True, file_okay=False),
    help=f"A folder with plugins that are not installed; repeat for more, or set {ENVIRONMENT}.",
    is_eager=True,  # before --help, which lists the commands of plugins
    expose_value=False,
    callback=_named,
)
"""Belongs to the group of all commands."""
