"""`aiorts activate`, `deactivate`, `reset`, `stop`: lifecycles of components and kernels that run."""

from __future__ import annotations

from typing import Final

import click

from aiorts.cli.commands.live.showing import json_option, say_done, timeout_option
from aiorts.cli.commands.live.target import Found, complete, complete_kernels, is_glob, kernels

_DONE: Final = {"activate": {"active"}, "deactivate": {"inactive"}, "reset": {"active", "inactive"}}
"""The states in which an operation has nothing left to do."""


def _command(operation: str, text: str) -> click.Command:
    """Make the command of an operation on each named component; a pattern skips components that do not need it."""

    def to_do(one: Found, context: str | None) -> bool:
        states = one.running.names["components"][one.component]
        return any(
            state not in _DONE[operation] for name, state in states.items() if context is None or name == context
        )

    @click.command(operation, short_help=f"{text.partition('.')[0]}.", help=text)
    @click.argument("names", nargs=-1, required=True, metavar="COMPONENT...", shell_complete=complete)
    @click.option("--context", metavar="NAME", help="In this context, where the component is in several.")
    @timeout_option(5.0)
    @json_option()
    def run(names: tuple[str, ...], context: str | None, timeout: float, as_json: bool) -> int:
        with kernels(changing=True) as found:
            meant = [
                one for word in names for one in found.components([word]) if not is_glob(word) or to_do(one, context)
            ]
            for one in meant:
                one.client.call(operation, timeout + 2.0, component=one.component, context=context, timeout=timeout)
        return say_done((one.full for one in meant), as_json=as_json)

    return run


activate = _command("activate", "Activate components that run. * and ? in quotes stand for those that are not active.")
deactivate = _command(
    "deactivate", "Deactivate components that run. * and ? in quotes stand for those that are not inactive."
)
reset = _command("reset", "Take components out of error. * and ? in quotes stand for those that are in error.")


@click.command(short_help="End a run in order.")
@click.argument("kernel", default="", shell_complete=complete_kernels)
@timeout_option(10.0, "Wait S seconds for it")
@json_option()
def stop(kernel: str, timeout: float, as_json: bool) -> int:
    """End the run KERNEL in order, as SIGTERM does, and wait until it has ended.

    Without a name it is the only one that runs. A kernel within an application ends when that ends, or waits for this
    (Kernel.wait_stop_requested): else it is E-STATE, which says whose program it is.
    """
    with kernels(changing=True) as found:
        one = found.kernel(kernel.rstrip("/"))
        one.client.call("stop")
        one.client.wait_end(timeout)
    return say_done([one.name], as_json=as_json)
