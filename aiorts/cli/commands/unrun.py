"""Helpers of the commands that look at a system without running it."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator

from aiorts import Catalogue
from aiorts.cli.console.plugins_option import catalogue_of as named
from aiorts.system import SystemFile


def catalogue_of(system: SystemFile | None) -> Catalogue:
    """The extensions for this command, with those of the system file's plugin folders."""
    return named(() if system is None else system.plugin_paths)


@contextlib.contextmanager
def quietly() -> Iterator[None]:
    """Redirect the prints of imported component files to standard error, since standard output is the command's."""
    if sys.stderr is None:
        yield
        return
    with contextlib.redirect_stdout(sys.stderr):
        yield
