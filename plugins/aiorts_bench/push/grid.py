"""Measures every meaningful combination of the lists given to `aiorts bench push`, one row each."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import click

from aiorts.spelling import suggestion
from aiorts_bench.harness.bench import Options
from aiorts_bench.harness.report import Report
from aiorts_bench.push import answer, load
from aiorts_bench.push.load import Load

_SIZES: Final = {"": 1, "b": 1, "kb": 1000, "mb": 1_000_000, "gb": 1_000_000_000}
_LARGEST: Final = 1_000_000_000


def _word(*words: str) -> Callable[[str], str]:
    def read(text: str) -> str:
        if text in words:
            return text
        raise ValueError(suggestion(text, words, f"expected {', '.join(words)}", shown=str))

    return read


def _whole(low: int, high: int) -> Callable[[str], int]:
    def read(text: str) -> int:
        # 12 characters: int() of a long text takes quadratic time, and refuses more than 4,300 digits.
        if not text.isascii() or not text.isdigit() or not low <= int(text[:12]) <= high:
            raise ValueError(f"expected a whole number from {low} to {high}")
        return int(text)

    return read


def _rate(word: str, high: float) -> Callable[[str], float | None]:
    expected = f"expected a number from 1 to {high:g}" + (f", or {word}" if word else "")

    def read(text: str) -> float | None:
        if word and text == word:
            return None
        try:
            number = float(text)
        except ValueError:
            raise ValueError(suggestion(text, [word] if word else [], expected, shown=str)) from None
        if not 1 <= number <= high:  # also refuses NaN
            raise ValueError(expected)
        return number

    return read


def _payload(text: str) -> float | int:
    if text == "float":
        return 1.0
    digits = text.rstrip("kKmMgGbB")
    size = _SIZES.get(text[len(digits) :].lower())
    if not digits.isascii() or not digits.isdigit() or size is None or not 8 <= int(digits[:12]) * size <= _LARGEST:
        otherwise = "expected float, or a size from 8B to 1GB such as 1kB"
        raise ValueError(suggestion(text, ["float", "1kB", "1MB"], otherwise, shown=str))
    return int(digits) * size


@dataclass(frozen=True, slots=True)
class Axis:
    """One option whose value is a list.

    Attributes:
        field: the field of `Load` that it sets.
        read: makes a value of one word of the list; raises ValueError with what is expected.
        default: the list when the option is not given.
    """

    name: str
    field: str
    read: Callable[[str], Any]
    default: str
    help: str


AXES: Final = (
    Axis(
        "subscription", "subscription", _word("flush", "new", "periodic"), "flush,new,periodic", "Subscription types."
    ),
    Axis("push", "push", _word("all", "fifo", "skip", "new"), "all,new", "Push policies; skip takes every second."),
    Axis("full", "full", _word("overwrite", "reject", "block"), "overwrite", "Full policies."),
    Axis("payload", "payload", _payload, "float", "float, or sizes of an array: 1kB,1MB."),
    Axis("fan-in", "fan_in", _whole(1, 1000), "1", "Writers of one reader."),
    Axis("fan-out", "fan_out", _whole(1, 1000), "1", "Readers of one writer."),
    Axis("producer-rate", "producer_rate", _rate("max", 1e6), "1000", "Messages a second of each writer, or max."),
    Axis("consumer-rate", "consumer_rate", _rate("max", 1e4), "max", "Messages a second that a reader takes, or max."),
    Axis("length", "length", _whole(1, 1_000_000), "8", "Lengths of the reader's buffer."),
    Axis(
        *("push-rate", "push_rate", _rate("none", 1e4), "200"),
        "Hz of periodic connectors; that of the reader where --consumer-rate gives it.",
    ),
)
OPTIONS: Final = tuple(
    click.Option([f"--{axis.name}"], metavar="LIST", help=f"{axis.help} Default {axis.default}.") for axis in AXES
)


def chosen(options: Options) -> dict[str, str]:
    """The lists that were given, by the name of their axis; empty when none were."""
    return {axis.name: text for axis in AXES if (text := options.extra.get(axis.name.replace("-", "_"))) is not None}


def parse(given: Mapping[str, str]) -> dict[str, list[tuple[str, Any]]]:
    """The words of each axis and their values.

    Raises:
        click.BadParameter: a word is wrong; the message has the option, the word, and what is expected.
    """
    found: dict[str, list[tuple[str, Any]]] = {}
    for axis in AXES:
        words = dict.fromkeys(word.strip() for word in given.get(axis.name, axis.default).split(","))
        found[axis.name] = []
        for word in words:
            try:
                found[axis.name].append((word, axis.read(word)))
            except ValueError as error:
                raise click.BadParameter(f"{word[:40]!r}: {error}", param_hint=f"--{axis.name}") from None
    return found


@dataclass(frozen=True, slots=True)
class Plan:
    """The combinations that are measured, and those that are left out.

    Attributes:
        loads: each with its words of the axes that vary.
        fixed: the words of the axes that do not vary.
        left_out: one line with the number of combinations left out and the reasons; empty when there are none.
    """

    loads: tuple[tuple[dict[str, str], Load], ...]
    fixed: dict[str, str]
    left_out: tuple[str, ...]


def plan(given: Mapping[str, str]) -> Plan:
    """Plan every combination that differs from the others in what is measured."""
    axes = parse(given)
    varying = [name for name, words in axes.items() if len(words) > 1]
    follows = "push-rate" not in given and any(rate is not None for _, rate in axes["consumer-rate"])
    reasons: dict[str, None] = {}
    combinations = 0
    seen: dict[Load, dict[str, str]] = {}
    for combination in itertools.product(*axes.values()):
        words = {name: word for name, (word, _) in zip(axes, combination, strict=True)}
        requested = Load(**{axis.field: value for axis, (_, value) in zip(AXES, combination, strict=True)})
        if follows and requested.consumer_rate is not None:
            requested = replace(requested, push_rate=requested.consumer_rate)
        combinations += 1
        kept, changed, why = _sensible(requested)
        words.update(changed)
        if kept is None or kept in seen:
            reasons.update(dict.fromkeys(text for axis, text in why.items() if kept is None or axis in varying))
        else:
            seen[kept] = words
    loads = tuple(({name: words[name] for name in varying}, one) for one, words in seen.items())
    fixed = {name: words[0][0] for name, words in axes.items() if len(words) == 1}
    if follows:
        fixed["push-rate"] = "that of the reader"
    left = combinations - len(loads)
    note = f"left out {left} of {combinations} combinations that differ in nothing: {'; '.join(reasons)}"
    return Plan(loads, fixed, (note,) if left else ())


def _sensible(requested: Load) -> tuple[Load | None, dict[str, str], dict[str, str]]:
    """The load without options that have no effect, the words shown instead of these, and the reasons by axis."""
    kept, words, why = requested, {}, {}
    if requested.subscription == "periodic" and requested.push_rate is None:
        return None, {}, {"push-rate": "periodic without a push-rate is no connector"}
    if requested.subscription != "periodic":
        kept = replace(kept, push_rate=None)
        words["push-rate"] = "-"
        why["push-rate"] = "only periodic has a push-rate"
    if requested.subscription == "flush":
        kept = replace(kept, push="all")
        words["push"] = "-"
        why["push"] = "flush has no push policy"
    if requested.subscription == "new" and requested.push == "new":
        kept = replace(kept, full="overwrite", length=None)
        words.update({"full": "-", "length": "1"})
        why |= dict.fromkeys(("full", "length"), "new/new holds one value: no full policy, no length")
    return kept, words, why


def report(options: Options, given: Mapping[str, str]) -> Report:
    """Measure every combination of the lists: one row each."""
    planned = plan(given)
    loops = options.loops if "loop" in options.given else options.loops[-1:]
    if "rounds" not in options.given:
        options = replace(options, rounds=1 if options.quick else 3)
    cases = tuple(load.case(_title(axes), one, axes) for axes, one in planned.loads)
    seconds = sum(case.messages for case in cases) * options.scale * options.rounds * len(loops) / 1000
    if options.notify is not None and seconds > 10:
        options.notify(f"{len(cases)} combinations, about {_duration(seconds)}")
    rows = tuple(row for loop in loops for row in options.rows(cases, loop=loop))
    fixed = ", ".join(f"{name} {word}" for name, word in planned.fixed.items())
    notes = ((f"everywhere: {fixed}",) if fixed else ()) + planned.left_out
    ends = [row for row in rows if row.loop == loops[-1]]
    notes += answer.lines(zip((one for _, one in planned.loads), ends, strict=True))
    readers = {one.consumer_rate for _, one in planned.loads}
    figures = load.curves(rows, fixed, readers.pop() if len(readers) == 1 else None) if options.plot else ()
    return options.report("push", rows, how=_how(options.rounds), notes=notes, figures=figures)


def _title(axes: Mapping[str, str]) -> str:
    return " ".join(word for word in axes.values() if word != "-") or "the only one"


def _how(rounds: int) -> str:
    return (
        f"{rounds} round{'s' if rounds > 1 else ''}, combinations interleaved. rate: messages read in a second, "
        "median of the rounds; offered: written. latency: write to read; age: of the newest value whenever the reader "
        "runs; percentiles of all rounds together. Producers write on absolute deadlines by the kernel's timers, above "
        f"{load.BURSTS:.0f} a second in bursts; cpu is that of the whole process, their own share included."
    )


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} min"
