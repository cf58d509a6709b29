"""`aiorts vlog`: the log of what runs."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from itertools import chain
from typing import Any, Final

import click

from aiorts import exits
from aiorts.cli.commands.live.target import Found, Running, complete, kernels
from aiorts.cli.console.output import say, say_json, say_line, say_now, table
from aiorts.control import Stream
from aiorts.errors import AmbiguousError, ControlError

LEVELS: Final = ("debug", "info", "warning", "error", "critical")


@click.command(short_help="Show the log of components that run, and set its level.")
@click.argument("names", nargs=-1, metavar="[KERNEL/][COMPONENT]...", shell_complete=complete)
@click.option("-f", "--follow", is_flag=True, help="Go on with the lines that come.")
@click.option("--level", type=click.Choice(LEVELS), default="debug", help="Show lines of this level and above.")
@click.option("--set", "wanted", type=click.Choice(LEVELS), help="Log from this level on; with -f, until it ends.")
@click.option("--levels", is_flag=True, help="Show from which level on each component logs.")
@click.option("--count", type=click.IntRange(min=1), metavar="N", help="End after N lines.")
@click.option("--json", "as_json", is_flag=True, help="A JSON object in a line for each line.")
def vlog(
    names: tuple[str, ...], follow: bool, level: str, wanted: str | None, levels: bool, count: int | None, as_json: bool
) -> int:
    """Show the last lines that components logged: the last 16 of each, of the levels that they log.

    Without a name it is the only kernel that runs, with all its components. --set changes from which level on they log;
    lines below it are not made at all. What a slow terminal does not take is dropped and counted.
    """
    with kernels() as found:
        running, components = _meant([one for word in names for one in found.all(word)], found.kernel)
        client = running.client
        if wanted is not None:
            client.call("log_level", level=wanted, components=components, lasting=not follow)
        if levels:
            _show_levels(client.call("log_levels", components=components), as_json=as_json)
        if levels or (wanted is not None and not follow):
            return exits.DONE
        stream = client.stream("log", components=components, level=level, follow=follow)
        for number, line in enumerate(chain(stream.began, stream), 1):
            _show_missed(stream, as_json=as_json)
            _show(line, as_json=as_json)
            if number == count:
                break
        _show_missed(stream, as_json=as_json)
    return exits.DONE


def _meant(found: list[Found], kernel: Any) -> tuple[Running, list[str]]:
    """The one kernel that is meant, and the components of it; none is all."""
    if not found:
        return kernel(), []
    if len({one.client for one in found}) > 1:
        raise AmbiguousError(f"{', '.join(one.full for one in found[:10])}: of several kernels; name those of one")
    for one in found:
        if one.port:
            raise ControlError(f"{one.full}: a component has a log, {one.port!r} of it has none")
    return found[0].running, [one.component for one in found if one.component]


def _show(line: Mapping[str, Any], *, as_json: bool) -> None:
    if as_json:
        say_line(line)
        return
    at = datetime.fromtimestamp(line["time_ns"] / 1e9, UTC).astimezone()
    hook = f".{line['hook']}" if line["hook"] else ""
    who = f"{line['component']}{hook}: " if line["component"] else ""
    say_now(f"{at:%H:%M:%S}.{at.microsecond // 1000:03d} {line['level']:<8} {who}{line['text']}")


def _show_missed(stream: Stream, *, as_json: bool) -> None:
    """Say how many lines are missing since the last time, if any are."""
    missed, stream.missed = stream.missed, 0
    if missed and as_json:
        say_line({"missed": missed})
    elif missed:
        say_now(f"... {missed} lines were dropped here: this end was too slow")


def _show_levels(found: Mapping[str, Mapping[str, Any]], *, as_json: bool) -> None:
    if as_json:
        say_json(found)
    else:
        say(table([(name, one["level"], f"{one['lines']} lines") for name, one in found.items()], indent=""))
