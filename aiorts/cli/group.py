"""The group of all commands for newcomers: sections of the help, completion of names, refusal of senseless options.

The group knows each command by its name and one line of help; it does not import commands.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

import click
from click.shell_completion import CompletionItem

_SECTIONS: Final = (
    ("Begin", "demo new doctor help", ""),
    ("Systems", "run check graph", "plan apply schema"),
    ("Look at what runs", "ls cat top print studio vlog", "find hz bw delay watch fsm"),
    (
        "Change what runs",
        "conf connect activate stop",
        "disconnect deactivate reset comp ctx call goal inject reload save batch exit",
    ),
    ("Recordings and figures", "record replay log bench", ""),
    ("What there is", "", "inspect doc types plugins filter completion"),
    ("Other machines and programs", "", "at router certs foxglove import export"),
    ("Short for others", "", "act con deact dis ui"),
)
"""Sections of the help, in order: title, the commands of the first screen, and the others. The commands are those of
aiorts and of the plugins that come with it."""


def write_sections(formatter: click.HelpFormatter, lines: Mapping[str, str], *, daily: bool) -> set[str]:
    """Write the sections of the commands among `lines` (name -> line of help), or only the daily ones.

    Returns:
        The names that have a section.
    """
    placed = {name for _, *names in _SECTIONS for name in " ".join(names).split() if name in lines}
    width = max(map(len, placed), default=0)
    for title, often, others in _SECTIONS:
        names = (often if daily else f"{often} {others}").split()
        if rows := [(name.ljust(width), lines[name]) for name in names if name in placed]:
            with formatter.section(title):
                formatter.write_dl(rows)
    return placed


class HelpfulGroup(click.Group):
    """A group that completes the names of its commands without importing them.

    `own` is the table of the group's commands: name -> target and one line of help.
    """

    own: Mapping[str, tuple[str, str]] = {}

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Complete names of commands, with their lines of help; options where the word begins with "-"."""
        if incomplete.startswith("-"):
            return click.Command.shell_complete(self, ctx, incomplete)
        lines = {name: self.own[name][1] if name in self.own else "" for name in self.list_commands(ctx)}
        return [CompletionItem(name, help=line) for name, line in lines.items() if name.startswith(incomplete)]


def strict(command: click.Command) -> click.Command:
    """Make a command refuse an option given twice (the first would be lost), NaN and infinity; returns the command.

    In a group, each of its commands is made so.

    NaN and infinity are refused where an option has a range: click lets NaN pass, as no comparison with it holds.
    """
    if isinstance(command, click.Group):
        for one in command.commands.values():
            strict(one)
        return command
    parse: Any = command.parse_args

    def parse_args(ctx: click.Context, args: list[str]) -> list[str]:
        try:
            if not ctx.resilient_parsing:
                _refuse_repetition(command, ctx, args)
            rest: list[str] = parse(ctx, args)
        except click.UsageError as error:
            if error.ctx is None:  # click's parser leaves it out where an option lacks its value
                error.ctx = ctx
            raise
        if not ctx.resilient_parsing:
            _refuse_endless(command, ctx)
        return rest

    if "parse_args" not in vars(command):
        vars(command)["parse_args"] = parse_args
    return command


def _refuse_endless(command: click.Command, ctx: click.Context) -> None:
    for param in command.params:
        value = ctx.params.get(str(param.name))
        if isinstance(param.type, click.FloatRange) and isinstance(value, float) and not math.isfinite(value):
            raise click.BadParameter(f"{value!r} is no finite number", ctx, param)


def _refuse_repetition(command: click.Command, ctx: click.Context, args: list[str]) -> None:
    _, _, order = command.make_parser(ctx).parse_args(list(args))
    seen: set[str] = set()
    for option in order:
        if not isinstance(option, click.Option) or option.multiple or option.is_flag or option.count:
            continue
        if str(option.name) in seen:
            raise click.UsageError(f"{option.opts[0]} is given twice; give it once", ctx)
        seen.add(str(option.name))
