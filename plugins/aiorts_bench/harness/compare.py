"""Finds the rows that changed between two runs of a bench, beyond their spread: two documents in, lines out.

Other load on the machine moves the times of a run, so a row is judged relative to the baseline of its own run. A row
without a baseline is divided by the factor by which the bare baselines moved. A disturbance only makes a machine
slower, and lasts longer than a round: the rounds of one run are not independent, and their medians move by half between
two equal runs where the best rounds move by a tenth.

A row whose figure is a cost or a rate changed when its best round, relative to the best round of its baseline, moved by
`LEAST` or more and by more than the best three rounds of either run differ, and its second best round and all rounds
together (Hodges and Lehmann) moved by `SECOND`. Where the best three differ beyond `CALM`, the row is not judged. A
percentile of latencies or ages has no such floor: it changed when the rank test of Mann and Whitney finds a difference
at `ALPHA`, of at least `LEAST`, and larger than the middle half of either run.
"""

from __future__ import annotations

import json
import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, TypeAlias

import click

from aiorts_bench.harness.report import SCHEMA

Document: TypeAlias = Mapping[str, Any]

ALPHA: Final = 0.01
LEAST: Final = 1.2
"""The least factor that counts as a change."""
SECOND: Final = 1.1
"""The least factor by which the second best round, and all rounds together, have to move."""
CALM: Final = 1.3
"""The factor by which the best three rounds may differ; beyond it the computer was too busy to judge a row."""
FEWEST: Final = 4
"""Rounds of each run below which no row is judged."""
_MACHINE: Final = ("commit", "aiorts", "python", "cpu", "cores", "system", "packages")
_EXACT: Final = 20
"""The most rounds for which the rank test counts all orders."""


@dataclass(frozen=True, slots=True)
class Shift:
    """The shift from an earlier sample to a later one.

    Attributes:
        factor: how many times as large the later one is, by Hodges and Lehmann: the median of all quotients.
        low, high: the bounds between which 95 % of such estimates lie.
        p: the probability of the rank test, two-sided.
        spread: the wider middle half of the two samples, as a factor.
    """

    factor: float
    low: float
    high: float
    p: float
    spread: float

    def changed(self) -> bool:
        """Whether the samples differ significantly, by `LEAST` or more, and by more than their spread."""
        size = abs(math.log(self.factor))
        return self.p <= ALPHA and size >= math.log(LEAST) and size >= math.log(self.spread)


@dataclass(frozen=True, slots=True)
class Change:
    """A row that changed; `worse` is how many times as bad it became (below 1: better)."""

    row: str
    worse: float
    text: str


@dataclass(frozen=True, slots=True)
class Comparison:
    """The lines to print, and the changes among them."""

    lines: tuple[str, ...]
    changes: tuple[Change, ...]


def read(file: Path) -> Document:
    """A document that `--json` wrote.

    Raises:
        click.BadParameter: it cannot be read, or is no such document.
    """
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise click.BadParameter(f"{file}: {error}", param_hint="--compare") from None
    if not isinstance(found, dict) or not {"schema", "bench", "rows"} <= found.keys():
        raise click.BadParameter(f"{file}: expected what --json writes", param_hint="--compare")
    return found


def compare(old: Document, new: Document) -> Comparison:
    """Compare two documents: the changes from `old` to `new`."""
    if old["schema"] != SCHEMA or old["bench"] != new["bench"]:
        other, here = ("schema", SCHEMA) if old["schema"] != SCHEMA else ("bench", new["bench"])
        return Comparison((f"not compared: the old file has {other} {old[other]}, this run {here}",), ())
    before = {_key(row): row for row in old["rows"]}
    after = {_key(row): row for row in new["rows"]}
    lines = [*_circumstances(old, new)]
    lines += [f"only in the old file: {_where(row)}" for key, row in before.items() if key not in after]
    lines += [f"only in this run: {_where(row)}" for key, row in after.items() if key not in before]
    bases = {(row["loop"], ratio["baseline"]) for row in after.values() for ratio in row["ratios"]}
    common = [key for key in after if key in before]
    bare = [key for key in common if key in bases and not after[key]["ratios"]]
    drift = _drift(bare, before, after)
    judged, few, busy = [], 0, 0
    for key in common:
        if key in bare or after[key].get("peer"):
            continue
        pair = _samples(before[key], after[key], drift.get(key[0], 1.0))
        if min(len(pair.old), len(pair.new)) < FEWEST:
            few += 1
        elif min(*pair.old, *pair.new) > 0:
            best = _best(before[key], after[key], before, after, drift.get(key[0], 1.0))
            if best is not None and best.calm > CALM:
                busy += 1
            else:
                judged.append((after[key], pair, shift(pair.old, pair.new), best))
    if few:
        lines.append(f"{few} rows not judged: below {FEWEST} rounds")
    if busy:
        lines.append(f"{busy} rows not judged: the machine was busy, their best rounds differ beyond {CALM:g}x")
    changes = [_change(row, pair, found, best) for row, pair, found, best in judged if _changed(pair, found, best)]
    changes.sort(key=lambda change: -abs(math.log(change.worse)))
    lines += [change.text for change in changes]
    if judged and not changes:
        lines.append(f"no change beyond the spread in {len(judged)} rows (least {LEAST:g}x)")
    return Comparison(tuple(lines), tuple(changes))


@dataclass(frozen=True, slots=True)
class _Pair:
    old: Sequence[float]
    new: Sequence[float]
    what: str
    more_is_worse: bool


@dataclass(frozen=True, slots=True)
class _Best:
    """How many times as bad the best and the second best round became.

    Attributes:
        calm: the largest factor from the best to the third best round of a sample: near 1 on a quiet computer.
    """

    first: float
    second: float
    calm: float


def _key(row: Mapping[str, Any]) -> tuple[str, str]:
    return row["loop"], row["case"]


def _where(row: Mapping[str, Any]) -> str:
    return str(row["case"]) if row["loop"] == "none" else f"{row['case']} on {row['loop']}"


def _circumstances(old: Document, new: Document) -> list[str]:
    """The lines on machine, rounds and scale where they differ between the two runs."""
    lines = []
    for key in _MACHINE:
        was, now = old["machine"].get(key), new["machine"].get(key)
        if was != now and key == "packages":
            was, now = (", ".join(f"{name} {number}" for name, number in sorted(it.items())) for it in (was, now))
        if was != now:
            lines.append(f"{key}: {was} -> {now}")
    return lines + [f"{key}: {old[key]:g} -> {new[key]:g}" for key in ("rounds", "scale") if old[key] != new[key]]


def _drift(bare: Sequence[tuple[str, str]], before: Mapping[Any, Any], after: Mapping[Any, Any]) -> dict[str, float]:
    """The median factor by which the bare baselines moved, by loop."""
    moved: dict[str, list[float]] = {}
    for key in bare:
        was, now = _compared(before[key]), _compared(after[key])
        if was["median"] > 0 and now["median"] > 0:
            quotient = now["median"] / was["median"]
            moved.setdefault(key[0], []).append(quotient if now["better"] == "less" else 1 / quotient)
    return {loop: statistics.median(quotients) for loop, quotients in moved.items()}


def _compared(row: Mapping[str, Any]) -> Mapping[str, Any]:
    found: Mapping[str, Any] = row["measures"][row["compared"]]
    return found


def _samples(old: Mapping[str, Any], new: Mapping[str, Any], drift: float) -> _Pair:
    """The two samples of a row to compare: its first ratio that both runs have, else the figure without the drift."""
    wanted = ("baseline", "measure", "sense", "times", "extra", "floor")
    before = {tuple(ratio[key] for key in wanted): ratio for ratio in old["ratios"] if ratio["baseline"]}
    for ratio in new["ratios"]:
        other = before.get(tuple(ratio[key] for key in wanted))
        if other is not None:
            bad = ratio["sense"] == "at most"
            return _Pair(other["rounds"], ratio["rounds"], f"to {ratio['baseline']}", bad)
    was, now = _compared(old), _compared(new)
    less = now["better"] == "less"
    scaled = [value / drift if less else value * drift for value in now["rounds"]]
    return _Pair(was["rounds"], scaled, now["unit"], less)


def _best(
    old: Mapping[str, Any], new: Mapping[str, Any], before: Mapping[Any, Any], after: Mapping[Any, Any], drift: float
) -> _Best | None:
    """The factors by which the best rounds moved; None where the figure is neither a cost nor a rate."""
    figures = [_compared(old), _compared(new)]
    wanted = next((ratio["baseline"] for ratio in new["ratios"] if ratio["baseline"]), None)
    bases = [rows.get((new["loop"], wanted)) for rows in (before, after)]
    figures += [_compared(row) for row in bases if row is not None and wanted is not None]
    if any(figure["pooled"] is not None for figure in figures) or len({figure["unit"] for figure in figures}) > 1:
        return None
    bests = [_least_bad(figure) for figure in figures]
    calm = max(third / first for first, _, third in bests)
    was, now = bests[:2]
    first, second = now[0] / was[0], now[1] / was[1]
    if len(bests) == 4:
        base_was, base_now = bests[2:]
        return _Best(first / base_now[0] * base_was[0], second / base_now[1] * base_was[1], calm)
    return _Best(first / drift, second / drift, calm)


def _least_bad(figure: Mapping[str, Any]) -> tuple[float, float, float]:
    ordered = sorted(value if figure["better"] == "less" else 1 / value for value in figure["rounds"])
    return ordered[0], ordered[1], ordered[2]


def _changed(pair: _Pair, found: Shift, best: _Best | None) -> bool:
    if best is None:
        return found.changed()
    worse = found.factor if pair.more_is_worse else 1 / found.factor
    first, second, together = (math.log(value) for value in (best.first, best.second, worse))
    if first < 0:
        first, second, together = -first, -second, -together
    return first >= max(math.log(LEAST), math.log(best.calm)) and min(second, together) >= math.log(SECOND)


def _change(row: Mapping[str, Any], pair: _Pair, found: Shift, best: _Best | None) -> Change:
    worse = found.factor if pair.more_is_worse else 1 / found.factor
    low, high = (found.low, found.high) if pair.more_is_worse else (1 / found.high, 1 / found.low)
    word = "worse" if worse > 1 else "better"
    if worse < 1:
        low, high = 1 / high, 1 / low
    was, now = statistics.median(pair.old), statistics.median(pair.new)
    figures = (
        f"{was:.2f}x -> {now:.2f}x {pair.what}"
        if pair.what.startswith("to ")
        else f"{was:.4g} -> {now:.4g} {pair.what}"
    )
    rounds = "" if best is None else f"best rounds {best.first:.2f}x, "
    text = f"CHANGED {_where(row)}: {max(worse, 1 / worse):.2f}x {word} ({low:.2f}..{high:.2f}): {rounds}{figures}"
    return Change(_where(row), worse, text)


def shift(old: Sequence[float], new: Sequence[float]) -> Shift:
    """The shift from `old` to `new`; all values are above 0."""
    before, after = [math.log(value) for value in old], [math.log(value) for value in new]
    differences = sorted(b - a for a in before for b in after)
    above = sum(1.0 if one > 0 else 0.5 if one == 0 else 0.0 for one in differences)
    cells = len(differences)
    p = min(1.0, 2 * _tail(len(before), len(after), min(above, cells - above)))
    edge = 0
    while edge + 1 < cells // 2 and _tail(len(before), len(after), edge) <= 0.025:
        edge += 1
    spread = max(_middle(before), _middle(after))
    low, high = differences[edge], differences[cells - 1 - edge]
    return Shift(math.exp(statistics.median(differences)), math.exp(low), math.exp(high), p, math.exp(spread))


def _middle(values: Sequence[float]) -> float:
    q1, _, q3 = statistics.quantiles(values, n=4, method="inclusive")
    return q3 - q1


def _tail(first: int, second: int, statistic: float) -> float:
    """The chance that Mann and Whitney's statistic of two equal samples is at most this."""
    if max(first, second) > _EXACT:
        mean = first * second / 2
        deviation = math.sqrt(first * second * (first + second + 1) / 12)
        return 0.5 * math.erfc((mean - statistic - 0.5) / deviation / math.sqrt(2))
    counts = _orders(first, second)
    return sum(counts[: math.ceil(statistic) + 1]) / math.comb(first + second, first)


@lru_cache(maxsize=64)
def _orders(first: int, second: int) -> tuple[int, ...]:
    """The number of orders of two samples that give each value of the statistic."""
    if first == 0 or second == 0:
        return (1,)
    counts = [0] * (first * second + 1)
    for value, count in enumerate(_orders(first - 1, second)):
        counts[value + second] += count
    for value, count in enumerate(_orders(first, second - 1)):
        counts[value] += count
    return tuple(counts)
