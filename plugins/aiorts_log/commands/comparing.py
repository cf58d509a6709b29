"""`aiorts log diff`: compares two recordings; exit status 0 when they are equal, 1 when they differ."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any, Final

import click

from aiorts import exits
from aiorts.errors import ConfigurationError
from aiorts_log.analysis.difference import By, Difference, DiffOptions, PortDifference, difference
from aiorts_log.commands.output import FILE, UNLIMITED, Finite, number, safe, say_unclosed
from aiorts_log.mcap.encodings import file_of_both
from aiorts_log.mcap.source import Limits
from aiorts_log.text.opening import open_recording

_SPAN: Final = re.compile(r"(\d{1,12}(?:\.\d{1,9})?)(s|ms|us|ns)?", re.ASCII)
_UNITS: Final = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}
_KEPT: Final = 3
"""Differences of each port that are printed; --json has ten."""


@click.command(short_help="Compare two recordings.")
@click.argument("left", type=FILE)
@click.argument("right", type=FILE)
@click.option("--port", "ports", multiple=True, metavar="NAME", help="Only this port; may be given more than once.")
@click.option(
    "--by",
    type=click.Choice(["time", "tm", "order"]),
    help="What makes two samples partners: their log times (default), their own stamps, whatever their log times are, "
    "or their number within the port.",
)
@click.option("--time-tolerance", metavar="TIME", help="Time by which times may differ: 5ms, 20us, 0.01 (s).")
@click.option("--from-start", is_flag=True, help="Take times from the first sample of each recording.")
@click.option("--abs", "absolute", type=Finite(), default=0.0, help="Amount by which numbers may differ.")
@click.option(
    "--rel", "relative", type=Finite(), default=0.0, help="Part of the larger number by which numbers may differ."
)
@click.option(
    "--ignore",
    multiple=True,
    metavar="FIELD",
    help="A field that is not compared, such as tm or log_time.",
)
@click.option("--json", "as_json", is_flag=True, help="One JSON document.")
@UNLIMITED
def diff(
    left: Path,
    right: Path,
    ports: tuple[str, ...],
    by: By | None,
    time_tolerance: str | None,
    from_start: bool,
    absolute: float,
    relative: float,
    ignore: tuple[str, ...],
    as_json: bool,
    limits: Limits,
) -> int:
    """Compare two recordings: samples missing, extra or changed, and how their times differ.

    Values only, whatever the log times are, as of two runs of a system: --ignore log_time, or --by tm without a
    --time-tolerance.

    Exit status 0 when they are equal, 1 when they are not, or when the end of one cannot be read.
    """
    options = DiffOptions(
        by=by,
        time_tolerance=None if time_tolerance is None else _span(time_tolerance),
        absolute=absolute,
        relative=relative,
        ignored=frozenset(ignore),
        from_start=from_start,
    )
    with open_recording(left, limits=limits) as one, open_recording(right, limits=limits) as other:
        found = difference(one, other, options, ports or None)
    if as_json:
        click.echo(json.dumps(_document(found), indent=1))
    else:
        click.echo("\n".join([*_lines(found, left, right), *_hint(found, options)]))
    say_unclosed(found.not_closed)
    return exits.DONE if found.equal else exits.FAILED


def _span(text: str) -> int:
    found = _SPAN.fullmatch(text)
    if found is None:
        raise ConfigurationError(f"--time-tolerance: expected 5ms, 20us or seconds, got {text[:40]!r}").at(text, 0)
    whole, _, rest = found[1].partition(".")
    ns = int(whole) * 10**9 + int(rest.ljust(9, "0") or "0")
    return ns * _UNITS[found[2] or "s"] // 10**9


def _lines(found: Difference, left: Path, right: Path) -> list[str]:
    if found.equal_so_far:
        total = sum(port.left for port in found.ports)
        equal = "equal" if found.equal else "equal as far as they can be read"
        lines = [f"{equal}: {number(total, 'sample')} of {number(len(found.ports), 'port')}"]
        return lines + [line for port in found.ports if port.furthest for line in _port_lines(port)]
    lines = [f"{safe(left)} and {safe(right)} differ"]
    for port in found.ports:
        if not port.equal:
            lines += _port_lines(port)
    lines += [f"  {safe(n)}: only in {safe(left)}, {number(c, 'sample')}" for n, c in found.only_left.items()]
    lines += [f"  {safe(n)}: only in {safe(right)}, {number(c, 'sample')}" for n, c in found.only_right.items()]
    if same := [port for port in found.ports if port.equal]:
        lines.append(f"  equal: {number(len(same), 'port')} with {number(sum(p.left for p in same), 'sample')}")
    return lines


def _hint(found: Difference, options: DiffOptions) -> list[str]:
    """Advice on the options that make partners of samples whose times are those of two runs."""
    if not found.apart or options.partners_by == "order":
        return []
    if options.partners_by == "tm":
        return ["  hardly a sample has a partner by their stamps: --by order goes by number"]
    start = "--time-tolerance 5ms allows for jitter"
    if not options.from_start:
        start = "--from-start --time-tolerance 5ms takes them from the first sample"
    return [f"  hardly a sample has a partner by their log times: {start}, --by order --ignore log_time goes by number"]


def _port_lines(port: PortDifference) -> list[str]:
    if port.types is not None:
        file = file_of_both(*port.types)
        one = (
            f"; both may be one class, of {safe(file)}: record it by path in both, or as a module in both"
            if file
            else ""
        )
        return [f"  {safe(port.name)}: is {safe(port.types[0])} in the first, {safe(port.types[1])} in the second{one}"]
    counts = (
        (port.missing, "missing"),
        (port.extra, "extra"),
        (port.changed, "changed"),
        (port.late, "at other times"),
    )
    summary = ", ".join(f"{count} {what}" for count, what in counts if count) or "equal"
    timing = f"; times differ by {port.furthest / 1e6:.6g} ms at most, {port.mean / 1e6:.6g} ms in the mean"
    lines = [f"  {safe(port.name)}: {port.left} and {port.right} samples: {summary}{timing if port.furthest else ''}"]
    for time, what, detail in port.places[:_KEPT]:
        lines.append(f"    {what} at {time / 1e9:.9f} s{': ' if detail else ''}{safe(detail)}")
    return lines


def _document(found: Difference) -> dict[str, Any]:
    return {
        "equal": found.equal,
        "not_closed": [{"file": path, "unusable_bytes": length} for path, length in found.not_closed],
        "ports": [
            {
                "name": port.name,
                "equal": port.equal,
                "samples": [port.left, port.right],
                "missing": port.missing,
                "extra": port.extra,
                "changed": port.changed,
                "at_other_times": port.late,
                "time_difference_ns": {"most": port.furthest, "mean": port.mean},
                "types": None if port.types is None else list(port.types),
                "places": [{"time": time, "what": what, "detail": detail} for time, what, detail in port.places],
            }
            for port in found.ports
        ],
        "only_left": found.only_left,
        "only_right": found.only_right,
    }
