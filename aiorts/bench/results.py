"""`python -m aiorts.bench.results [FILE]` runs the benches and writes RESULTS.md; `--check` only judges their aims."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Final

import click

from aiorts.bench import printer, registry
from aiorts.errors import PluginError

__all__ = ("SLACK", "main")

_FILE: Final = Path(__file__).resolve().parent / "RESULTS.md"
SLACK: Final = 0.1
"""By how much an automated check lets an aim be missed."""


@click.command()
@click.argument("file", type=click.Path(dir_okay=False, path_type=Path), default=_FILE)
@click.option("--quick", is_flag=True, help="Fewer and smaller rounds.")
@click.option("--check", is_flag=True, help="Write nothing; exit status 1 when an aim is missed by more than 10 %.")
@click.option("--bench", "chosen", multiple=True, help="Only this bench; may be given several times. Default all.")
@click.option("--loop", type=click.Choice(["auto", "both", "asyncio", "uvloop"]))
@click.option("--rounds", type=click.IntRange(min=1))
@click.option("--scale", type=click.FloatRange(min=0, min_open=True))
def main(
    file: Path,
    quick: bool,
    check: bool,
    chosen: tuple[str, ...],
    loop: str | None,
    rounds: int | None,
    scale: float | None,
) -> None:
    """Write the figures of this machine to FILE."""
    sections, missed = [], []
    for name in chosen or tuple(registry.OWN):
        try:
            bench = registry.load(name)
        except PluginError as error:
            raise click.ClickException(str(error)) from error
        words = [f"aiorts bench {name}", *(["--quick"] if quick else [])]
        given = {"loop": loop if bench.loops else None, "rounds": rounds, "scale": scale}
        words += [f"--{key} {value}" for key, value in given.items() if value is not None]
        report = bench.report(bench.asked(quick=quick, command=" ".join(words), **given))
        for fault in report.faults:
            raise click.ClickException(f"{fault}; {file} was not written")
        sections.append(printer.markdown(report, level=2))
        missed += [
            f"{name}: {row.case.name} on {row.loop}: {ratio.measured.median:.3g}, aim {ratio.aim.sense.value} "
            f"{ratio.aim.factor:g} {ratio.aim.compared_with(ratio.measure.unit)}"
            for row, ratio in report.missed(SLACK)
        ]
    if check:
        click.echo("\n".join(missed) or "every aim is met, or weaker by no more than 10 %")
        sys.exit(1 if missed else 0)
    file.write_text("# Results\n\n" + "\n\n".join(sections) + "\n", encoding="utf-8")
    click.echo(f"{file} written")


if __name__ == "__main__":
    main()
