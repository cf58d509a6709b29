"""`aiorts cat`: shows all that is worth knowing of a running component, port, connector, context or kernel."""

from __future__ import annotations

import click

from aiorts import exits
from aiorts.cli.commands.live.look.describing import text_of
from aiorts.cli.commands.live.look.named import named
from aiorts.cli.commands.live.showing import json_option, timeout_option
from aiorts.cli.commands.live.target import complete, kernels
from aiorts.cli.console.output import say_either


@click.command(short_help="Show a component, port, connector, context or kernel that runs.")
@click.argument("names", nargs=-1, required=True, metavar="NAME...", shell_complete=complete)
@click.option("-l", "--long", "long", is_flag=True, help="With all there is: options, documentation, the last log.")
@timeout_option(1.0)
@json_option("One JSON document: a list of parts of the profile.")
def cat(names: tuple[str, ...], long: bool, timeout: float, as_json: bool) -> int:
    """Show everything worth knowing of what runs: state, ports, parameters in force, connectors with what was dropped.

    NAME is a component, a port (`comp.port`), a context, a connector or a kernel; a component comes first, `name/` is
    the kernel. * and ? in quotes stand for any characters.
    """
    with kernels(timeout) as found:
        meant = {one.full: one for word in names for one in named(found, word)}.values()
        reports = [(one, one.report()) for one in meant]
    say_either(
        [{"kind": one.kind, "name": one.full, **report} for one, report in reports],
        lambda: "\n\n".join(text_of(one.kind, one.name, one.full, report, long=long) for one, report in reports),
        as_json=as_json,
    )
    return exits.DONE
