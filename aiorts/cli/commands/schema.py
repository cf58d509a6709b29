"""`aiorts schema`: prints the JSON Schema of system files, for editors."""

from __future__ import annotations

import json
from pathlib import Path

import click

from aiorts import exits
from aiorts.cli.commands.unrun import catalogue_of, quietly
from aiorts.cli.console.choices_option import choices_options
from aiorts.system import Choices, load, schema


@click.command("schema", short_help="Print the JSON Schema of system files.")
@click.argument("file", metavar="[SYSTEM.toml]", required=False, type=click.Path(dir_okay=False, path_type=Path))
@choices_options
def schema_command(file: Path | None, choices: Choices) -> int:
    """Print the JSON Schema of system files, by which editors complete them and mark mistakes.

    It has the component types that are installed with their parameters; with SYSTEM.toml those of its plugin folders,
    too. For Taplo (Even Better TOML) save it, and begin a system file with a line that names it:

    \b
        aiorts schema > aiorts.schema.json
        #:schema ./aiorts.schema.json
    """
    with quietly():
        made = schema(catalogue_of(None if file is None else load(file, (), choices)))
    click.echo(json.dumps(made, indent=2, ensure_ascii=False, allow_nan=False))
    return exits.DONE
