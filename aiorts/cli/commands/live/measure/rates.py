"""`aiorts hz`: how many samples pass, by the counters of connectors."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import click

from aiorts import exits
from aiorts.cli.commands.live.edges import Edge, complete_edge, find_edges
from aiorts.cli.commands.live.measure.readings import Rates, readings
from aiorts.cli.commands.live.target import kernels
from aiorts.cli.console.output import say_line, say_now
from aiorts.cli.console.report import say


def lines_options(command: Any) -> Any:
    """The options of commands that print a line in each interval."""
    for option in (
        click.option("--json", "as_json", is_flag=True, help="A JSON object in a line instead of text."),
        click.option("--count", type=click.IntRange(min=1), metavar="N", help="End after N intervals."),
        click.option("--for", "duration", type=click.FloatRange(min=0.001), metavar="S", help="End after S seconds."),
        click.option(
            "--interval", type=click.FloatRange(min=0.01, max=3600.0), default=1.0, metavar="S", help="Seconds: 1."
        ),
    ):
        command = option(command)
    return command


@click.command(short_help="Show how many samples pass a connector or port each second.")
@click.argument("name", metavar="[KERNEL/]CONNECTOR|PORT", shell_complete=complete_edge)
@lines_options
def hz(name: str, interval: float, duration: float | None, count: int | None, as_json: bool) -> int:
    """Show the rate of a connector, or of each connector of a port: since the start, and its least, greatest and
    standard deviation over the intervals. Names are COMPONENT.PORT, 'A.OUT->B.IN' or the connector's own.

    The rate comes from the connector's counter and the kernel's clock; no sample is taken. In simulated time it is
    samples per second of that time. It ends with the kernel.
    """
    with kernels() as found:
        running, meant = find_edges(found, name)
        rates = {edge.name: Rates() for edge in meant}
        until = None if duration is None else time.monotonic() + duration
        shown = 0
        for now in readings(running.client, interval, connectors=list(rates), contexts=[], components=[]):
            ended = [edge for edge in meant if _ends_window(rates[edge.name], now, edge)]
            for edge in ended:
                _show(edge, rates[edge.name].summary(), as_json=as_json)
            shown += bool(ended)
            if shown == count or (until is not None and time.monotonic() >= until):
                return exits.DONE
    return has_ended(running.name, shown, count)


def has_ended(kernel: str, shown: int, count: int | None) -> int:
    """Say that a kernel has ended; the exit status: whether what was asked for was shown before."""
    say(f"aiorts: {kernel}: has ended")
    return exits.DONE if shown and count is None else exits.FAILED


def _ends_window(rates: Rates, now: Mapping[str, Any], edge: Edge) -> bool:
    counted = now["connectors"].get(edge.name)
    return counted is not None and rates.add(now["at_ns"], counted[0])


def _show(edge: Edge, found: Mapping[str, float], *, as_json: bool) -> None:
    if as_json:
        say_line({"connector": edge.name, "from": edge.out, "to": edge.in_, **found})
        return
    spread = f"min {found['min']:.3f}  max {found['max']:.3f}  stdev {found['stdev']:.3f}"
    say_now(f"{found['rate']:.3f} Hz  {spread}  intervals {found['windows']}  {edge.path}")
