"""The commands by name; a command's module is imported when it is used, so that `aiorts --help` stays fast."""

from __future__ import annotations

import contextlib
import errno
import importlib
import os
import sys
from collections.abc import Sequence
from inspect import cleandoc
from typing import TYPE_CHECKING, Any, Final

import click

from aiorts import __version__, exits
from aiorts.cli.console.completion import completes
from aiorts.cli.console.output import say_json
from aiorts.cli.console.plugins_option import catalogue_of, plugins_option, use_environment, with_plugins
from aiorts.cli.console.report import printed, report, report_error
from aiorts.cli.group import HelpfulGroup, strict, write_sections
from aiorts.errors import AiortsError, PluginError
from aiorts.spelling import suggestion
from aiorts.tiers import tier_of_command

if TYPE_CHECKING:
    from aiorts import Extension

_COMMANDS: Final = {
    "run": ("aiorts.cli.commands.run:run", "Run a system file, or one component."),
    "check": ("aiorts.cli.commands.check:check_command", "Check system files without running them."),
    "plan": ("aiorts.cli.commands.planning:plan_command", "Show the steps from one system to another."),
    "apply": ("aiorts.cli.commands.applying:apply", "Change a system that runs into that of a file."),
    "graph": ("aiorts.cli.commands.graph:graph_command", "Draw a system file: mermaid, dot or svg."),
    "schema": ("aiorts.cli.commands.schema:schema_command", "Print the JSON Schema of system files, for editors."),
    "plugins": ("aiorts.cli.commands.plugins:plugins", "List what plugins offer; --check imports each."),
    "demo": ("aiorts.cli.demo.command:demo", "See a small system run; save it to begin with."),
    "new": ("aiorts.cli.new.command:new", "Write a plugin with a new component, to begin with."),
    "inspect": ("aiorts.cli.commands.inspection:inspect", "Show a component or a type without running it."),
    "doc": ("aiorts.cli.commands.doc:doc", "Write a page about a component: Markdown or HTML."),
    "types": ("aiorts.cli.commands.record_types:types", "List the record types that ports can have."),
    "ls": ("aiorts.cli.commands.live.look.ls:ls", "List the kernels that run, their components and ports."),
    "cat": ("aiorts.cli.commands.live.look.cat:cat", "Show a component, port, connector, context or kernel that runs."),
    "find": ("aiorts.cli.commands.live.look.find:find", "Find components and ports among what runs."),
    "activate": ("aiorts.cli.commands.live.lifecycle:activate", "Activate components that run."),
    "deactivate": ("aiorts.cli.commands.live.lifecycle:deactivate", "Deactivate components that run."),
    "reset": ("aiorts.cli.commands.live.lifecycle:reset", "Take components out of error."),
    "act": ("aiorts.cli.commands.live.lifecycle:activate", "Short for activate."),
    "batch": ("aiorts.cli.commands.live.batch:batch", "Carry out commands for what runs, from a file."),
    "call": ("aiorts.cli.commands.live.calling:call", "Call a service of what runs."),
    "comp": ("aiorts.cli.commands.live.components:comp", "Create and remove components; members of composites."),
    "con": ("aiorts.cli.commands.live.connecting:connect", "Short for connect."),
    "conf": ("aiorts.cli.commands.live.conf:conf", "Show and change parameters and sets of what runs."),
    "connect": ("aiorts.cli.commands.live.connecting:connect", "Connect ports of what runs; list connectors."),
    "ctx": ("aiorts.cli.commands.live.contexts:ctx", "List, start, stop and change execution contexts."),
    "deact": ("aiorts.cli.commands.live.lifecycle:deactivate", "Short for deactivate."),
    "dis": ("aiorts.cli.commands.live.connecting:disconnect", "Short for disconnect."),
    "disconnect": ("aiorts.cli.commands.live.connecting:disconnect", "End connectors of what runs."),
    "fsm": ("aiorts.cli.commands.live.machines:fsm", "Show a state machine, and send it events."),
    "goal": ("aiorts.cli.commands.live.calling:goal", "Send a goal, and show its feedback."),
    "replay": ("aiorts.cli.replaying:replay", "Replay a recording, alone or in a system."),
    "reload": ("aiorts.cli.commands.live.reloading:reload", "Replace the code of components that run."),
    "exit": ("aiorts.cli.commands.live.components:exit_", "Remove components that run."),
    "bw": ("aiorts.cli.commands.live.measure.rates:bw", "Show how many bytes pass a connector or port each second."),
    "delay": ("aiorts.cli.commands.live.measure.rates:delay", "Show how long samples are on their way, and how old."),
    "hz": ("aiorts.cli.commands.live.measure.rates:hz", "Show how many samples pass a connector or port each second."),
    "top": ("aiorts.cli.commands.live.measure.top:top", "Watch connectors, contexts and components of what runs."),
    "save": ("aiorts.cli.commands.live.saving:save", "Save what runs as a system file."),
    "vlog": ("aiorts.cli.commands.live.vlog:vlog", "Show the log of components that run, and set its level."),
    "print": ("aiorts.cli.commands.live.samples:print_", "Print the samples of an out-port that runs."),
    "inject": ("aiorts.cli.commands.live.samples:inject", "Write samples to an in-port that runs."),
    "watch": ("aiorts.cli.commands.live.watch:watch", "Print what happens in a kernel: states, connections, errors."),
    "stop": ("aiorts.cli.commands.live.lifecycle:stop", "End a run in order."),
    "filter": ("aiorts.cli.filtering:filter_", "Run a component as a filter, whatever its name."),
    "doctor": ("aiorts.cli.commands.doctor:doctor", "Look at this machine, and say what to do."),
    "completion": ("aiorts.cli.console.completion:completion", "Print the script that completes words in your shell."),
    "help": ("aiorts.cli.commands.helping:help_", "The guide; help for a command or an error code."),
}

_HIDDEN: Final = {"kernel": ("aiorts.cli.runtime.process_kernel:kernel", "")}
"""Commands that only aiorts itself calls; no help lists them."""
_NO_TYPES: Final = tuple(f"aiorts.cli.{one}" for one in ("commands.live.", "commands.helping", "console.", "demo."))
"""Modules of commands that load no types: the commands look into running kernels, or need no types."""
_FULL: Final = (errno.ENOSPC, errno.EIO, errno.EFBIG)
_SHOWN: Final = 60
"""Names of components that a message and `aiorts help commands` show."""
_SHOWN_FIRST: Final = 12
"""Names that the first screen of help shows, of components and of other plugins' commands."""
_DELIVERED: Final = {
    "aiorts_bench.cli:bench": "Measure this machine: push policies, contexts, scale and more.",
    "aiorts_foxglove.command:foxglove": "Show what runs in Foxglove.",
    "aiorts_log.commands.command:log": "Recordings: look, convert, compare, draw, salvage.",
    "aiorts_log.commands.record_command:record": "Record samples of what runs.",
    "aiorts_openrtm.commands.exporting:export": "Make a profile of OpenRTM of a system file.",
    "aiorts_openrtm.commands.importing:import_": "Make a system file of a file of OpenRTM.",
    "aiorts_studio.command:studio": "Show what runs in a browser.",
    "aiorts_zenoh.at_command:at": "Run a command with the kernels of another machine, too.",
    "aiorts_zenoh.router_command:router": "Carry what kernels say to each other.",
    "aiorts_zenoh.security.command:certs": "Make and check the certificates of a network.",
}
"""One line of help for the commands of plugins that come with aiorts; others have none before they are imported."""
_EXTENSION: Final = "aiorts.extension"
"""The key under which a click context keeps the extension that offers the running command."""


class _LazyGroup(HelpfulGroup):
    """A group that knows the names and one line of help of its commands without importing them."""

    own = _COMMANDS

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        use_environment()  # before --help, which click handles before options that are not given
        return super().parse_args(ctx, args)

    def list_commands(self, ctx: click.Context) -> list[str]:
        return [*_COMMANDS, *(name for kind in ("commands", "components") for name in _offered(kind))]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        found = self._found(ctx, cmd_name)
        if found is None:
            return None
        module = getattr(found.callback, "__module__", None) or ""
        command = _of_a_tier(found, cmd_name)
        return strict(command if module.startswith(_NO_TYPES) else with_plugins(command))

    def _found(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        own = _COMMANDS.get(cmd_name) or _HIDDEN.get(cmd_name)
        if own is None:
            return _of_plugin(ctx, cmd_name)
        module, _, attribute = own[0].partition(":")
        try:
            command: Any = getattr(importlib.import_module(module), attribute)
        except ImportError as error:
            raise PluginError(f"aiorts {cmd_name}: cannot be loaded: {error}") from error
        return command if isinstance(command, click.Command) else None

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        name = args[0]
        is_type = ":" in name or name.endswith(".py")  # FILE.py:Class is a filter
        known = name in _COMMANDS or name in _HIDDEN or name.startswith("-") or is_type
        if not known and name not in (names := self.list_commands(ctx)):
            from aiorts.kernel.extensions.uninstalled import named_in_project

            hint = named_in_project(name, "commands", "components") or suggestion(name, names)
            raise click.UsageError(f"no command {name[:60]!r}; {hint}", ctx)
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; an exception of a plugin's command becomes one line that names the plugin."""
        try:
            return super().invoke(ctx)
        except BrokenPipeError:
            return _silenced()  # before click ends the process with a status of its own
        except (AiortsError, click.ClickException, click.exceptions.Exit, click.Abort):
            raise
        except Exception as error:
            extension = ctx.meta.get(_EXTENSION)
            if extension is not None and not ctx.params["debug"]:
                from traceback import format_exception_only

                cause = format_exception_only(error)[-1].strip()
                advice = f"`aiorts --debug {extension.name}` shows the traceback"
                report("E-PLUGIN", f"command {extension.name!r} of {extension.source}: {cause}; {advice}")
                return exits.FAILED
            raise

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the daily commands below the options of the help, without importing them."""
        lines = _lines()
        placed = write_sections(formatter, lines, daily=True)
        others = [name for name in lines if name not in placed]
        components = [name for name in _offered("components") if name not in lines]
        with formatter.section("More"):
            if others:
                formatter.write_text(f"Commands of other plugins: {_names(others, _SHOWN_FIRST)}.")
            formatter.write_text(f"Components are commands, too, as filters: {_names(components, _SHOWN_FIRST)}.")
            formatter.write_text(
                f"`aiorts help commands` has all {len(lines)} commands, `aiorts help exit-status` what they end with."
            )

    def format_all(self, formatter: click.HelpFormatter) -> None:
        """Write the list of `aiorts help commands`: each command with its line of help, without importing it."""
        lines = _lines()
        placed = write_sections(formatter, lines, daily=False)
        if others := [(name, line) for name, line in lines.items() if name not in placed]:
            with formatter.section("Commands of other plugins"):
                formatter.write_dl(others)
        with formatter.section("Components, as filters"):
            formatter.write_text(_names([name for name in _offered("components") if name not in lines], _SHOWN))
        with formatter.section("Exit status"):
            formatter.write_dl(exits.TABLE)


def _lines() -> dict[str, str]:
    """The line of help of each command, by name."""
    own = {name: line for name, (_, line) in _COMMANDS.items()}
    return {name: _line_of(several[0]) for name, several in _offered("commands").items()} | own


def _names(names: Sequence[str], most: int) -> str:
    more = f" and {len(names) - most} more, see aiorts plugins" if len(names) > most else ""
    return f"{', '.join(names[:most])}{more}" or "none"


def _of_a_tier(command: click.Command, name: str) -> click.Command:
    """Add the line of its tier to the help of a command that is not stable."""
    tier, said = tier_of_command(name), cleandoc(command.help or "")
    if tier is not None and tier.line not in said:
        command.help = f"{said}\n\n{tier.line}"
    return command


def _line_of(command: Any) -> str:
    return _DELIVERED.get(command.target) or f"Of {printed(command.source)}."


def _of_plugin(ctx: click.Context, name: str) -> click.Command | None:
    from aiorts.cli.commands.offered import command_named

    found = command_named(name, catalogue_of())
    if found is None:
        return None
    command, extension = found
    if extension.kind == "commands":
        ctx.meta[_EXTENSION] = extension
    return command


def is_offered_command(name: str) -> bool:
    """Whether an installed plugin offers a command of this name; the plugin is not imported."""
    from importlib.metadata import entry_points

    return any(one.name == name for one in entry_points(group="aiorts.commands"))


def _offered(kind: str) -> dict[str, tuple[Extension, ...]]:
    from aiorts.cli.commands.offered import offered

    return offered(catalogue_of(), kind)


@click.group(cls=_LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, "-V", "--version", prog_name="aiorts", message="%(prog)s %(version)s")
@plugins_option
@click.option("--debug", is_flag=True, help="Show tracebacks of commands that plugins offer.")
def aiorts(debug: bool) -> None:
    """RT-Middleware for Python: robot software as components on an asyncio microkernel.

    New here? `aiorts demo` shows a small system and saves it for you to change; `aiorts help tutorial` lists the steps
    of the tutorial, `aiorts help --search WORDS` finds an answer.
    """


def run_command(arguments: Sequence[str], *, last: bool = False) -> int:
    """Run one command; returns the exit status. An error is one line on standard error.

    Args:
        last: whether the process ends after the command: within seconds, even with threads left behind.
    """
    try:
        return _run_command(arguments)
    finally:
        stopping = sys.modules.get("aiorts.cli.runtime.stopping")
        if stopping is not None and not last:
            stopping.watch_no_more()


def _run_command(arguments: Sequence[str]) -> int:
    if any("\0" in argument for argument in arguments):
        report("E-USAGE", "aiorts: an argument has a NUL character, which no file or name can have")
        return exits.REFUSED
    try:
        status = aiorts.main(list(arguments), prog_name="aiorts", standalone_mode=False)
        return _flushed(status if isinstance(status, int) else exits.DONE)
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message(), err=True)
        return exits.REFUSED
    except click.ClickException as error:
        if completes():
            return exits.FAILED  # no message between two key presses of completion
        _refused(arguments, "E-USAGE", _usage(error))
        report("E-USAGE", _usage(error))
        return error.exit_code
    except click.Abort:
        return exits.INTERRUPTED
    except AiortsError as error:
        if completes():
            return exits.FAILED
        _refused(arguments, error.code, str(error))
        report_error(error, verbose=False)
        return exits.of_error(error)
    except BrokenPipeError:
        return _silenced()
    except OSError as error:
        if error.errno in (errno.EMFILE, errno.ENFILE):
            report("E-FDS", f"{error}; raise the limit with ulimit -n 4096")
            return 1
        if error.errno not in _FULL or error.filename is not None:
            raise
        _silenced()
        return _lost(error)


def _usage(error: click.ClickException) -> str:
    context = getattr(error, "ctx", None)
    command = "aiorts" if context is None else context.command_path
    return f"{command}: {error.format_message().rstrip('.')}; see {command} --help"


def _flushed(status: int) -> int:
    """Flush standard output; a reader that has gone is no error, a full disk is one."""
    if sys.stdout is None:
        return status
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        return _silenced()
    except (OSError, ValueError) as error:
        _silenced()
        return status or _lost(error)
    return status


def _lost(error: Exception) -> int:
    report("E-OUTPUT", f"standard output: {error}; its last lines are lost")
    return exits.FAILED


def _refused(arguments: Sequence[str], code: str, text: str) -> None:
    """Print the error as a JSON document on standard output, where the command was called with --json."""
    if "--json" in arguments:
        with contextlib.suppress(OSError, ValueError):
            say_json({"error": {"code": code, "text": text}})
            _flushed(exits.DONE)


def _silenced() -> int:
    """Redirect standard output to /dev/null, so that the interpreter's last flush does not fail."""
    try:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)
    except (OSError, ValueError, AttributeError):
        sys.stdout = None  # as Python does when it is started without standard output
    return exits.BROKEN_PIPE
