"""`aiorts batch`: runs several commands for running kernels, one after the other, in shared sessions."""

from __future__ import annotations

import contextlib
import io
import shlex
import sys
from collections.abc import Iterable
from typing import Any, Final

import click

from aiorts import exits
from aiorts.cli.commands.live.conf import text_of
from aiorts.cli.commands.live.showing import json_option
from aiorts.cli.commands.live.target import sharing
from aiorts.cli.console.output import say_json
from aiorts.cli.console.report import report
from aiorts.errors import AiortsError

_HERE: Final = __name__.rpartition(".")[0]
_LONGEST: Final = 65_536
"""Characters of the longest line: the time of `shlex` grows with the square of the length, to 17 s for 1 MB."""


@click.command(short_help="Carry out commands for what runs, from a file.")
@click.argument("file", type=click.Path(dir_okay=False, allow_dash=True), metavar="FILE | -")
@click.option("--dry-run", is_flag=True, help="Only look whether each line is such a command.")
@click.option("--keep-going", is_flag=True, help="Go on after a line that fails; say at the end how many did.")
@json_option("One JSON document: each command with its line, status, output and error.")
@click.pass_context
def batch(ctx: click.Context, file: str, dry_run: bool, keep_going: bool, as_json: bool) -> int:
    """Carry out the commands in FILE, or on standard input, a line each as after `aiorts`; # begins a comment.

    Commands for what runs are taken: conf, connect, comp, ctx, call ... They share one session with each kernel that
    runs when it begins. The first that fails ends it with its own status, file and line before its message; what was
    done before stays. Where a line is no such command, none is carried out. With --keep-going each line is carried out
    when it is read, whatever the others are, and each that fails or is no such command is named; the status is that of
    the first that failed.
    """
    place = "standard input" if file == "-" else file
    done = _Done(ctx, place, keep_going=keep_going, as_json=as_json)
    lines: Iterable[str] = sys.stdin if keep_going and file == "-" else text_of(file).splitlines()
    if not keep_going:
        for number, line in enumerate(lines, 1):
            done.check(number, line)
    with contextlib.nullcontext() if dry_run else sharing():
        for number, line in enumerate(lines, 1):
            if done.carry_out(number, line, dry_run=dry_run) and not keep_going:
                break
    return done.end()


class _Done:
    """The runner of the commands, with the outcome of each."""

    def __init__(self, ctx: click.Context, place: str, *, keep_going: bool, as_json: bool) -> None:
        self._ctx, self._place = ctx, place
        self._root: Any = ctx.find_root().command
        self._keep_going, self._as_json = keep_going, as_json
        self._commands: list[dict[str, Any]] = []

    def check(self, number: int, line: str) -> list[str]:
        """Check a line; returns its words, none for a blank line.

        Raises:
            UsageError: the line is too long, its quotes are open, or it is no command for running kernels.
        """
        words = _words(line, f"{self._place}:{number}")
        if not words:
            return words
        command = self._root.get_command(self._ctx, words[0])
        module = getattr(command.callback, "__module__", "") if command is not None else ""
        if not module.startswith(f"{_HERE}.") or module == __name__:
            place = f"{self._place}:{number}: {words[0][:60]}"
            raise click.UsageError(f"{place}: is no command for what runs, such as conf, connect, call")
        return words

    def carry_out(self, number: int, line: str, *, dry_run: bool) -> int:
        """Carry out a line, or only check whether it is a command; returns the status."""
        output, status, why = io.StringIO(), exits.DONE, None
        words = [line[:60]]
        try:
            words = self.check(number, line)
            if not words:
                return exits.DONE
            if not dry_run:
                with contextlib.redirect_stdout(output) if self._as_json else contextlib.nullcontext():
                    status = _carry_out(self._root, f"{self._place}:{number}", words)
        except (AiortsError, click.ClickException) as error:
            if not (self._keep_going or self._as_json):
                raise
            code, text = (
                ("E-USAGE", error.format_message()) if isinstance(error, click.ClickException) else _said(error)
            )
            why = {"code": code, "text": text}
            report(code, text)
            status = error.exit_code if isinstance(error, click.ClickException) else exits.of_error(error)
        self._commands.append(
            {"line": number, "command": words, "status": status, "output": output.getvalue(), "error": why}
        )
        return status

    def end(self) -> int:
        """Print the outcome; returns the status of the first command that failed."""
        failed = [one["status"] for one in self._commands if one["status"]]
        if self._as_json:
            say_json({"commands": self._commands, "failed": len(failed)})
        if self._keep_going and failed:
            click.echo(f"{self._place}: {len(failed)} of {len(self._commands)} commands failed", err=True)
        return failed[0] if failed else exits.DONE


def _said(error: AiortsError) -> tuple[str, str]:
    return error.code, str(error)


def _words(line: str, place: str) -> list[str]:
    """The words of a line, without `aiorts` before them.

    Raises:
        UsageError: the line is too long, or its quotes are open.
    """
    if len(line) > _LONGEST:
        long = f"a line of {len(line)} characters; at most {_LONGEST} are taken; give long values in a file"
        raise click.UsageError(f"{place}: {long}")
    try:
        words = shlex.split(line, comments=True)
    except ValueError as error:
        raise click.UsageError(f"{place}: {error}") from None
    return words[1:] if words[:1] == ["aiorts"] else words


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
