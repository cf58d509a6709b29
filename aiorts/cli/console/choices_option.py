"""`--var` and `--remap`: choices of the command line that are applied before a file is read as a system."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import click

from aiorts.system import Choices


def choices_options(command: Callable[..., int]) -> Callable[..., int]:
    """Add both options to a command; it gets them as one argument, `choices`."""

    @click.option("--var", "variables", multiple=True, metavar="NAME=VALUE", help="Set a variable of the system file.")
    @click.option(
        "--remap",
        "remaps",
        multiple=True,
        metavar="A.OUT=B.OUT",
        help="Put another port in the place of one, in all connections of the system file.",
    )
    @functools.wraps(command)
    def chosen(*args: Any, variables: tuple[str, ...], remaps: tuple[str, ...], **given: Any) -> int:
        return command(*args, **given, choices=Choices(variables, remaps))

    return chosen
