"""`aiorts find`: finds running components and ports."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from fnmatch import fnmatchcase
from typing import Any, Final

import click

from aiorts import exits
from aiorts.cli.commands.live.look.named import outlines
from aiorts.cli.commands.live.showing import json_option, mute, timeout_option
from aiorts.cli.commands.live.target import Running, complete_kernels, kernels
from aiorts.cli.console.output import say, say_json
from aiorts.cli.console.report import report
from aiorts.model.lifecycle import LifecycleState

_STATES: Final = (*(state.value for state in LifecycleState), "failed")


@click.command(short_help="Find components and ports among what runs.")
@click.argument("kernel", default="", metavar="[KERNEL]", shell_complete=complete_kernels)
@click.option("--name", metavar="GLOB", help="Components of this name.")
@click.option("--type", "kind", metavar="GLOB", help="Components of this type: Class or module:Class.")
@click.option(
    "--state",
    type=click.Choice(_STATES, case_sensitive=False),
    help="Components in this state in a context, or failed.",
)
@click.option("--port-type", metavar="GLOB", help="Ports of this type, of these components.")
@timeout_option(1.0)
@json_option()
def find(
    kernel: str,
    name: str | None,
    kind: str | None,
    state: str | None,
    port_type: str | None,
    timeout: float,
    as_json: bool,
) -> int:
    """Print the names of the components that all options fit, in KERNEL or in all; of ports with --port-type.

    In GLOB, * and ? stand for any characters; quote it. What is printed is what other commands take. A kernel that does
    not answer is named on standard error, and the exit status is 5; it is 1 when nothing fits.
    """
    with kernels(timeout) as found:
        searched = [one for one in found.running if not kernel or one.fits(kernel.rstrip("/"))]
        if kernel and not searched:
            found.kernel(kernel.rstrip("/"))  # raises the error for an unknown name
        fitting = [
            {"name": f"{one.name}/{path}", **about}
            for one in searched
            for path, about in _fitting(one, name, kind, state, port_type)
        ]
        silent = [] if kernel else mute(found)
    if as_json:
        say_json({"found": fitting, "no_answer": silent})
    elif fitting:
        say("\n".join(str(one["name"]) for one in fitting))
    for one in silent:
        report("E-NO-ANSWER", f"{one['name']}: no answer; what is in it is not known")
    if silent:
        return exits.NO_ANSWER
    return exits.DONE if fitting else exits.FAILED


def _fitting(
    one: Running, name: str | None, kind: str | None, state: str | None, port_type: str | None
) -> Iterator[tuple[str, Mapping[str, Any]]]:
    for component, outline in outlines(one).items():
        states = one.names["components"].get(component, {})
        known = {*states.values(), *(("failed",) if component in one.names["in_error"] else ())}
        if (
            (name is not None and not fnmatchcase(component, name))
            or (kind is not None and not _is_type(outline["type"], kind))
            or (state is not None and state not in known)
        ):
            continue
        if port_type is None:
            yield component, {"type": outline["type"], "states": states}
            continue
        for port, about in outline["ports"].items():
            if any(fnmatchcase(word, port_type) for word in (about["type"], *about["type"].split())):
                yield f"{component}.{port}", about


def _is_type(full: str, kind: str) -> bool:
    return fnmatchcase(full, kind) or fnmatchcase(full.rpartition(":")[2], kind)
