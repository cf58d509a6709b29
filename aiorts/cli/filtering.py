"""`aiorts filter NAME`: runs a component as a filter, also where a command has its name."""

from __future__ import annotations

from typing import Any

import click

from aiorts.cli.commands.offered import filter_named, offered
from aiorts.cli.console.completion import items
from aiorts.cli.console.plugins_option import catalogue_of
from aiorts.cli.group import strict
from aiorts.spelling import suggestion


def _names(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[Any]:
    return items(offered(catalogue_of(), "components"), incomplete)


@click.command(
    "filter",
    short_help="Run a component as a filter, whatever its name.",
    context_settings={"allow_interspersed_args": False, "ignore_unknown_options": True},
)
@click.argument("name", metavar="COMPONENT", shell_complete=_names)
@click.argument("words", nargs=-1, type=click.UNPROCESSED, metavar="[ITS OPTIONS]...")
@click.pass_context
def filter_(ctx: click.Context, name: str, words: tuple[str, ...]) -> Any:
    """Run COMPONENT as a Unix filter for JSON lines, as `aiorts COMPONENT` does where no command has its name.

    COMPONENT is an installed component in lower case or FILE.py:Class.
    """
    catalogue = catalogue_of()
    command = filter_named(name, catalogue)
    if command is None:
        names = list(offered(catalogue, "components"))
        raise click.UsageError(f"no component {name[:60]!r}; {suggestion(name, names)}", ctx)
    with strict(command).make_context(f"filter {name}", list(words), parent=ctx.parent) as inner:
        return command.invoke(inner)
