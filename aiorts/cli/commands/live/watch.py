"""`aiorts watch`: prints the events of a kernel."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import click

from aiorts import exits
from aiorts.cli.commands.live.showing import followed, following_options, hint, items_of, moment_text, say_missed
from aiorts.cli.commands.live.target import complete_kernels, kernels
from aiorts.cli.console.output import say_line, say_now

_LONGEST = 80


@click.command(short_help="Print what happens in a kernel: states, connections, errors.")
@click.argument("kernel", default="", shell_complete=complete_kernels)
@click.option("--kind", "kinds", multiple=True, metavar="NAME", help="Only events of this kind; repeatable.")
@following_options("events", "event")
def watch(
    kernel: str, kinds: tuple[str, ...], count: int | None, until: float | None, timeout: float, as_json: bool
) -> int:
    """Print each event of the kernel's bus as it happens: `aiorts help events` has the kinds.

    Without a name it is the only kernel that runs. Where this end is too slow, a line says how many events are missing.
    It ends with the kernel.
    """
    with kernels(timeout) as found:
        running = found.kernel(kernel.rstrip("/"))
        stream = running.client.stream("events", kinds=kinds)
        hint(f"{running.name}: {', '.join(kinds) or 'events'} from now on; Ctrl-C ends")
        for item in followed(items_of(stream, until), running, count):
            say_missed(stream, "events are missing here", as_json=as_json)
            if as_json:
                say_line(item)
            else:
                say_now(_text(item))
        say_missed(stream, "events are missing here", as_json=as_json)
    return exits.DONE


def _text(item: Mapping[str, Any]) -> str:
    fields = ", ".join(f"{name}={_value(value)}" for name, value in item["event"].items() if value not in ("", None))
    return f"{moment_text(item['time_ns'])} {item['kind']} {fields}"


def _value(value: Any) -> str:
    """A field as short text: a part of the profile by its name."""
    if isinstance(value, Mapping) and "name" in value:
        return str(value["name"])
    text = str(value)
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."
