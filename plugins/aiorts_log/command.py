"""`aiorts log`: look at recordings, convert, cut, merge, compare, draw and salvage them."""

from __future__ import annotations

import click

from aiorts_log.comparing import diff
from aiorts_log.converting import convert, cut, merge
from aiorts_log.drawing import plot
from aiorts_log.look import cat, info
from aiorts_log.repair import salvage

__all__ = ("log",)


@click.group(short_help="Look at recordings; convert, compare, draw, salvage them.")
def log() -> None:
    """Look at recordings (MCAP, text, JSON lines); convert, cut, merge, compare, draw and salvage them."""


for _command in (info, cat, convert, cut, merge, diff, plot, salvage):
    log.add_command(_command)
