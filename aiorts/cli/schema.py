"""`aiorts schema`: prints the JSON Schema of system files, for editors."""

from __future__ import annotations

import json
from pathlib import Path

import click

from aiorts import Catalogue
from aiorts.system import load, schema

__all__ = ("schema_command",)


@click.command("schema", short_help="Print the JSON Schema of system files.")
@click.argument("file", metavar="[SYSTEM.toml]", required=False, type=click.Path(dir_okay=False, path_type=Path))
def schema_command(file: Path | None) -> int:
    """Print the JSON Schema of system files, by which editors complete them and mark mistakes.

    It has the component types that are installed with their parameters; with SYSTEM.toml those of its plugin folders,
    too. For an editor with Taplo (Even Better TOML) save it and name it in the first line of a system file:

    \b
        aiorts schema > aiorts.schema.json
        #:schema ./aiorts.schema.json
    """
    catalogue = None if file is None else Catalogue(load(file).plugin_paths)
    click.echo(json.dumps(schema(catalogue), indent=2, ensure_ascii=False, allow_nan=False))
    return 0
