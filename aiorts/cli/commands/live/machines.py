"""`aiorts fsm`: shows and changes state machines and modes of running components."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import click

from aiorts import exits
from aiorts.cli.commands.live.showing import json_option, timeout_option
from aiorts.cli.commands.live.target import Found, complete, kernels
from aiorts.cli.console.output import say_either, table


@click.command(short_help="Show a state machine, and send it events.")
@click.argument("component", metavar="COMPONENT", shell_complete=complete)
@click.argument("event", default="")
@click.argument("data", default="", metavar="[DATA]")
@click.option("--mode", metavar="NAME", help="Change the mode; in force in every context when it returns.")
@timeout_option(5.0)
@json_option()
def fsm(component: str, event: str, data: str, mode: str | None, timeout: float, as_json: bool) -> int:
    """Show the active states of COMPONENT's state machine, its timers and what it defers; and its modes.

    With EVENT it is sent that, and DATA, which is JSON or else a text. It is carried out in a cycle of the machine.
    With --json what is shown then is printed after an event or a change of the mode, too.
    """
    if event and mode is not None:
        raise click.UsageError("an event and --mode each need a command of their own")
    with kernels(changing=bool(event) or mode is not None) as found:
        one = found.component(component)
        if event:
            one.client.call("send_event", timeout, component=one.component, event=event, data=json_or_text(data))
        elif mode is not None:
            one.client.call("set_mode", timeout + 2.0, component=one.component, mode=mode, timeout=timeout)
        if not as_json and (event or mode is not None):
            return exits.DONE
        shown = one.client.call("machine", timeout, component=one.component)
        say_either(shown, lambda: _shown(one, shown), as_json=as_json)
    return exits.DONE


def json_or_text(word: str) -> Any:
    """A word parsed as JSON; the word itself where it is no JSON, None where it is empty."""
    from json import loads

    if not word:
        return None
    try:
        return loads(word)
    except (ValueError, RecursionError):
        return word


def _shown(one: Found, shown: Mapping[str, Any]) -> str:
    machine, modes = shown["machine"], shown["modes"]
    rows = []
    if machine is not None:
        rows += [
            ("states", " ".join(machine["states"]) or "not active"),
            ("events", ", ".join(shown["events"])),
            ("deferred", ", ".join(machine["deferred"])),
            ("timers", ", ".join(machine["timers"])),
            ("history", "; ".join(f"{name}: {' '.join(states)}" for name, states in machine["history"].items())),
            ("ignored", str(machine["ignored"])),
        ]
    if modes is not None:
        pending = f", {modes['pending']} is pending" if modes["pending"] else ""
        rows += [("mode", f"{modes['mode']} of {', '.join(modes['modes'])}{pending}")]
    return f"{one.full}\n{table([row for row in rows if row[1]])}"
