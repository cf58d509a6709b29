"""`aiorts ls`: what runs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import click

from aiorts import exits
from aiorts.cli.commands.live.target import Running, complete, kernels
from aiorts.cli.console.output import say, say_json, table


@click.command(short_help="List the kernels that run, and their components.")
@click.argument("name", default="", metavar="[KERNEL|COMPONENT]", shell_complete=complete)
@click.option("-l", "--long", "long", is_flag=True, help="With the state of each component, and its contexts.")
@click.option("--json", "as_json", is_flag=True, help="One JSON document.")
def ls(name: str, long: bool, as_json: bool) -> int:
    """List what runs: every kernel of this user that can be reached, and its components.

    `aiorts run` can be reached unless --control=off; a program or a filter where it asks for it. A kernel that does not
    answer, stopped or stuck, shows as such.
    """
    with kernels() as found:
        shown = [one for one in found.running if not name or name in (one.name, *one.names["components"])]
        if name and not shown:
            found.find(name)
        if as_json:
            say_json({
                "kernels": [{"kernel": one.name, "pid": one.client.entry.pid, **one.names} for one in shown],
                "no_answer": [one.entry.name for one in found.silent],
            })  # fmt: skip
            return exits.DONE
        for one in shown:
            say(_text(one, long=long))
        for silent in found.silent:
            say(f"{silent.entry.name}/  {silent.why} (process {silent.entry.pid})")
        if not shown and not found.silent:
            say("nothing runs that can be reached")
    return exits.DONE


def _text(one: Running, *, long: bool) -> str:
    rows = [_row(one.names, component, long=long) for component in one.names["components"]]
    head = f"{one.name}/" if not long else f"{one.name}/  process {one.client.entry.pid}, {one.names['state']}"
    return "\n".join((head, table(rows))) if rows else head


def _row(names: Mapping[str, Any], component: str, *, long: bool) -> tuple[str, ...]:
    states: Mapping[str, str] = names["components"][component]
    if not long:
        return (component,)
    failed = "failed" if component in names["in_error"] else ""
    return (component, ", ".join(dict.fromkeys(states.values())) or "in no context", ", ".join(states), failed)
