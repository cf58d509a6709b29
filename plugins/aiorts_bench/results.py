"""`python -m aiorts_bench.results [FILE]` runs the benches and writes RESULTS.md; `--check` only judges their aims.

The file consists of marked parts: one for each bench, and one for each bench's comparison with OpenRTM-aist-Python. A
run replaces the parts it has measured and keeps the others.
"""

from __future__ import annotations

import re
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import click

from aiorts import exits
from aiorts.errors import PluginError
from aiorts.progress import progress
from aiorts_bench import registry
from aiorts_bench.harness import openrtm, printer
from aiorts_bench.harness.report import Report
from aiorts_bench.harness.runner import Progress

_FILE: Final = Path(__file__).resolve().parent / "RESULTS.md"
SLACK: Final = 0.1
"""The share by which an aim may be missed in an automated check."""
_MARK: Final = re.compile(r"^<!-- part: (.+) -->\n", re.MULTILINE)
_BESIDE: Final = "beside "


@dataclass(frozen=True, slots=True)
class Part:
    """One run of a bench.

    Attributes:
        rounds, scale: of the full run, chosen so that all parts together take ten minutes; 0 takes the bench's default.
        extra: values of the bench's own options.
    """

    bench: str
    rounds: int = 0
    scale: float = 0.0
    extra: Mapping[str, Any] | None = None

    @property
    def name(self) -> str:
        """The name of the part for `--only` and in the file's marks."""
        return " ".join((self.bench, *(f"--{name}" for name in self.extra or ())))


PARTS: Final = (
    Part("push", rounds=9),
    Part("context"),
    Part("context", rounds=7, scale=3.0, extra={"paper": True}),
    Part("codec"),
    Part("record"),
    Part("log"),
    Part("service"),
    Part("links", rounds=7, scale=2.0),
    Part("network", rounds=7, scale=2.0),
    Part("isolation", rounds=7, scale=2.0),
    Part("scale"),
    Part("startup", rounds=15),
)


def measured(
    part: Part, *, quick: bool = False, aimed: bool = False, progress: Progress | None = None, **changed: Any
) -> Report:
    """Run a part; options in `changed` that are not None replace its defaults.

    Raises:
        PluginError: the bench cannot be loaded.
    """
    bench = registry.load(part.bench)
    given = {name: value for name, value in changed.items() if value is not None}
    if not quick:
        given = {name: value for name in ("rounds", "scale") if (value := getattr(part, name))} | given
    if not bench.loops:
        given.pop("loop", None)
    words = [f"aiorts bench {part.name}", *(["--quick"] if quick else [])]
    words += [f"--{name} {value}" for name, value in given.items()]
    extra = dict(part.extra or {})
    return bench.report(
        bench.requested(quick=quick, command=" ".join(words), aimed=aimed, extra=extra, progress=progress, **given)
    )


def missed(part: str, report: Report) -> list[str]:
    """One line for each aim of `report` that is missed by more than `SLACK`."""
    return [
        f"{part}: {row.case.name}{'' if row.loop == 'none' else f' on {row.loop}'}: {ratio.measure.name} "
        f"{ratio.measured.median:.3g}, aim {ratio.aim.sense.value} {ratio.aim.factor:g}, "
        f"{ratio.aim.compared_with(ratio.measure.unit)}"
        for row, ratio in report.missed(SLACK)
    ]


def parts_of(text: str) -> dict[str, str]:
    """The marked parts of a file that `compose` made, by name."""
    _, *found = _MARK.split(text)
    return {name: body.strip("\n") for name, body in zip(found[::2], found[1::2], strict=True)}


def compose(parts: Mapping[str, str]) -> str:
    """The file made of its parts: a head, the benches, and the comparisons with OpenRTM-aist-Python."""
    names = [part.name for part in PARTS]
    names += [name for name in parts if name not in names and not name.startswith(_BESIDE)]

    def marked(names: list[str]) -> str:
        return "\n\n".join(f"<!-- part: {name} -->\n{parts[name]}" for name in names if parts.get(name))

    beside = marked([_BESIDE + name for name in names])
    head = (
        "# Results\n\nWritten by `python -m aiorts_bench.results`; each section names its machine and its command. "
        "`on course` is about the median of the rounds. Nothing here is edited by hand."
    )
    sections = [head, marked(names)]
    if beside:
        # This head is a part of its own: else `parts_of` would read it as the end of the bench above. Not read back.
        sections.append(f"<!-- part: {_BESIDE}head -->\n## Beside OpenRTM-aist-Python\n\n{openrtm.HEAD}\n\n{beside}")
    return "\n\n".join(sections) + "\n"


def _chosen(only: str | None) -> tuple[Part, ...]:
    if only is None:
        return PARTS
    wanted = [name.strip() for name in only.split(",") if name.strip()]
    names = [part.name for part in PARTS]
    unknown = [name for name in wanted if name not in names]
    if unknown or not wanted:
        raise click.UsageError(f"--only {only!r}: expected some of {', '.join(names)}")
    return tuple(part for part in PARTS if part.name in wanted)


@click.command()
@click.argument("file", type=click.Path(dir_okay=False, path_type=Path), default=_FILE)
@click.option("--quick", is_flag=True, help="Fewer and smaller rounds.")
@click.option("--check", is_flag=True, help="Write nothing; exit status 1 when an aim is missed by more than 10 %.")
@click.option("--only", help="Only these parts, such as push,context; the others in FILE are kept.")
@click.option("--loop", type=click.Choice(["auto", "both", "asyncio", "uvloop"]))
@click.option("--rounds", type=click.IntRange(min=1))
@click.option("--scale", type=click.FloatRange(min=0, min_open=True))
def main(
    file: Path, quick: bool, check: bool, only: str | None, loop: str | None, rounds: int | None, scale: float | None
) -> None:
    """Write the figures of this machine to FILE: ten minutes on a quiet machine, less with --quick or --only."""
    chosen = _chosen(only)
    parts = {} if check or not file.exists() else parts_of(file.read_text(encoding="utf-8"))
    weak, faults = [], []
    for part in chosen:
        began = time.monotonic()
        try:
            report = measured(part, quick=quick, aimed=check, loop=loop, rounds=rounds, scale=scale, progress=progress)
        except (PluginError, ImportError) as error:
            raise click.ClickException(str(error)) from error
        click.echo(f"{part.name}: {time.monotonic() - began:.0f} s", err=True)
        faults += [f"{part.name}: {fault}" for fault in report.faults]
        weak += missed(part.name, report)
        # Written with its faults: a table without them would look as if all was well.
        parts[part.name] = printer.markdown(report, level=2)
        beside = openrtm.sentences(part.name, report)
        parts[_BESIDE + part.name] = "\n".join(f"- {sentence}" for sentence in beside)
        if not check:
            file.write_text(compose(parts), encoding="utf-8")  # after each part, so that one that fails loses no other
    for line in (*faults, *weak):
        click.echo(line)
    if not weak:
        click.echo("every aim is met, or weaker by no more than 10 %")
    if not check:
        click.echo(f"{file} written")
    sys.exit(exits.FAILED if faults or (check and weak) else exits.DONE)


if __name__ == "__main__":
    main()
