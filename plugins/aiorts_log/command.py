"""`aiorts log`: look at recordings, convert, cut, merge, compare, draw and salvage them."""

from __future__ import annotations

import errno
from typing import Any, Final

import click

from aiorts_log.comparing import diff
from aiorts_log.converting import convert, cut, merge
from aiorts_log.drawing import plot
from aiorts_log.import_command import import_command
from aiorts_log.look import cat, info
from aiorts_log.repair import salvage

__all__ = ("log",)


_FULL: Final = (errno.ENOSPC, errno.EIO, errno.EFBIG)


class _Group(click.Group):
    """Files that cannot be written are errors of their own; what is left is standard output."""

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except OSError as error:
            if error.errno not in _FULL or error.filename is not None:
                raise
            click.echo(f"aiorts: E-OUTPUT: standard output: {error}; its last lines are lost", err=True)
            return 1


@click.group(cls=_Group, short_help="Look at recordings; convert, compare, draw, salvage them.")
def log() -> None:
    """Look at recordings (MCAP, text, JSON lines); convert, cut, merge, compare, draw and salvage them."""


for _command in (info, cat, convert, cut, merge, diff, plot, import_command, salvage):
    log.add_command(_command)
