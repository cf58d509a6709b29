"""What commands for what runs have in common: options, JSON documents, what is said where nothing is to be seen."""

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
    """--timeout S."""
    return click.option(
        flag,
        type=_SECONDS,
        default=seconds,
        metavar="S",
        help=f"{what}; {seconds:g} by default.",
    )


def json_option(text: str = "One JSON document.") -> Callable[[C], C]:
    """--json."""
    return click.option("--json", "as_json", is_flag=True, help=text)


def _until(_ctx: click.Context, _param: click.Parameter, seconds: float | None) -> float | None:
    """The moment of `time.monotonic()` at which a command ends, by how long it is to go on."""
    return None if seconds is None else time.monotonic() + seconds


def following_options(what: str, line: str) -> Callable[[C], C]:
    """Those of a command that goes on: --count, --once and --for say when it ends, --timeout and --json are as ever.

    Args:
        what: it prints.
        line: for what a line of --json is.
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
    """Say to which things something was done, where a document is asked for; the exit status."""
    if as_json:
        say_json({"done": [{"name": name} for name in names]})
    return exits.DONE


def named(things: Mapping[str, Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Things by name as documents have them: a list of objects, each with its name."""
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
    """Print what each kernel has of a kind, and which kernels do not answer; the exit status."""
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
    """The kernels that do not answer, as documents have them."""
    return [{"name": one.entry.name, "pid": one.entry.pid, "why": one.why} for one in found.silent]


def say_silent(found: Kernels) -> None:
    """Print which kernels do not answer, and that none runs where none does."""
    for one in found.silent:
        say(f"{one.entry.name}/  {one.why} (process {one.entry.pid})")
    if not found.running and not found.silent:
        say("nothing runs that can be reached; aiorts run can, and a program with Kernel(services={'control': {}})")


# -- what goes on ------------------------------------------------------------------------------------------------------


def say_missed(stream: Stream, what: str, *, as_json: bool) -> None:
    """Say how many items are missing since the last time, if any are."""
    missed, stream.missed = stream.missed, 0
    if missed and as_json:
        say_line({"missed": missed})
    elif missed:
        say_now(f"... {missed} {what}")


def moment_text(time_ns: int) -> str:
    """The time of day here, to the millisecond."""
    at = datetime.fromtimestamp(time_ns / 1e9, UTC).astimezone()
    return f"{at:%H:%M:%S}.{at.microsecond // 1000:03d}"


def hint(text: str) -> None:
    """Tell a person on standard error why there is nothing to be seen; a program is told nothing."""
    if sys.stderr is not None and sys.stderr.isatty():
        tell(f"aiorts: {text}")


class Over(ClosedError):
    """A part of a kernel that was followed is there no more."""


def followed(items: Iterator[T], running: Running, count: int | None) -> Iterator[T]:
    """The items, `count` of them where it is given, until what gives them has ended, which is said.

    Raises:
        AbsentError: `count` were asked for, and fewer have come.
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
    """What comes of a stream before a time of `time.monotonic()`; it is taken on while this process is held back.

    Raises:
        Over: the stream has ended, or its kernel in order.
        ClosedError: the kernel has ended, or has cut off this process.
    """
    stream.client.read_ahead()
    yield from stream.until(until)
    if stream.ended:
        raise Over(stream.result or f"{stream.client.entry.name}: has ended")


def has_ended(running: Running, error: ClosedError, number: int, count: int | None) -> int:
    """Say that a kernel, or a part of it, has ended while it was followed; the exit status.

    Raises:
        AbsentError: as `followed`.
        NoAnswerError: the kernel runs on: it has cut off this process, which took nothing.
    """
    if isinstance(error, CutOff):
        raise NoAnswerError(str(error)) from None
    text = str(error) if isinstance(error, Over) else f"{running.name}: has ended"
    if count is not None:
        raise AbsentError(f"{text}; {number} of {count} have come")
    tell(f"aiorts: {text}")
    return exits.DONE
