"""`aiorts record`: records what runs, from another terminal."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, Final

import click

from aiorts import exits
from aiorts.sessions import kernels, likely
from aiorts_log.commands.working import signals_to
from aiorts_log.errors import RecordingError

if TYPE_CHECKING:
    from aiorts_log.live.taking import Taking
    from aiorts_log.mcap.locked_file import Existing
    from aiorts_log.recorder.options import RecordingStatistics

_MB: Final = 1_000_000


def _names(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[str]:
    return likely(incomplete)


@click.command("record", short_help="Record samples of what runs.")
@click.argument("names", nargs=-1, metavar="[PORT|COMPONENT|KERNEL]...", shell_complete=_names)
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), metavar="FILE", help="The file; KERNEL-TIME.mcap by default."
)
@click.option("--all", "all_", is_flag=True, help="All out-ports of the kernel, as without names.")
@click.option("-x", "--exclude", "excluded", multiple=True, metavar="NAME", help="But not this; * and ?; repeatable.")
@click.option("--count", type=click.IntRange(min=1), metavar="N", help="End after N samples in all.")
@click.option("--for", "duration", type=click.FloatRange(min=0.001), metavar="S", help="End after S seconds.")
@click.option("--append", is_flag=True, help="Continue FILE when it is there.")
@click.option("--overwrite", "--force", is_flag=True, help="Replace FILE when it is there.")
@click.option("--min-free", type=click.FloatRange(0.0, 1e12), metavar="MB", help="Of the disk that stay free.")
@click.option("--timeout", type=click.FloatRange(min=0.001), default=1.0, metavar="S", help="Wait S seconds.")
@click.option("--json", "as_json", is_flag=True, help="Print the counts as one JSON document.")
def record(
    names: tuple[str, ...],
    output: Path | None,
    all_: bool,
    excluded: tuple[str, ...],
    count: int | None,
    duration: float | None,
    append: bool,
    overwrite: bool,
    min_free: float | None,
    timeout: float,
    as_json: bool,
) -> int:
    """Record the samples of out-ports of what runs into an MCAP file, as `aiorts run --record` does.

    NAME is a port, a component or a kernel: all its out-ports; * and ? in quotes stand for any characters. Without
    names it is all of the only kernel that runs. Ports that a component or pattern has later are recorded from then on.

    \b
      aiorts record plant0.output -o run.mcap
      aiorts record "pid*" --exclude "*.debug" --for 10

    The system is not slowed down: what this end or the disk is too slow for is dropped, counted and said on standard
    error. Ctrl-C ends it, and so does the end of the kernel; the file is whole then.
    """
    if all_ and names:
        raise click.UsageError("--all goes not with names; name the kernel with --exclude, or the ports")
    existing = _existing(append=append, overwrite=overwrite)
    began = time.monotonic()
    with kernels(timeout, right="view") as found:
        from aiorts_log.live.choice import Choice
        from aiorts_log.live.taking import Taking
        from aiorts_log.recorder.target import check_target

        choice = Choice(found, names, excluded)
        path = _target(output, choice.running.name)
        check_target(path, existing)
        taking = Taking(choice, _report)
        with contextlib.closing(taking), _ending() as ending:
            counts, failure = _recorded(taking, path, existing, min_free, duration, count, ending)
    _tell(taking, path, counts, time.monotonic() - began, as_json=as_json)
    if failure is not None:
        _report(failure.code, str(failure))
        return exits.FAILED
    if taking.cut_off:
        return exits.FAILED
    return exits.of_signal(ending.number) if ending.number else exits.DONE


def _existing(*, append: bool, overwrite: bool) -> Existing:
    if append and overwrite:
        raise click.UsageError("--append goes not with --overwrite; choose one of the two")
    return "append" if append else "overwrite" if overwrite else "refuse"


def _target(output: Path | None, kernel: str) -> Path:
    """The file to write."""
    from aiorts_log.recorder.target import unfit_name

    if output is None:
        return Path(f"{kernel}-{datetime.now(UTC):%Y%m%dT%H%M%SZ}.mcap")
    if str(output) == "-":
        raise RecordingError(
            "-o -: a recording has its index at its end and needs a file, not standard output; "
            "name one, such as run.mcap, or use `aiorts print` for JSON lines"
        )
    if why := unfit_name(output):
        raise RecordingError(why)
    return output


def _recorded(
    taking: Taking,
    path: Path,
    existing: Existing,
    min_free: float | None,
    seconds: float | None,
    count: int | None,
    ending: _Ending,
) -> tuple[RecordingStatistics, RecordingError | None]:
    """Record until the end; returns the counts, and the failure if there was one."""
    from aiorts_log.commands.output import number
    from aiorts_log.live.frames import FrameWriter
    from aiorts_log.recorder.about import about_profile
    from aiorts_log.recorder.options import RecordingOptions

    options = RecordingOptions(existing=existing, min_free=None if min_free is None else round(min_free * _MB))
    about = about_profile(taking.profile(), "record")
    writer = FrameWriter(path, options, metadata=about, attachments=taking.origin())
    with writer:
        where = f"{number(len(taking.ports), 'port')} of {taking.kernel}"
        _say(f"records {where} into {path}; Ctrl-C ends it")
        taking.record(writer, seconds, count, lambda: bool(ending.number), ending.wake)
    return writer.statistics, writer.failure


def _tell(taking: Taking, path: Path, found: RecordingStatistics, seconds: float, *, as_json: bool) -> None:
    from aiorts_log.commands.output import number, size

    ports = {}
    for name, one in taking.ports.items():
        dropped, refused = found.dropped.get(name, 0), one.refused + found.refused.get(name, 0)
        ports[name] = {"recorded": one.offered - dropped - found.refused.get(name, 0), "dropped": dropped}
        if refused:
            ports[name]["refused"] = refused
        for why, count in found.reasons.get(name, {}).items():
            _report(
                "W-DROPPED", f"{name}: {number(count, 'sample')} of {one.offered + one.refused} were refused: {why}"
            )
        if dropped:
            _report("W-DROPPED", f"{name}: {number(dropped, 'sample')} of {one.offered + one.refused} were dropped")
    if taking.ended:
        _say(taking.ended)
    _say(f"{path}: {number(found.stored, 'sample')} of {number(len(ports), 'port')}, {size(found.size)}")
    if as_json:
        document: dict[str, Any] = {"file": str(path), "samples": found.stored, "bytes": found.size}
        click.echo(json.dumps({**document, "seconds": round(seconds, 3), "ports": ports}, indent=1))


def _report(code: str, text: str) -> None:
    click.echo(f"aiorts: {code}: {text}", err=True)


def _say(text: str) -> None:
    click.echo(f"aiorts: {text}", err=True)


class _Ending:
    """The signal that ends the recording, once it has come.

    Attributes:
        number: the signal's number; 0 while none has come.
        wake: a descriptor that can be read once a signal has come.
    """

    def __init__(self) -> None:
        self.number = 0
        self.wake, self._ring = os.pipe()
        os.set_blocking(self._ring, False)

    def come(self, number: int, frame: FrameType | None) -> None:
        """Handle a signal: the first ends the recording in order, another one ends the process at once."""
        if self.number:
            signal.signal(number, signal.SIG_DFL)
            signal.raise_signal(number)
        self.number = number
        os.write(self._ring, b"\0")

    def close(self) -> None:
        os.close(self.wake)
        os.close(self._ring)


@contextlib.contextmanager
def _ending() -> Iterator[_Ending]:
    """Note signals while the block runs, so that they do not end the process."""
    ending = _Ending()
    with contextlib.closing(ending), signals_to(ending.come):
        yield ending
