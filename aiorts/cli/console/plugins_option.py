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
"""The variable with plugin folders, separated as in PATH; those of the command line come first."""


def catalogue_of(more: Iterable[Path] = ()) -> Catalogue:
    """The extensions for this command: of installed packages, of the folders for every command, and of `more`."""
    known = Catalogue.default()
    added = [folder for folder in more if folder not in known.folders]
    return Catalogue((*known.folders, *added)) if added else known


def use_environment() -> None:
    """Make every command use the plugin folders of the environment."""
    Catalogue(map(_path, filter(None, os.environ.get(ENVIRONMENT, "").split(os.pathsep)))).make_default()


def _path(folder: str) -> Path:
    from pathlib import Path  # late: 4 ms, and most who ask for help name no folder

    return Path(folder)


def _named(context: click.Context, option: click.Parameter, folders: tuple[str, ...]) -> None:
    if folders:
        Catalogue(dict.fromkeys((*map(_path, folders), *Catalogue.default().folders))).make_default()


plugins_option = click.option(
    "--plugins",
    multiple=True,
    metavar="DIR",
    type=click.Path(exists=True, file_okay=False),
    help=f"A folder with plugins that are not installed; repeat for more, or set {ENVIRONMENT}.",
    is_eager=True,  # before --help, which lists plugins' commands, and before options that load a type
    expose_value=False,
    callback=_named,
)
"""The option of the group of all commands, and of each command that loads types (`with_plugins`)."""


def with_plugins(command: click.Command) -> click.Command:
    """Add the option --plugins to a command, or to each command of a group; returns the command."""
    if isinstance(command, click.Group):
        for one in command.commands.values():
            with_plugins(one)
    elif not any("--plugins" in one.opts for one in command.params):
        plugins_option(command)
    return command
