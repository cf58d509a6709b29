"""`aiorts hz`, `bw`, `delay`: the samples and bytes that pass a connector each second, and their latency and age."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any, Final

import click

from aiorts import exits
from aiorts.cli.commands.live.edges import Edge, complete_edge, find_edges
from aiorts.cli.commands.live.ledger import UP_TO_LINK
from aiorts.cli.commands.live.measure.readings import Counters, Rates, counters_in, readings
from aiorts.cli.commands.live.showing import Over, following_options, has_ended
from aiorts.cli.commands.live.spans import read_plain, read_text, span_plain, spans_text
from aiorts.cli.commands.live.target import Running, kernels
from aiorts.cli.console.output import say_line, say_now
from aiorts.cli.console.report import say
from aiorts.errors import AbsentError, ClosedError
from aiorts.model.timing import Size, SpanFigures, row_of
from aiorts.sessions import RightName

Show = Callable[[Counters], bool]
"""A function that prints a reading; it returns False where there is nothing to print yet."""
_SIZED_EVERY: Final = 1.0
"""Seconds between two looks at the size of a sample."""


def _of_edges(command: Callable[..., int]) -> Any:
    """Add the common argument and options of the three commands: the name, the interval and the end of printing."""
    made: Any = command
    for option in (
        following_options("intervals", "interval of a connector"),
        click.option(
            "--interval",
            type=click.FloatRange(min=0.01, max=3600.0),
            default=1.0,
            metavar="S",
            help="Print every S seconds; 1 by default.",
        ),
        click.argument("name", metavar="[KERNEL/]CONNECTOR|PORT", shell_complete=complete_edge),
    ):
        made = option(made)
    return made


def _follow(
    name: str,
    interval: float,
    until: float | None,
    count: int | None,
    timeout: float,
    begin: Callable[[Running, tuple[Edge, ...]], Show],
    *,
    timed: bool = False,
    right: RightName = "view",
) -> int:
    """Show readings of the connectors that a name means until `count`, `until`, or the end of the kernel."""
    with kernels(timeout, right=right) as found:
        running, meant = find_edges(found, name)
        show = begin(running, meant)
        names = [edge.name for edge in meant]
        shown = 0
        chosen = {"connectors": names, "contexts": [], "components": [], "timed": names if timed else []}
        try:
            for now in readings(running.client, interval, **chosen):
                if not now["connectors"]:
                    raise Over(f"{name}: was disconnected")
                shown += show(now)
                if shown == count or (until is not None and time.monotonic() >= until):
                    break
        except ClosedError as error:
            return has_ended(running, error, shown, count)
    return exits.DONE


@click.command(short_help="Show how many samples pass a connector or port each second.")
@_of_edges
def hz(name: str, interval: float, until: float | None, count: int | None, timeout: float, as_json: bool) -> int:
    """Show the rate of a connector, or of each connector of a port: since the start, and its least, greatest and
    standard deviation over the intervals. Names are COMPONENT.PORT, 'A.OUT->B.IN' or the connector's own.

    The rate comes from the connector's counter and the kernel's clock; no sample is taken. In simulated time it is
    samples per second of that time. It ends with the kernel.
    """

    def begin(running: Running, meant: tuple[Edge, ...]) -> Show:
        rates = {edge.name: Rates() for edge in meant}

        def show(now: Counters) -> bool:
            ended = [edge for edge in meant if _ends_window(rates[edge.name], now, edge)]
            for edge in ended:
                found = rates[edge.name].summary()
                spread = f"min {found['min']:.3f}  max {found['max']:.3f}  stdev {found['stdev']:.3f}"
                text = f"{found['rate']:.3f} Hz  {spread}  intervals {found['windows']}"
                _print(edge, text, found, as_json=as_json)
            return bool(ended)

        return show

    return _follow(name, interval, until, count, timeout, begin)


@click.command(short_help="Show how many bytes pass a connector or port each second.")
@_of_edges
def bw(name: str, interval: float, until: float | None, count: int | None, timeout: float, as_json: bool) -> int:
    """Show the bytes a second of a connector, or of each connector of a port: its rate in the interval, multiplied by
    the encoded size of one sample. Names are as those of `aiorts hz`.

    At most once a second one sample is looked at, where it lies: none is taken. It ends with the kernel.
    """

    def begin(running: Running, meant: tuple[Edge, ...]) -> Show:
        rates = {edge.name: Rates() for edge in meant}
        sizes: Mapping[str, Any] = {}
        due = 0.0

        def show(now: Counters) -> bool:
            nonlocal sizes, due
            ended = [edge for edge in meant if _ends_window(rates[edge.name], now, edge)]
            if ended and time.monotonic() >= due:
                sizes = running.client.call("sizes", connectors=list(rates))
                due = time.monotonic() + _SIZED_EVERY
            for edge in ended:
                size = row_of(Size, sizes.get(edge.name, (None, "not looked at yet")))
                rate = rates[edge.name].windows[-1]
                through, text = None, size.why
                if size.bytes is not None:
                    through = rate * size.bytes
                    text = f"{_bytes(through)}/s  {rate:.3f} Hz x {_bytes(size.bytes)}"
                _print(edge, text, {"bytes_per_second": through, "rate": rate, "bytes": size.bytes}, as_json=as_json)
            return bool(ended)

        return show

    return _follow(name, interval, until, count, timeout, begin)


@click.command(short_help="Show how long samples are on their way, and how old they are.")
@_of_edges
def delay(name: str, interval: float, until: float | None, count: int | None, timeout: float, as_json: bool) -> int:
    """Show latency (from the write to the read) and age (when read, by the time stamp) of the last 1,000 samples of a
    connector, or of each connector of a port: median, 99th percentile, maximum. Names are as those of `aiorts hz`.

    Where the stamps are those of another machine, its clock's offset is taken off the age, which may then be off by
    what stands behind `+-`: half of the shortest time there and back. It is `?` where that is more than 10 ms.

    Where the reader is in another process, its end is asked, and the line begins with what it says, at the read: the
    age, and how long a sample had waited in the reader's buffer. What this end knows is taken as the link takes the
    sample, and the line says so: up to the link.

    A connector that is not measured is from now on, which standard error says, and no longer when this ends, however
    it ends. That needs the right to operate the kernel. It ends with the kernel.
    """

    def begin(running: Running, meant: tuple[Edge, ...]) -> Show:
        names = [edge.name for edge in meant]
        before = counters_in(running.client.call("statistics", connectors=names, contexts=[], components=[]))
        wanted = [name for name, one in before["connectors"].items() if not one.measure]
        if wanted:
            running.client.call("measure", connectors=wanted)
            shown = ", ".join(edge.path for edge in meant if edge.name in wanted)
            say(f"aiorts: until this ends, it is measured (option measure = 1000): {shown}")
        first = True

        def show(now: Counters) -> bool:
            nonlocal first
            early, first = first and bool(wanted), False  # measuring has just begun, and no sample was read since
            for edge in () if early else meant:
                found = now["timed"].get(edge.name, {})
                plain: dict[str, Any] = {what: span_plain(found.get(what)) for what in _TIMED}
                if "within" in found:
                    plain["age_within_ns"] = found["within"][0]
                at_read = ""
                if "link" in found:
                    plain["to_link"] = True
                    at_read, plain["read"] = _at_read(running, edge)
                _print(edge, f"{at_read}{_spans(found)}", plain, as_json=as_json)
            return not early

        return show

    return _follow(name, interval, until, count, timeout, begin, timed=True, right="operate")


_TIMED: Final = ("latency", "age")


def _ends_window(rates: Rates, now: Counters, edge: Edge) -> bool:
    counted = now["connectors"].get(edge.name)
    return counted is not None and rates.add(now["at_ns"], counted.written)


def _print(edge: Edge, text: str, found: Mapping[str, Any], *, as_json: bool) -> None:
    if as_json:
        say_line({"connector": edge.name, "from": edge.out, "to": edge.in_, **found})
    else:
        say_now(f"{text}  {edge.path}")


def _spans(found: Mapping[str, Any]) -> str:
    if not found:
        return "nothing was read"
    samples = row_of(SpanFigures, found["latency"]).samples
    return f"{spans_text(found, *_TIMED)}  samples {samples}{UP_TO_LINK if 'link' in found else ''}"


def _at_read(running: Running, edge: Edge) -> tuple[str, dict[str, Any] | None]:
    """The figures of the reader's end of a link, as text (or why they are not known) and as JSON has them."""
    try:
        (wire,) = running.client.call("connectors", names=[edge.name], both_ends=True)
    except AbsentError:
        return "", None  # the connector has ended since
    read = wire.get("read")
    if read is None:
        return f"at the read: not known (why: aiorts con {edge.out} --both-ends); ", None
    return f"at the read: {read_text(read)}; ", read_plain(read)


def _bytes(count: float) -> str:
    for unit, size in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if count >= size:
            return f"{count / size:.4g} {unit}"
    return f"{count:.4g} B"
