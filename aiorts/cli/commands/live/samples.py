"""`aiorts print` and `aiorts inject`: samples out of running kernels, and into them."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from stat import S_ISREG
from typing import Any, Final, TextIO

import click

from aiorts import exits
from aiorts.cli.commands.live.curve import Curve
from aiorts.cli.commands.live.showing import followed, following_options, hint, items_of, json_option, timeout_option
from aiorts.cli.commands.live.target import complete, kernels
from aiorts.cli.console.output import say_line
from aiorts.cli.console.report import report
from aiorts.errors import AbsentError, RecordError
from aiorts.sessions import Client, Stream

_BATCH: Final = 64
"""Lines that are sent in one call."""


@click.command("print", short_help="Print the samples of an out-port that runs.")
@click.argument("port", metavar="COMPONENT.PORT[.FIELD]", shell_complete=complete)
@click.option("--plot", is_flag=True, help="Draw a number of the samples as a curve.")
@click.option("--fields", metavar="A,B", help="Only these fields, as one object; as FIELD, they may have dots.")
@click.option("--rate", type=click.FloatRange(min=0.001), metavar="HZ", help="At most so many samples a second.")
@following_options("samples", "sample; lines are that anyhow")
def print_(
    port: str,
    count: int | None,
    until: float | None,
    plot: bool,
    fields: str | None,
    rate: float | None,
    timeout: float,
    as_json: bool,
) -> int:
    """Print the samples of an out-port as JSON lines, as filters do: they can be piped into filters and `inject`.

    With FIELD, only its value is printed. What this terminal does not take in time is dropped, counted and said on
    standard error; the system is not slowed down. It ends with the run.

    --plot draws the first number of the samples, or FIELD, over time. --rate passes over samples, by their time.
    """
    chosen = [name.strip() for name in fields.split(",")] if fields is not None else []
    with kernels(timeout) as found:
        one = found.find(port)
        client, path, field = _port(one, port)
        if chosen and (field or plot or not all(chosen)):
            raise click.UsageError("--fields A,B names fields, and goes with neither COMPONENT.PORT.FIELD nor --plot")
        stream = client.stream("tap", port=path)
        hint(f"{one.running.name}/{path}: samples from now on; Ctrl-C ends")
        items = followed(_thinned(_items(stream, until), rate), one.running, count)
        try:
            if plot:
                _draw(items, stream, f"{path}.{field}" if field else path, field)
            else:
                for item in items:
                    _show(item, stream.began, field, chosen)
        finally:
            if stream.missed:
                report("W-DROPPED", f"{path}: {stream.missed} samples were dropped on the way to this terminal")
    return exits.DONE


def _port(found: Any, word: str) -> tuple[Client, str, str]:
    """The session, the port and the field that a word means."""
    port, _, field = found.port.partition(".")
    if not found.component or not port:
        raise AbsentError(
            f"{word}: name a port, such as {found.component or 'component'}.output; `aiorts ls -R` has all"
        )
    return found.client, f"{found.component}.{port}", field


def _items(stream: Stream, until: float | None) -> Iterator[Mapping[str, Any]]:
    for item in items_of(stream, until):
        if "error" in item:
            report("E-RECORD", f"{stream.began['port']}: {item['error']}")
            continue
        yield item


def _thinned(items: Iterator[Mapping[str, Any]], rate: float | None) -> Iterator[Mapping[str, Any]]:
    """Thin items out to at most `rate` in a second of the kernel's clock."""
    due, step = 0, 0 if rate is None else round(1e9 / rate)
    for item in items:
        now = item["time_ns"]
        if now >= due:
            due = now + step if now - due >= step else due + step  # a late item does not delay the next
            yield item


def _show(item: Mapping[str, Any], began: Mapping[str, Any], field: str, chosen: Sequence[str]) -> None:
    if chosen:
        say_line({name: _value(item, name) for name in chosen})
        return
    if field:
        say_line(_value(item, field))
        return
    line = {"port": began["port"], "type": began["type"], "tm": item["tm"], "data": item["data"]}
    say_line({key: value for key, value in line.items() if key != "tm" or value is not None})


def _value(item: Mapping[str, Any], field: str) -> Any:
    """The value of a field; RecordError when the sample has none."""
    value: Any = item["tm"] if field == "tm" else item["data"]
    names = [] if field in ("tm", "data") else field.removeprefix("data.").split(".")
    for name in names:
        if isinstance(value, Mapping) and name in value:
            value = value[name]
        elif isinstance(value, list) and name.isdecimal() and int(name) < len(value):
            value = value[int(name)]
        else:
            there = ", ".join(value) if isinstance(value, Mapping) else "tm, data"
            raise RecordError(f"the samples have no {field!r}; there are {there}")
    return value


def _draw(items: Iterator[Mapping[str, Any]], stream: Stream, title: str, field: str) -> None:
    curve = Curve(title, sys.stdout)
    try:
        for item in items:
            number = _number(_value(item, field) if field else item["data"])
            if number is None:
                what = field or "the data"
                raise RecordError(f"{title}: {what} is no number; name a field that is one, as in COMPONENT.PORT.FIELD")
            curve.add(item["time_ns"] / 1e9, number, stream.missed)
    finally:
        curve.end()


def _number(value: Any) -> float | None:
    """The value if it is a number, else the first number in it, else None."""
    if isinstance(value, bool):
        return float(value)
    if isinstance(value, int | float):
        return float(value)
    inner = value.values() if isinstance(value, Mapping) else value if isinstance(value, list) else ()
    return next((found for one in inner if (found := _number(one)) is not None), None)


# -- into what runs ----------------------------------------------------------------------------------------------------


@click.command(short_help="Write samples to an in-port that runs.")
@click.argument("port", metavar="COMPONENT.PORT", shell_complete=complete)
@click.argument("value", required=False)
@click.option("--rate", type=click.FloatRange(min=0.001), metavar="HZ", help="Write VALUE again and again.")
@click.option("--count", type=click.IntRange(min=1), metavar="N", help="Write VALUE N times.")
@click.option(
    "--full", type=click.Choice(["reject", "overwrite", "block"]), default="block", help="When there is no room."
)
@click.option("--length", type=click.IntRange(min=1), default=8, help="Samples that wait for the reader.")
@click.option("--no-wait", is_flag=True, help="End at once: what the reader has not taken by then is lost.")
@timeout_option(5.0, "Wait S seconds for room, and at the end until all is delivered")
@json_option("Print the counts as one JSON document.")
def inject(
    port: str,
    value: str | None,
    rate: float | None,
    count: int | None,
    full: str,
    length: int,
    no_wait: bool,
    timeout: float,
    as_json: bool,
) -> int:
    """Write samples to an in-port of what runs; exit status 1 when one of them was refused, dropped or lost.

    VALUE is JSON: the data of the sample, or {"data": ..., "tm": ...}. Without VALUE, JSON lines are read from standard
    input until it ends. VALUE and a file are checked against the type of the port as a whole before the first sample is
    written. Of a pipe the lines that are there are checked, 64 at most, and written before more are read. A bad line
    ends the command with status 2 and its number. The connection ends with the command.

    \b
      aiorts inject pid0.measured 0.5
      aiorts print plant0.output | aiorts inject logger0.input
    """
    written = refused = 0
    dropped: dict[str, int] = {}
    with kernels(changing=True) as found:
        client, path, field = _port(found.find(port), port)
        if field:
            raise AbsentError(f"{port}: samples are written whole; name the in-port, {path}")
        how: dict[str, Any] = {"port": path, "full": full, "length": length, "timeout": timeout}
        # The drops are sums of the whole session, which the lines of a batch share.
        before = {} if no_wait else client.call("inject", lines=[], **how)["dropped"]
        try:
            if value is None and _is_file(sys.stdin):
                begun = sys.stdin.tell()
                for first, lines in _batches(sys.stdin):
                    client.call("inject", lines=lines, first=first, check=True, **how)
                sys.stdin.seek(begun)
            for first, lines in _constant(value, rate, count) if value is not None else _batches(sys.stdin):
                result = client.call("inject", timeout * len(lines) + 5.0, lines=lines, first=first, **how)
                written, refused = written + result["written"], refused + result["refused"]
                if refused and full == "block":
                    break
        except RecordError as error:
            raise RecordError(f"{error}; {written or 'no'} samples were written before") from None
        if written and not no_wait:
            last = client.call("inject", timeout + 5.0, lines=[], wait=timeout, **how)
            dropped = {why: n - before.get(why, 0) for why, n in last["dropped"].items() if n > before.get(why, 0)}
            if last["unread"]:
                dropped["lost"] = min(last["unread"], written)
    if as_json:
        say_line({"written": written, "refused": refused, "dropped": dropped})
    elif refused:
        report("W-DROPPED", f"{path}: {refused} samples were refused, since the reader's buffer was full")
    for why, number in () if as_json else dropped.items():
        text = f"not read within {timeout:g} s, and lost" if why == "lost" else f"dropped ({why})"
        report("W-DROPPED", f"{path}: {number} of {written} samples were {text}")
    return exits.FAILED if refused or dropped else exits.DONE


def _constant(value: str, rate: float | None, count: int | None) -> Iterator[tuple[int, list[str]]]:
    """Yield VALUE once, `count` times, or at a rate, always as line 1."""
    if rate is None:
        left = count or 1
        while left > 0:
            yield 1, [value] * min(left, _BATCH)
            left -= _BATCH
        return
    begun, number = time.monotonic(), 0
    while count is None or number < count:
        time.sleep(max(0.0, begun + number / rate - time.monotonic()))
        yield 1, [value]
        number += 1


def _batches(stream: TextIO | None) -> Iterator[tuple[int, list[str]]]:
    """Yield the lines of a stream, as many at a time as have come, with the number of the first."""
    if stream is None:
        return
    if stream.isatty():
        hint("reading JSON lines from this terminal; Ctrl-D ends")
    first, lines = 1, list[str]()
    for line in stream:
        lines.append(line.rstrip("\n"))
        if len(lines) >= _BATCH or not _more(stream):
            yield first, lines
            first, lines = first + len(lines), []
    if lines:
        yield first, lines


def _is_file(stream: TextIO | None) -> bool:
    """Whether the stream is a file, which can be read twice."""
    try:
        return stream is not None and S_ISREG(os.fstat(stream.fileno()).st_mode)
    except (OSError, ValueError):
        return False


def _more(stream: TextIO) -> bool:
    """Whether another line can be read without waiting; False where it is not known."""
    import select

    try:
        return bool(select.select([stream], [], [], 0)[0])
    except (OSError, ValueError):
        return False
