"""Whether a system does worse after a change than before it: pure, from the window before and the window after.

The intended effects of a change are no faults. Where it has lowered the rate of a context, or removed connectors of
an in-port, less is expected of all components downstream. Nothing is expected of a component that is not active, or
that the change has taken out of its contexts. Samples that such a component would have read are no losses.

The effects of the machine are no faults of a change either. Overruns for which it is to blame do not count. Where it
took more of the time than before, backlogs follow, and their lateness cannot be separated from other lateness: as
great a part of the ticks may overrun in addition, or a tenth of all the time that it took, if that is more. The same
holds for dropped samples, but only the tenth where their writer leaves out ticks that it missed. Where the machine
took much (`BUSY`, `BUSIEST`), rates decide nothing.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping
from typing import Final

from aiorts.late import dataclass
from aiorts.model.health.windows import ContextCounts, EdgeCounts, Window

SAMPLES: Final = 50
"""The fewest samples, or ticks, that decide anything."""
MORE: Final = 2
"""The factor by which overruns, or drops, may grow in a healthy system."""
PERCENT: Final = 1
"""The percentage of ticks that may overrun in addition, or of written samples that may be dropped."""
SLOWEST: Final = 80
"""The percentage of the rate before that is still healthy."""
NOISE: Final = 0.1
"""The part of the time taken by the machine that may show in figures that it should not change."""
BUSY: Final = 0.1
"""Rates decide nothing where the part of the time that the machine took grew by more than this."""
BUSIEST: Final = 0.5
"""Rates decide nothing where the machine took a greater part of the time than this."""


@dataclass(frozen=True, slots=True)
class Unhealthy:
    """The figure by which a system does worse than before; `str` gives it as one sentence."""

    what: str
    """ "error", "overruns", "drops" or "rate"."""
    name: str
    """The name of the component, the context or the connector."""
    text: str
    """The figure, with that of the window before."""

    def __str__(self) -> str:
        return f"{self.name}: {self.text}"


def verdict(before: Window, after: Window, new: Collection[str] = (), ended: Collection[str] = ()) -> Unhealthy | None:
    """The figure that is worse in the window after a change than in the window before; None: there is none.

    Args:
        new: components that the change has made or replaced; another one that is in error as before is no worse.
        ended: components that the change has taken out of all contexts that ran them.
    """
    for name, why in after.errors.items():
        if name in new or name not in before.errors:
            return Unhealthy("error", name, f"in error: {why}")
    if after.length_ns <= 0:
        return None
    if before.length_ns <= 0:
        before = Window(1)  # nothing was counted: everything is new
    lengths = after.length_ns, before.length_ns
    taken = max(0.0, after.stalled - before.stalled)
    seconds = after.length_ns / 1e9
    for name, ran in after.contexts.items():
        was = before.contexts.get(name, _NO_TICKS)
        late, late_before = ran.overruns - ran.by_machine, was.overruns - was.by_machine
        if _too_many(late, ran.ticks, late_before, *lengths, max(taken, NOISE * after.stalled)):
            text = f"{late} of {ran.ticks} ticks overran in {seconds:g} s, and {late_before} of {was.ticks} before"
            return Unhealthy("overruns", name, text)
    for name, one in after.edges.items():
        if _component(one.target) in ended:
            continue
        had = before.edges.get(name, _NO_SAMPLES)
        # Samples that an option left out before, and leaves out no longer, did not reach the reader either.
        lost_before = had.dropped + max(0, had.left_out - one.left_out * before.length_ns // after.length_ns)
        if _too_many(one.dropped, one.written, lost_before, *lengths, 0.0) and (
            not after.stalled or _too_many(one.dropped, one.written, lost_before, *lengths, _at_once(one, after, taken))
        ):
            lost = f"{one.dropped} of {one.written} samples were dropped in {seconds:g} s"
            return Unhealthy("drops", name, f"{lost}, and {lost_before} of {had.written} before")
    if taken > BUSY or after.stalled > BUSIEST:
        return None
    return _slower(before, after, ended, *lengths)


_NO_TICKS: Final = ContextCounts()
_NO_SAMPLES: Final = EdgeCounts("", "")


def _too_many(lost: int, of: int, lost_before: int, now_ns: int, then_ns: int, taken: float) -> bool:
    if lost <= 0 or of < SAMPLES:
        return False
    beside = (PERCENT + 100 * taken if taken else PERCENT) * of
    return 100 * lost * then_ns > 100 * MORE * lost_before * now_ns + beside * then_ns


def _at_once(edge: EdgeCounts, window: Window, taken: float) -> float:
    """The part of the samples that may come at once when the machine runs the process again."""
    writer = _component(edge.source)
    contexts = [one for one in window.contexts.values() if writer in one.members]
    paced = contexts and all(one.paced for one in contexts)
    seen = NOISE * window.stalled
    return seen if paced else max(taken, seen)


def _slower(before: Window, after: Window, ended: Collection[str], now_ns: int, then_ns: int) -> Unhealthy | None:
    """The figure of the first edge that is too slow; None for none."""
    expected: Mapping[str, float] | None = None
    for name, one in after.edges.items():
        had = before.edges.get(name)
        if had is None or had.written < SAMPLES or 100 * one.written * then_ns >= SLOWEST * had.written * now_ns:
            continue
        if expected is None:  # at the first slow edge: most systems have none
            expected = _expected(before, after, ended)
        due = had.written * now_ns / then_ns * expected.get(_component(one.source), 1.0)
        if due >= SAMPLES and 100 * one.written < SLOWEST * due:
            now, then = one.written * 1e9 / now_ns, had.written * 1e9 / then_ns
            return Unhealthy("rate", name, f"{now:.4g} samples a second, and {then:.4g} before")
    return None


def _expected(before: Window, after: Window, ended: Collection[str]) -> dict[str, float]:
    """The part (0 to 1) of its former output that is still expected of a component, for those with less than all."""
    found = dict.fromkeys((*after.idle, *ended), 0.0)
    rates, without = _rates(before)
    rates_now, without_now = _rates(after)
    for name in {name for one in after.contexts.values() for name in one.members}:
        was, rate = rates.get(name, 0.0), rates_now.get(name, 0.0)
        if rate < was or without_now[name] < without[name]:
            found[name] = min(found.get(name, 1.0), rate / was if was else 0.0)
    for one in after.contexts.values():
        if one.left_out > 0:
            share = 1.0 - one.left_out / max(one.ticks, one.left_out)
            for name in one.members:
                found[name] = min(found.get(name, 1.0), share)
    for port in _starved(before, after):
        found[_component(port)] = 0.0
    if found:
        _pass_on(found, after)
    return found


def _rates(window: Window) -> tuple[dict[str, float], Counter[str]]:
    """The sum of the rates of a component's contexts, and the number of its contexts without a rate, by component."""
    rates: dict[str, float] = {}
    without: Counter[str] = Counter()
    for one in window.contexts.values():
        if one.rate is None:
            without.update(one.members)
        else:
            rates.update({name: rates.get(name, 0.0) + one.rate for name in one.members})
    return rates, without


def _starved(before: Window, after: Window) -> list[str]:
    """In-ports that have fewer connectors than before."""
    lost = [one.target for name, one in before.edges.items() if after.edges.get(name, _NO_SAMPLES).target != one.target]
    if not lost:
        return lost
    ports = Counter(one.target for one in before.edges.values())
    ports.subtract(one.target for one in after.edges.values())
    return [port for port in lost if ports[port] > 0]


def _pass_on(expected: dict[str, float], window: Window) -> None:
    """Lower the expectation of each component to the lowest expectation of the components that it reads."""
    readers: dict[str, set[str]] = {}
    for edge in window.edges.values():
        readers.setdefault(_component(edge.source), set()).add(_component(edge.target))
    todo = list(expected)
    while todo:
        writer = todo.pop()
        for reader in readers.get(writer, ()):
            if expected[writer] < expected.get(reader, 1.0):
                expected[reader] = expected[writer]
                todo.append(reader)


def _component(path: str) -> str:
    return path.partition(".")[0]
