"""`aiorts log`: look at recordings, convert, cut, merge, compare, draw and salvage them."""

from __future__ import annotations

import errno
from typing import Any, Final

import click

from aiorts import exits, import_types
from aiorts_log.commands.comparing import diff
from aiorts_log.commands.converting import convert, cut, merge
from aiorts_log.commands.drawing import plot
from aiorts_log.commands.export_command import export_command
from aiorts_log.commands.import_command import import_command
from aiorts_log.commands.look import cat, info
from aiorts_log.commands.repair import salvage

_FULL: Final = (errno.ENOSPC, errno.EIO, errno.EFBIG)


class _Group(click.Group):
    """A group that reports a full or failing standard output in one line; files have messages of their own."""

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except OSError as error:
            if error.errno not in _FULL or error.filename is not None:
                raise
            click.echo(f"aiorts: E-OUTPUT: standard output: {error}; its last lines are lost", err=True)
            return exits.FAILED


@click.group(cls=_Group, short_help="Look at recordings; convert, compare, draw, salvage them.")
def log() -> None:
    """Look at recordings (MCAP, text, JSON lines); convert, cut, merge, compare, draw and salvage them."""


def _import(ctx: click.Context, option: click.Parameter, modules: tuple[str, ...]) -> None:
    if not ctx.resilient_parsing:  # a shell that completes words
        import_types(modules)


for _command in (info, cat, convert, cut, merge, diff, plot, import_command, export_command, salvage):
    _command.params.append(
        click.Option(
            ["--type-mod"],
            multiple=True,
            metavar="MODULE",
            help="Import MODULE or FILE.py, which defines types; types that plugins offer need no import.",
            expose_value=False,
            callback=_import,
        )
    )
    log.add_command(_command)
