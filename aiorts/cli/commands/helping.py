"""`aiorts help`: prints the help of a command, or the meaning, cause and remedy of an error code."""

from __future__ import annotations

from difflib import get_close_matches
from typing import Any

import click

from aiorts import exits
from aiorts.cli.console.codes import CODES
from aiorts.cli.console.output import say, table


def _topics(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[Any]:
    from aiorts.cli.console.completion import items

    words = ctx.params.get("topic") or ()
    if tuple(words[:1]) == ("errors",):
        return items(CODES, incomplete)
    group = ctx.find_root().command
    names = group.list_commands(ctx) if isinstance(group, click.Group) else []
    return items((*names, "errors"), incomplete)


@click.command("help", short_help="Help for a command, or for an error code.")
@click.argument("topic", nargs=-1, metavar="[COMMAND | errors [E-CODE]]", shell_complete=_topics)
@click.pass_context
def help_(ctx: click.Context, topic: tuple[str, ...]) -> int:
    """Show the help of COMMAND; or all error codes, or what one of them means and what to do.

    aiorts help errors E-LINE
    """
    root = ctx.find_root()
    if topic and (topic[0] == "errors" or topic[0].upper().startswith(("E-", "W-", "N-"))):
        codes = topic[1:] if topic[0] == "errors" else topic
        say("\n\n".join(_explained(code) for code in codes) if codes else _all_codes())
        return exits.DONE
    command: click.Command = root.command
    context = root
    for name in topic:
        if not isinstance(command, click.Group):
            raise click.UsageError(f"{context.command_path} has no commands below it", ctx)
        found_name, found, _ = command.resolve_command(context, [name])
        if found is None:
            raise click.UsageError(f"no command {name[:60]!r}", ctx)
        context = click.Context(found, parent=context, info_name=found_name)
        command = found
    say(command.get_help(context))
    return exits.DONE


def _all_codes() -> str:
    rows = [(code, one.meaning) for code, one in sorted(CODES.items())]
    return f"{table(rows, indent='')}\n\naiorts help errors E-CODE shows its usual cause and what to do."


def _explained(code: str) -> str:
    one = CODES.get(code.upper())
    if one is None:
        near = get_close_matches(code[:60].upper(), CODES, n=1)
        hint = f"did you mean {near[0]}?" if near else "aiorts help errors lists them"
        raise click.UsageError(f"no error code {code[:60]!r}; {hint}")
    return f"{code.upper()}: {one.meaning}\n  cause   {one.cause}\n  remedy  {one.remedy}"
