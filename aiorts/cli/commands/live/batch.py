"""`aiorts batch`: several commands for what runs, one after the other, over one session."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from typing import Any, Final

import click

from aiorts import exits
from aiorts.cli.commands.live.conf import text_of
from aiorts.cli.commands.live.target import sharing
from aiorts.cli.console.report import report, report_error
from aiorts.errors import AiortsError

_HERE: Final = __name__.rpartition(".")[0]
_LONGEST: Final = 65_536
"""Characters of a line: `shlex` takes the square of its length, 17 s for 1 MB."""


@click.command(short_help="Carry out commands for what runs, from a file.")
@click.argument("file", type=click.Path(dir_okay=False, allow_dash=True), metavar="FILE | -")
@click.option("--dry-run", is_flag=True, help="Only look whether each line is such a command.")
@click.option("--keep-going", is_flag=True, help="Go on after a line that fails; say at the end how many did.")
@click.pass_context
def batch(ctx: click.Context, file: str, dry_run: bool, keep_going: bool) -> int:
    """Carry out the commands in FILE, or on standard input, a line each as after `aiorts`; # begins a comment.

    Commands for what runs are taken: conf, connect, comp, ctx, call ... They share one session with each kernel that
    runs when it begins. The first that fails ends it with its own status, file and line before its message; what was
    done before stays. Where a line is no such command, none is carried out. With --keep-going the others are carried
    out all the same, and the status is that of the first that failed.
    """
    root: Any = ctx.find_root().command
    place = "standard input" if file == "-" else file
    lines = list(_lines(text_of(file), place))
    for number, words in lines:
        _check(ctx, root, f"{place}:{number}", words)
    if dry_run:
        return exits.DONE
    failed: list[int] = []
    with sharing():
        for number, words in lines:
            try:
                status = _carry_out(root, f"{place}:{number}", words)
            except AiortsError as error:
                if not keep_going:
                    raise
                report_error(error, verbose=False)
                status = exits.of_error(error)
            except click.ClickException as error:
                if not keep_going:
                    raise
                report("E-USAGE", error.format_message())
                status = error.exit_code
            if status:
                failed.append(status)
                if not keep_going:
                    break
    if keep_going and failed:
        click.echo(f"{place}: {len(failed)} of {len(lines)} commands failed", err=True)
    return failed[0] if failed else exits.DONE


def _lines(text: str, place: str) -> Iterator[tuple[int, list[str]]]:
    """The words of each line that has any, and its number."""
    for number, line in enumerate(text.splitlines(), 1):
        if len(line) > _LONGEST:
            long = f"a line of {len(line)} characters; at most {_LONGEST} are taken; give long values in a file"
            raise click.UsageError(f"{place}:{number}: {long}")
        try:
            words = shlex.split(line, comments=True)
        except ValueError as error:
            raise click.UsageError(f"{place}:{number}: {error}") from None
        if words[:1] == ["aiorts"]:
            del words[0]
        if words:
            yield number, words


def _check(ctx: click.Context, root: Any, place: str, words: list[str]) -> None:
    """Raise UsageError unless it is a command for what runs."""
    command = root.get_command(ctx, words[0])
    module = getattr(command.callback, "__module__", "") if command is not None else ""
    if not module.startswith(f"{_HERE}.") or module == __name__:
        raise click.UsageError(f"{place}: {words[0][:60]}: is no command for what runs, such as conf, connect, call")


def _carry_out(root: Any, place: str, words: list[str]) -> int:
    try:
        status = root.main(words, prog_name="aiorts", standalone_mode=False)
    except AiortsError as error:
        error.args = (f"{place}: {error}", *error.args[1:])
        raise
    except click.ClickException as error:
        raise click.UsageError(f"{place}: {error.format_message()}") from None
    if status:
        click.echo(f"{place}: ended with status {status}", err=True)
    return int(status or exits.DONE)
