"""`aiorts activate`, `deactivate`, `reset`, `stop`: lifecycles of what runs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import click

from aiorts import exits
from aiorts.cli.commands.live.target import Found, complete, complete_kernels, is_glob, kernels

_DONE: Final = {"activate": {"active"}, "deactivate": {"inactive"}, "reset": {"active", "inactive"}}
"""The states in which there is nothing left for it to do."""


def _command(operation: str, text: str) -> click.Command:
    """The command that does this to each component it is given; of a pattern to those not yet as it leaves them."""

    def to_do(one: Found, context: str | None) -> bool:
        states = one.running.names["components"][one.component]
        return any(
            state not in _DONE[operation] for name, state in states.items() if context is None or name == context
        )

    def run(names: tuple[str, ...], context: str | None, timeout: float) -> int:
        with kernels() as found:
            meant = [
                one for word in names for one in found.components([word]) if not is_glob(word) or to_do(one, context)
            ]
            for one in meant:
                one.client.call(operation, timeout + 2.0, component=one.component, context=context, timeout=timeout)
        return exits.DONE

    params: list[click.Parameter] = [
        click.Argument(["names"], nargs=-1, required=True, metavar="COMPONENT...", shell_complete=complete),
        click.Option(["--context"], metavar="NAME", help="In this context, where the component is in several."),
        click.Option(["--timeout"], type=click.FloatRange(min=0.001), default=5.0, metavar="S", help="Wait S seconds."),
    ]
    callback: Callable[..., int] = run
    return click.Command(
        operation, callback=callback, params=params, short_help=f"{text.partition('.')[0]}.", help=text
    )


activate = _command("activate", "Activate components that run. * and ? in quotes stand for those that are not active.")
deactivate = _command(
    "deactivate", "Deactivate components that run. * and ? in quotes stand for those that are not inactive."
)
reset = _command("reset", "Take components out of error. * and ? in quotes stand for those that are in error.")


@click.command(short_help="End a run in order.")
@click.argument("kernel", default="", shell_complete=complete_kernels)
@click.option("--timeout", type=click.FloatRange(min=0.001), default=10.0, metavar="S", help="Wait S seconds for it.")
def stop(kernel: str, timeout: float) -> int:
    """End the run KERNEL in order, as SIGTERM does, and wait until it has ended.

    Without a name it is the only one that runs.
    """
    with kernels() as found:
        client = found.kernel(kernel.rstrip("/")).client
        client.call("stop")
        client.wait_end(timeout)
    return exits.DONE
