"""The commands by name; a command's module is imported when it is used, so that `aiorts --help` stays fast."""

from __future__ import annotations

import importlib
import os
import sys
import traceback
from collections.abc import Sequence
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any, Final

import click

from aiorts import __version__
from aiorts.cli.plugins_option import catalogue_of, plugins_option
from aiorts.cli.report import printed, report
from aiorts.errors import AiortsError, PluginError

if TYPE_CHECKING:
    from aiorts import Extension

__all__ = ("BROKEN_PIPE", "aiorts", "own_commands", "run_command")

BROKEN_PIPE: Final = 141
"""128 + SIGPIPE: what a shell says of a command whose reader has gone."""

_COMMANDS: Final = {
    "run": ("aiorts.cli.run:run", "Run a system file."),
    "plugins": ("aiorts.cli.plugins:plugins", "List what plugins offer; --check imports each."),
    "bench": ("aiorts.bench.cli:bench", "Measure this machine: push policies, contexts, scale and more."),
}


_SHOWN: Final = 60
"""Components that the help names."""
_EXTENSION: Final = "aiorts.extension"
"""Where a context keeps who offers the command that runs, if a plugin does."""


class _LazyGroup(click.Group):
    """A group that knows the names and one line of help of its commands without importing them."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return [*_COMMANDS, *(name for kind in ("commands", "components") for name in _offered(kind))]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in _COMMANDS:
            return _of_plugin(ctx, cmd_name)
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
        if name not in _COMMANDS and not name.startswith("-") and name not in (names := self.list_commands(ctx)):
            near = get_close_matches(name[:60], names, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"there are {', '.join(names[:_SHOWN])}"
            raise click.UsageError(f"no command {name[:60]!r}; {hint}", ctx)
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; what one of a plugin raises is one line that names the plugin, and exit status 1."""
        try:
            return super().invoke(ctx)
        except (AiortsError, click.ClickException, click.exceptions.Exit, click.Abort, BrokenPipeError):
            raise
        except Exception as error:
            extension = ctx.meta.get(_EXTENSION)
            if extension is not None and not ctx.params["debug"]:
                cause = traceback.format_exception_only(error)[-1].strip()
                advice = f"`aiorts --debug {extension.name}` shows the traceback"
                report("E-PLUGIN", f"command {extension.name!r} of {extension.source}: {cause}; {advice}")
                return 1
            raise

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The list below "Commands" of the help; nothing is imported for it."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, help_text) for name, (_, help_text) in _COMMANDS.items()])
        if commands := {name: one for name, one in _offered("commands").items() if name not in _COMMANDS}:
            with formatter.section("Commands of plugins"):
                formatter.write_dl([(name, f"Of {printed(several[0].source)}.") for name, several in commands.items()])
        with formatter.section("Components, as filters"):
            names = [name for name in _offered("components") if name not in commands and name not in _COMMANDS]
            more = f" and {len(names) - _SHOWN} more, see aiorts plugins" if len(names) > _SHOWN else ""
            formatter.write_text(f"{', '.join(names[:_SHOWN])}{more}")


def own_commands() -> tuple[str, ...]:
    """The names that come before those of plugins."""
    return tuple(_COMMANDS)


def _of_plugin(ctx: click.Context, name: str) -> click.Command | None:
    from aiorts.cli.offered import command_named

    found = command_named(name, catalogue_of())
    if found is None:
        return None
    command, extension = found
    if extension.kind == "commands":
        ctx.meta[_EXTENSION] = extension
    return command


def _offered(kind: str) -> dict[str, tuple[Extension, ...]]:
    from aiorts.cli.offered import offered

    return offered(catalogue_of(), kind)


@click.group(cls=_LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, "-V", "--version", prog_name="aiorts", message="%(prog)s %(version)s")
@plugins_option
@click.option("--debug", is_flag=True, help="Show tracebacks of commands that plugins offer.")
def aiorts(debug: bool) -> None:
    """RT-Middleware for Python: robot software as components on an asyncio microkernel.

    Every component that is installed is a command as well, in lower case: a Unix filter for JSON lines, as in
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
