"""`aiorts kernel`: the program of a process that runs one component; only a kernel starts it."""

from __future__ import annotations

import click

from aiorts import exits
from aiorts.processes import DESCRIPTOR, prepare


@click.command(hidden=True)
@click.option("--fd", "descriptor", type=int, required=True, metavar="N", help="The socket of who started it.")
def kernel(descriptor: int) -> int:
    """Run a kernel for one component, as another kernel says; it ends with that kernel."""
    if descriptor != DESCRIPTOR:
        raise click.UsageError("this command is for aiorts itself; `aiorts run` runs a component")
    prepare()
    from aiorts.cli.runtime.component_process import main  # late: `prepare` comes before everything that takes long

    main()
    return exits.DONE
