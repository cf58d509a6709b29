"""The commands by name; a command's module is imported when it is used, so that `aiorts --help` stays fast."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Sequence
from difflib import get_close_matches
from typing import Any, Final

import click

from aiorts import __version__
from aiorts.cli.report import report
from aiorts.errors import AiortsError, PluginError

__all__ = ("BROKEN_PIPE", "aiorts", "run_command")

BROKEN_PIPE: Final = 141
"""128 + SIGPIPE: what a shell says of a command whose reader has gone."""

_COMMANDS: Final = {
    "run": ("aiorts.cli.run:run", "Run a system file."),
    "check": ("aiorts.cli.check:check_command", "Check system files without running them."),
    "graph": ("aiorts.cli.graph:graph_command", "Draw a system file: mermaid, dot or svg."),
    "schema": ("aiorts.cli.schema:schema_command", "Print the JSON Schema of system files, for editors."),
    "plugins": ("aiorts.cli.plugins:plugins", "List what plugins offer; --check imports each."),
    "bench": ("aiorts.bench.cli:bench", "Measure this machine: push policies, contexts, scale and more."),
}


class _LazyGroup(click.Group):
    """A group that knows the names and one line of help of its commands without importing them."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(_COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in _COMMANDS:
            return _component_command(cmd_name)
        module, _, attribute = _COMMANDS[cmd_name][0].partition(":")
        try:
            command: Any = getattr(importlib.import_module(module), attribute)
        except ImportError as error:
            raise PluginError(f"aiorts {cmd_name}: cannot be loaded: {error}") from error
        return command if isinstance(command, click.Command) else None

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        name = args[0]
        if name not in _COMMANDS and not name.startswith("-") and name not in (filters := _filters()):
            near = get_close_matches(name, (*_COMMANDS, *filters), n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"there are {', '.join((*_COMMANDS, *filters))}"
            raise click.UsageError(f"no command {name[:60]!r}; {hint}", ctx)
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, help_text) for name, (_, help_text) in _COMMANDS.items()])


def _filters() -> dict[str, str]:
    """Components that are installed, by the name of their command."""
    from aiorts import Catalogue

    return {name.lower(): name for name in Catalogue().extensions("components")}


def _component_command(name: str) -> click.Command | None:
    component = _filters().get(name)
    if component is None:
        return None
    from aiorts.cli.filter import command_of, load_component

    return command_of(name, load_component(component))


@click.group(cls=_LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, "-V", "--version", prog_name="aiorts", message="%(prog)s %(version)s")
def aiorts() -> None:
    """RT-Middleware for Python: robot software as components on an asyncio microkernel.

    Every installed component is a command as well, in lower case: a Unix filter for JSON lines, as in
    `aiorts flexiconst -p TimedDouble -c 6.2 -r 50 --count 5 | aiorts flexidump -p TimedDouble`.
    """


def run_command(arguments: Sequence[str]) -> int:
    """Run one command; returns the exit status. What went wrong is one line on standard error."""
    try:
        status = aiorts.main(list(arguments), prog_name="aiorts", standalone_mode=False)
        return _flushed(status if isinstance(status, int) else 0)
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message(), err=True)
        return 2
    except click.ClickException as error:
        report("E-USAGE", _usage(error))
        return error.exit_code
    except click.Abort:
        return 130
    except AiortsError as error:
        report(error.code, str(error))
        return 2
    except BrokenPipeError:
        return _silenced()


def _usage(error: click.ClickException) -> str:
    context = getattr(error, "ctx", None)
    command = "aiorts" if context is None else context.command_path
    return f"{command}: {error.format_message().rstrip('.')}; see {command} --help"


def _flushed(status: int) -> int:
    """Give standard output what is left; a reader that has gone is no error, a full disk is one."""
    if sys.stdout is None:
        return status
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        return _silenced()
    except (OSError, ValueError) as error:
        _silenced()
        report("E-OUTPUT", f"standard output: {error}; its last lines are lost")
        return status or 1
    return status


def _silenced() -> int:
    """Point standard output nowhere, so that the interpreter does not complain when it ends."""
    try:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)
    except (OSError, ValueError, AttributeError):
        sys.stdout = None  # as Python itself has it when it is started without one
    return BROKEN_PIPE
