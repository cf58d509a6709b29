"""`aiorts reload`: replaces the code of running components."""

from __future__ import annotations

import click

from aiorts import exits
from aiorts.cli.commands.live.components import absolute
from aiorts.cli.commands.live.showing import json_option, timeout_option
from aiorts.cli.commands.live.target import Kernels, complete, kernels
from aiorts.cli.console.output import say, say_json
from aiorts.errors import AmbiguousError
from aiorts.sessions import Client


@click.command(short_help="Replace the code of components that run.")
@click.argument("what", metavar="COMPONENT | TYPE", shell_complete=complete)
@click.option("--kernel", default="", metavar="NAME", help="The kernel, where a TYPE is given and several run.")
@click.option(
    "--cycles", type=click.IntRange(min=0), default=10, metavar="N", help="It has proved itself after N cycles."
)
@click.option(
    "--seconds", type=click.FloatRange(min=0.0), default=1.0, metavar="S", help="Or after S seconds, 1 by default."
)
@click.option(
    "--window",
    type=click.FloatRange(min=0.0),
    default=0.0,
    metavar="S",
    help="Measure S seconds with the old code and S with the new, which must not do worse.",
)
@timeout_option(5.0)
@json_option()
def reload(what: str, kernel: str, cycles: int, seconds: float, window: float, timeout: float, as_json: bool) -> int:
    """Read the file of COMPONENT's type anew, and put the new code in the place of the old, in all of its instances.

    Or that of TYPE: FILE.py:Class, package.module:Class or the class's name. Connectors, unread samples and values of
    parameters stay. It returns when the new code has done its first cycles; when it fails in them, or before, all is
    as it was. With --window also when overruns or drops are more than before, or rates lower: the figure is named.
    """
    with kernels(changing=True, right="code") as found:
        client, meant = _meant(found, what, kernel)
        done = client.call("reload", 60.0 + 4 * timeout + seconds + 2 * window, type=meant, cycles=cycles,
                           seconds=seconds, timeout=timeout, window=window)  # fmt: skip
    if as_json:
        say_json(done)
        return exits.DONE
    for each in done["components"]:
        lost = ", ".join(f"{one['what']} {one['name']}" for one in each["dropped"])
        gained = ", ".join(each["added"])
        said = "; ".join(filter(None, (f"new: {gained}" if gained else "", f"gone: {lost}" if lost else "")))
        say(f"{each['component']}  {done['kind']}{f'  {said}' if said else ''}")
    return exits.DONE


def _meant(found: Kernels, what: str, kernel: str) -> tuple[Client, str]:
    """The session with the kernel, and the component or type as the kernel names it."""
    path = what if not kernel or "/" in what else f"{kernel}/{what}"
    known = any(what in one.names["components"] for one in found.running)
    if ":" not in what and not what.endswith(".py") and ("/" in what or known):
        one = found.component(path)
        return one.client, one.component
    if not kernel and len(found.running) > 1:
        there = ", ".join(one.name for one in found.running[:10])
        raise AmbiguousError(f"{what}: no component has this name; for a type say which kernel: --kernel {there}")
    return found.kernel(kernel).client, absolute(what)
