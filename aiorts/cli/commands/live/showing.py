"""The common parts of commands for running kernels: options, JSON documents, hints, the end of a followed stream."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from datetime import UTC, datetime
from typing import Any, Final, TypeVar

import click

from aiorts import exits
from aiorts.cli.console.output import say, say_json, say_line, say_now
from aiorts.cli.console.report import say as tell
from aiorts.errors import AbsentError, ClosedError, NoAnswerError
from aiorts.sessions import CutOff, Kernels, Running, Stream

C = TypeVar("C", bound=Callable[..., Any])
T = TypeVar("T")
_SECONDS: Final = click.FloatRange(min=0.001)


def timeout_option(seconds: float, what: str = "Wait S seconds", flag: str = "--timeout") -> Callable[[C], C]:
    """Make the option --timeout S."""
    return click.option(
        flag,
        type=_SECONDS,
        default=seconds,
        metavar="S",
        help=f"{what}; {seconds:g} by default.",
    )


def json_option(text: str = "One JSON document.") -> Callable[[C], C]:
    """Make the option --json."""
    return click.option("--json", "as_json", is_flag=True, help=text)


def _until(_ctx: click.Context, _param: click.Parameter, seconds: float | None) -> float | None:
    """The time of `time.monotonic()` at which a command ends, from its duration."""
    return None if seconds is None else time.monotonic() + seconds


def following_options(what: str, line: str) -> Callable[[C], C]:
    """Make the options of a command that goes on: --count, --once and --for for its end, --timeout and --json.

    Args:
        what: the things that it prints, in the plural.
        line: the thing that a line of --json stands for.
    """

    def add(command: C) -> C:
        for option in (
            json_option(f"A JSON object in a line for each {line}."),
            timeout_option(1.0, "Wait S seconds for the kernel to answer"),
            click.option("--for", "until", type=_SECONDS, callback=_until, metavar="S", help="End after S seconds."),
            click.option("--once", "count", flag_value=1, type=int, help="The same as --count 1."),
            click.option("--count", type=click.IntRange(min=1), metavar="N", help=f"End after N {what}."),
        ):
            command = option(command)
        return command

    return add


# -- documents ---------------------------------------------------------------------------------------------------------


def say_done(names: Iterable[str], *, as_json: bool) -> int:
    """Print the names of changed things, where a JSON document is wanted; returns the exit status."""
    if as_json:
        say_json({"done": [{"name": name} for name in names]})
    return exits.DONE


def named(things: Mapping[str, Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Things by name in the form of JSON documents: a list of objects, each with its name."""
    return [{"name": name, **about} for name, about in things.items()]


def say_kernels(
    found: Kernels,
    kind: str,
    listed: Mapping[str, list[dict[str, Any]]],
    text: Callable[[list[dict[str, Any]]], str],
    *,
    as_json: bool,
    silent: bool = True,
) -> int:
    """Print the things of a kind in each kernel, and the kernels that do not answer; returns the exit status."""
    if as_json:
        say_json(
            {"kernels": named({name: {kind: things} for name, things in listed.items()}), "no_answer": mute(found)}
        )
        return exits.DONE
    for name, things in listed.items():
        say("\n".join(filter(None, (f"{name}/", text(things)))))
    if silent:
        say_silent(found)
    return exits.DONE


def mute(found: Kernels) -> list[dict[str, Any]]:
    """The kernels that do not answer, in the form of JSON documents."""
    return [{"name": one.entry.name, "pid": one.entry.pid, "why": one.why} for one in found.silent]


def say_silent(found: Kernels) -> None:
    """Print the kernels that do not answer; where no kernel runs, print that."""
    for one in found.silent:
        say(f"{one.entry.name}/  {one.why} (process {one.entry.pid})")
    if not found.running and not found.silent:
        say("nothing runs that can be reached; aiorts run can, and a program with Kernel(services={'control': {}})")


# -- what goes on ------------------------------------------------------------------------------------------------------


def say_missed(stream: Stream, what: str, *, as_json: bool) -> None:
    """Print the number of items missed since the last call, if there are any."""
    missed, stream.missed = stream.missed, 0
    if missed and as_json:
        say_line({"missed": missed})
    elif missed:
        say_now(f"... {missed} {what}")


def moment_text(time_ns: int) -> str:
    """The local time of day, to the millisecond."""
    at = datetime.fromtimestamp(time_ns / 1e9, UTC).astimezone()
    return f"{at:%H:%M:%S}.{at.microsecond // 1000:03d}"


def hint(text: str) -> None:
    """Print a hint on standard error, if that is a terminal, that says why there is no output."""
    if sys.stderr is not None and sys.stderr.isatty():
        tell(f"aiorts: {text}")


class Over(ClosedError):
    """The followed part of a kernel, or its stream, has ended."""


def followed(items: Iterator[T], running: Running, count: int | None) -> Iterator[T]:
    """Yield the items, at most `count`, until their source has ended, which is printed.

    Raises:
        AbsentError: `count` is given, and fewer have come.
    """
    number = 0
    try:
        for item in items:
            number += 1
            yield item
            if number == count:
                return
    except ClosedError as error:
        has_ended(running, error, number, count)


def items_of(stream: Stream, until: float | None) -> Iterator[Any]:
    """Yield the items of a stream until a time of `time.monotonic()`; a thread reads ahead while this program pauses.

    Raises:
        Over: the stream has ended, or its kernel has ended in order.
        ClosedError: the kernel has ended, or has cut off this process.
    """
    stream.client.read_ahead()
    yield from stream.until(until)
    if stream.ended:
        raise Over(stream.result or f"{stream.client.entry.name}: has ended")


def has_ended(running: Running, error: ClosedError, number: int, count: int | None) -> int:
    """Print that a kernel, or a part of it, has ended while it was followed; returns the exit status.

    Raises:
        AbsentError: as `followed`.
        NoAnswerError: the kernel still runs: it has cut off this process, which read nothing for too long.
    """
    if isinstance(error, CutOff):
        raise NoAnswerError(str(error)) from None
    text = str(error) if isinstance(error, Over) else f"{running.name}: has ended"
    if count is not None:
        raise AbsentError(f"{text}; {number} of {count} have come")
    tell(f"aiorts: {text}")
    return exits.DONE
