"""Answers which policy suits a pair of rates, from the rows of a grid, and explains the ages in them. Pure."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

from aiorts.errors import SLOW_READER
from aiorts_bench.harness.report import Row
from aiorts_bench.push.load import Load

POINTER: Final = (
    "Which policy for your rates? aiorts bench push --producer-rate HZ --consumer-rate HZ says it in a sentence."
)
_SIMPLEST: Final = ("flush", "new", "periodic")
_LIKE: Final = 1.25
"""Ages that differ by less than this factor are alike."""
_ALIKE_MS: Final = 0.2
"""Ages that differ by less than a wake-up on a busy machine are alike, too."""
_EXPLAINED: Final = 0.35
"""Share by which a measured age may differ from length / rate: timers, and a writer that waits with one more value."""


@dataclass(frozen=True, slots=True)
class _Found:
    """The figures of a row for one way of pushing; ages in ms, rates in messages a second of one reader.

    Attributes:
        explained: length, rate and word of the buffer that makes the age; None where none does.
    """

    load: Load
    name: str
    age: float
    offered: float
    lost: float
    explained: tuple[int, float, str] | None

    @property
    def judged(self) -> float:
        """The age to compare: computed from buffer or phases where these are known, since a median depends on luck."""
        if self.explained is not None:
            return 1000 * self.explained[0] / self.explained[1]
        return max(self.age, self.bound) if self.load.subscription == "periodic" else self.age

    @property
    def bound(self) -> float:
        """The greatest age of the newest value, however the phases of writer, connector and reader fall; 0: unknown."""
        load = self.load
        if load.producer_rate is None or load.consumer_rate is None or load.push not in ("all", "new"):
            return 0.0
        waits = load.push_rate if load.subscription == "periodic" and load.push == "new" else None
        return 1000 / load.producer_rate + (1000 / waits if waits else 0.0)


def lines(measured: Iterable[tuple[Load, Row]]) -> tuple[str, ...]:
    """For each pair of rates a line that explains the ages, where a rule does so; then a sentence for each pair."""
    groups: dict[tuple[object, ...], list[tuple[Load, Row]]] = {}
    for load, row in measured:
        if "age p50" in row.figures:  # else nothing was read
            key = (load.producer_rate, load.consumer_rate, load.fan_in, load.fan_out, load.payload)
            groups.setdefault(key, []).append((load, row))
    explained, answers = [], []
    for group in groups.values():
        loads = [load for load, _ in group]
        found = [_found(load, row, loads) for load, row in group]
        explained += _explanation(found)
        answers.append(_answer(found))
    return (*explained, *answers)


def _found(load: Load, row: Row, beside: list[Load]) -> _Found:
    age, offered = row.figures["age p50"].displayed, row.figures["offered"].displayed / load.fan_out
    counts = row.ledger
    lost = sum(counts.dropped.values()) / counts.written if counts is not None and counts.written else 0.0
    explained = _buffered(load, offered / load.fan_in)
    if explained is not None:
        bound = 1000 * explained[0] / explained[1]
        low = 0.0 if explained[0] == 1 else bound * (1 - _EXPLAINED)
        explained = explained if low <= age <= bound * (1 + _EXPLAINED) else None
    return _Found(load, _name(load, beside), age, offered, lost, explained)


def _buffered(load: Load, offered: float) -> tuple[int, float, str] | None:
    """Length, rate and word of the buffer whose oldest value the reader takes; None when the buffer does not fill."""
    taken = load.consumer_rate
    if taken is None:
        return None
    rate = load.producer_rate or offered
    coming = rate
    if load.subscription == "periodic" and load.push in ("new", "fifo"):
        coming = min(rate, load.push_rate or rate)
    elif load.push == "skip":
        coming = rate / 2
    if coming * load.fan_in <= taken * 1.02:
        return None
    length = load.length or 1
    if load.full == "overwrite":
        return length, coming, "newest"
    return length * load.fan_in, taken, "oldest"


def _name(load: Load, beside: list[Load]) -> str:
    """The way of pushing in a few words, without options that are alike in all loads of its group."""
    words = [load.subscription if load.subscription == "flush" else f"{load.subscription}/{load.push}"]
    if load.push_rate is not None:
        words.append(f"at {load.push_rate:g} Hz")
    if load.length is not None:
        words += [load.full] if len({one.full for one in beside if one.length is not None}) > 1 else []
        words += [f"length {load.length}"] if len({one.length for one in beside if one.length is not None}) > 1 else []
    return " ".join(words)


def _explanation(found: list[_Found]) -> list[str]:
    """A line that explains the ages: length / rate, with the ages that were measured."""
    causes: dict[tuple[int, float, str], list[_Found]] = {}
    for one in found:
        if one.explained is not None:
            causes.setdefault(one.explained, []).append(one)
    if not causes:
        return []
    parts = []
    for (length, rate, word), ones in sorted(causes.items(), key=lambda cause: -cause[0][0] / cause[0][1]):
        ages = ", ".join(f"{one.name} {_ms(one.age)}" for one in ones)
        most, kept = (" at most", "the newest value is kept") if length == 1 else ("", f"the {word} {length} are kept")
        parts.append(f"{length} / {_hertz(rate)} = {_ms(1000 * length / rate)}{most} ({kept}; measured: {ages})")
    head = "age = length / rate, for the reader is slower than what comes and takes the oldest value of a full buffer: "
    return [f"{_rates(found[0])}: {head}{', '.join(parts)}"]


def _answer(found: list[_Found]) -> str:
    every, taken = _every(found), found[0].load.consumer_rate
    behind = taken is not None and every > taken * 1.02
    # A writer that waited loses nothing, but offers less: its reader does not get all samples.
    whole = [one for one in found if one.lost < 0.02 and one.offered > 0.95 * every]
    # When the reader waits for its next cycle, up to one period of an age is luck.
    luck = _ALIKE_MS if behind or taken is None else 1000 / taken
    alike = _alike(found if behind or not whole else whole, luck)
    best = min(alike, key=lambda one: (behind and one.load.push != "new", _SIMPLEST.index(one.load.subscription)))
    stale = [one for one in found if one.age > best.age * _LIKE + luck]
    beside = next((one for one in stale if one.load.subscription == "flush"), None) or max(
        stale, key=lambda one: one.age, default=None
    )
    take = (
        f"{_rates(found[0])}: take {best.name} ({_options(best.load)}), whose values are {_ms(best.age)} old "
        f"(median{_phase(best)})"
    )
    instead = "" if beside is None else f" instead of {_ms(beside.age)} with {beside.name}"
    if not behind or taken is None:
        lost = "nothing is dropped" if best.lost < 0.0005 else f"{best.lost:.1%} are dropped"
        return f"{take}{instead}; {lost}, for the reader keeps up."
    held = " or held up by block" if any(one.load.full == "block" for one in found) else ""
    return (
        f"{take}{instead}; with one read a cycle the reader takes {taken:g} of {every:.4g} messages a second, and "
        f"{every - taken:.4g} are dropped{held};{_drained(found, taken)} {SLOW_READER}."
    )


def _phase(one: _Found) -> str:
    """Words on how far the age depends on the phases of writer and reader, which stay as they were at the start."""
    single = one.explained is None or one.explained[0] == 1
    return f"; up to {_ms(one.bound)}, as their phases fall" if single and one.age <= one.bound + _ALIKE_MS else ""


def _drained(found: list[_Found], taken: float) -> str:
    """Words on a reader that takes all samples in each cycle, as `drain()` does; computed, not measured."""
    rate = found[0].load.producer_rate
    if rate is None:
        return ""
    most = int(rate / taken) + 1
    there = max(one.load.length or 1 for one in found)
    room = f" with length={most} or more" if most > there else ""
    return f" one that drains takes all{room}, the oldest {_ms(1000 / taken)} old (computed);"


def _alike(found: list[_Found], luck: float) -> list[_Found]:
    """The way with the least age, and those with ages alike, least age first."""
    least = min(one.judged for one in found)
    return sorted((one for one in found if one.judged <= least * _LIKE + luck), key=lambda one: one.judged)


def _every(found: list[_Found]) -> float:
    """The messages a second that a reader is offered."""
    rate = found[0].load.producer_rate
    return max(one.offered for one in found) if rate is None else rate * found[0].load.fan_in


def _rates(one: _Found) -> str:
    load = one.load
    rate = "as fast as it can" if load.producer_rate is None else _hertz(load.producer_rate)
    reader = "a reader woken by each" if load.consumer_rate is None else _hertz(load.consumer_rate)
    many = f"{load.fan_in} x " if load.fan_in > 1 else ""
    size = f", {load.payload} bytes" if isinstance(load.payload, int) else ""
    return f"{many}{rate} -> {reader}{size}"


def _options(load: Load) -> str:
    """The options of a load as they are written at `connect`."""
    options = load.options
    shown = ["subscription", *(["push"] if load.subscription != "flush" else [])]
    shown += [key for key, usual in (("full", "overwrite"), ("length", 8)) if options.get(key, usual) != usual]
    shown += [key for key in ("skip", "push_rate") if key in options]
    return ", ".join(
        f"{key}={options[key]:g}" if isinstance(options[key], (int, float)) else f'{key}="{options[key]}"'
        for key in shown
    )


def _ms(value: float) -> str:
    return f"{value:.3g} ms" if value < 1000 else f"{value:,.0f} ms".replace(",", "")


def _hertz(rate: float) -> str:
    return f"{rate:g} Hz" if rate < 1e4 else f"{rate / 1000:.3g} kHz"
