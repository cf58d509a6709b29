"""`aiorts vlog`: shows the log of a running kernel, and sets levels."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import chain
from typing import Any, Final

import click

from aiorts import exits
from aiorts.cli.commands.live.showing import (
    followed,
    following_options,
    hint,
    items_of,
    moment_text,
    named,
    say_done,
    say_missed,
)
from aiorts.cli.commands.live.target import Found, Running, complete, kernels
from aiorts.cli.console.output import say_either, say_line, say_now, table
from aiorts.errors import AmbiguousError

_MISSED: Final = "lines were dropped here: this end was too slow"
LEVELS: Final = ("debug", "info", "warning", "error", "critical")


@click.command(short_help="Show the log of components that run, and set its level.")
@click.argument("names", nargs=-1, metavar="[KERNEL/][COMPONENT]...", shell_complete=complete)
@click.option("-f", "--follow", is_flag=True, help="Go on with the lines that come.")
@click.option("--level", type=click.Choice(LEVELS), default="debug", help="Show lines of this level and above.")
@click.option("--set", "wanted", type=click.Choice(LEVELS), help="Log from this level on; with -f, until it ends.")
@click.option("--levels", is_flag=True, help="Show from which level on each component logs.")
@following_options("lines", "line")
def vlog(
    names: tuple[str, ...],
    follow: bool,
    level: str,
    wanted: str | None,
    levels: bool,
    count: int | None,
    until: float | None,
    timeout: float,
    as_json: bool,
) -> int:
    """Show the last lines that components logged: the last 16 of each, of the levels that they log.

    Without a name it is the only kernel that runs, with all its components. --set changes from which level on they log;
    lines below it are not made at all. What a slow terminal does not take is dropped and counted.
    """
    with kernels(timeout, changing=wanted is not None) as found:
        running, components = _meant([one for word in names for one in found.all(word, bare=True)], found.kernel)
        client = running.client
        if wanted is not None:
            client.call("log_level", level=wanted, components=components, lasting=not follow)
        if levels:
            logs = client.call("log_levels", components=components)
            rows = [(name, one["level"], f"{one['lines']} lines") for name, one in logs.items()]
            say_either(named(logs), lambda: table(rows, indent=""), as_json=as_json)
            return exits.DONE
        if wanted is not None and not follow:
            return say_done((f"{running.name}/{one}" for one in components or ("",)), as_json=as_json)
        stream = client.stream("log", components=components, level=level, follow=follow)
        if not stream.began:
            hint(f"{running.name}: nothing was logged yet{'; lines come from now on, Ctrl-C ends' if follow else ''}")
        came = items_of(stream, until) if follow else stream
        for line in followed(chain(stream.began, came), running, count):
            say_missed(stream, _MISSED, as_json=as_json)
            _show(line, as_json=as_json)
        say_missed(stream, _MISSED, as_json=as_json)
    return exits.DONE


def _meant(found: list[Found], kernel: Any) -> tuple[Running, list[str]]:
    """The kernel that the words mean, and its components; an empty list is all."""
    if not found:
        return kernel(), []
    if len({one.client for one in found}) > 1:
        raise AmbiguousError(f"{', '.join(one.full for one in found[:10])}: of several kernels; name those of one")
    for one in found:
        one.check("component", "kernel")
    return found[0].running, [one.component for one in found if one.component]


def _show(line: Mapping[str, Any], *, as_json: bool) -> None:
    if as_json:
        say_line(line)
        return
    hook = f".{line['hook']}" if line["hook"] else ""
    who = f"{line['component']}{hook}: " if line["component"] else ""
    say_now(f"{moment_text(line['time_ns'])} {line['level']:<8} {who}{line['text']}")
