"""`aiorts save`: writes a running system as a system file."""

from __future__ import annotations

import os
from pathlib import Path

import click

from aiorts import exits
from aiorts.cli.commands.live.target import complete_kernels, kernels
from aiorts.cli.console.output import say_json
from aiorts.errors import ConfigurationError


@click.command(short_help="Save what runs as a system file.")
@click.argument("name", default="", metavar="[KERNEL]", shell_complete=complete_kernels)
@click.option(
    "-o",
    "--output",
    type=click.Path(dir_okay=False, allow_dash=True),
    default="-",
    metavar="FILE",
    help="Write FILE; - is standard output, as by default.",
)
@click.option("--force", is_flag=True, help="Overwrite FILE.")
@click.option("--timeout", type=click.FloatRange(min=0.001), default=8.0, metavar="S", help="Wait S seconds.")
@click.option("--json", "as_json", is_flag=True, help="One JSON document: the text, and what is not in it.")
def save(name: str, output: str, force: bool, timeout: float, as_json: bool) -> int:
    """Save the system of KERNEL, as it is now, as a system file from which aiorts run makes it again.

    Components, parameters and sets, connections, contexts, composites, supervision and the tables of services are in
    it; what is as declared, or so by default, is left out. Files are counted from the folder of FILE, for standard
    output from the current one, and have to lie below it. What a system file cannot say is listed on standard error.
    """
    if output != "-" and not force and os.path.lexists(output):
        raise ConfigurationError(f"{output}: is there already; --force overwrites it")
    if output != "-" and not os.path.isdir(os.path.dirname(os.path.abspath(output))):
        raise ConfigurationError(f"{output}: cannot be written: its folder is not there")
    with kernels() as found:
        folder = os.getcwd() if output == "-" else os.path.dirname(os.path.abspath(output))
        saved = found.kernel(name.rstrip("/")).client.call("save", timeout, folder=folder)
    if output != "-":
        from aiorts.configuration import replace_text

        replace_text(Path(output), saved["text"], overwrite=force)
    if as_json:
        say_json(saved)
        return exits.DONE
    if output == "-":
        from aiorts.system import standard_output  # late: it imports asyncio, which the client does without

        standard_output().write(saved["text"])
    for note in saved["notes"]:
        click.echo(f"not in the file: {note}", err=True)
    return exits.DONE
