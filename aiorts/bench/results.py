"""`python -m aiorts.bench.results [FILE]` runs the full bench and writes RESULTS.md, beside this file by default."""

from __future__ import annotations

from pathlib import Path

import click

from aiorts.bench import printer
from aiorts.bench.cli import report_push

__all__ = ("main",)

_FILE = Path(__file__).resolve().parent / "RESULTS.md"


@click.command()
@click.argument("file", type=click.Path(dir_okay=False, path_type=Path), default=_FILE)
@click.option("--quick", is_flag=True, help="Fewer and smaller rounds.")
@click.option("--loop", type=click.Choice(["auto", "both", "asyncio", "uvloop"]), default="both", show_default=True)
@click.option("--rounds", type=click.IntRange(min=1))
@click.option("--scale", type=click.FloatRange(min=0, min_open=True))
def main(file: Path, quick: bool, loop: str, rounds: int | None, scale: float | None) -> None:
    """Write the figures of this machine to FILE."""
    report = report_push(quick=quick, loop=loop, rounds=rounds, scale=scale)
    for fault in report.faults:
        raise click.ClickException(f"{fault}; {file} was not written")
    file.write_text(printer.markdown(report) + "\n", encoding="utf-8")
    click.echo(f"{file} written")


if __name__ == "__main__":
    main()
