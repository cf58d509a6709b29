"""Holds figures of OpenRTM-aist-Python 2.1.0 and writes a sentence that compares each with a figure of aiorts.

The figures were measured once, in a run of their own: on 2026-11-21, Debian 12, Python 3.11.7, omniORBpy 4.2.5, a
guest with 2 virtual processors that was shared with other work; two rounds or three, all given. No ratio has them as
its baseline: they only give the order of magnitude.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final

from aiorts_bench.harness.case import LATENCY, RATE, Measure
from aiorts_bench.harness.printer import figure_text
from aiorts_bench.harness.report import Report

HEAD: Final = (
    "OpenRTM-aist-Python 2.1.0 (omniORBpy 4.2.5) was measured once, in another run on another day: Debian 12, Python "
    "3.11.7, 2 virtual processors shared with other work. All of its rounds are given; how many times is said against "
    "the best of them and with the slower of aiorts' event loops. No maximum and no deviation is compared: those were "
    "what the machine did."
)


@dataclass(frozen=True, slots=True)
class Peer:
    """A figure of OpenRTM-aist-Python ("theirs"), and the row of aiorts ("ours") that comes nearest.

    Attributes:
        title: what was measured.
        part: the part of RESULTS.md with our row.
        case: the name of our row.
        measure: the measure of our row; `figures` are in its unit.
        theirs: the name of their case.
        differs: the differences between the two sides.
    """

    title: str
    part: str
    case: str
    measure: Measure
    figures: tuple[float, ...]
    theirs: str
    differs: str

    @property
    def best(self) -> float:
        """The best of their figures."""
        return min(self.figures) if self.measure.better == "less" else max(self.figures)


_EXECUTED: Final = Measure("executed", "Hz", "more", digits=1)
_INTERVAL: Final = Measure("interval p99", "ms", digits=2)
_TIME: Final = Measure("time", "ms", digits=0)
_DIRECT: Final = (
    "their `direct` overwrites one slot in the call of the writer, without buffer, ledger or type check; ours is the "
    "writer and a reader that takes every message"
)
_CORBA: Final = (
    "theirs goes through CORBA marshalling, which is what this policy of theirs needs; ours hands the record on"
)
_WAKE: Final = (
    "their `direct` is one call in the thread of the writer; ours wakes a task of another context on the loop"
)
_RELATIVE: Final = "theirs sleeps for what is left of a period, so every wake-up's lateness adds up"

PEERS: Final = (
    Peer(
        "TimedLong in one process, flush",
        "push",
        "flush",
        RATE,
        (194_930, 191_963),
        "direct, flush, delivered",
        _DIRECT,
    ),
    Peer("The same through its default transport", "push", "flush", RATE, (17_655, 16_406), "corba_cdr, flush", _CORBA),
    Peer("Lossless to another task, new/all", "push", "new/all", RATE, (1250, 2827), "corba_cdr, new/all", _CORBA),
    Peer("periodic/all", "push", "periodic/all", RATE, (3727, 1231), "corba_cdr, periodic/all at 1000 Hz", _CORBA),
    Peer("1 MB in one process, flush", "push", "flush, 1 MB", RATE, (186_921, 191_593), "direct, flush", _DIRECT),
    Peer(
        "One way, paced at 200 Hz, median", "push", "flush, idle to run", LATENCY, (7, 10), "direct, flush, p50", _WAKE
    ),
    Peer(
        "The same through its default transport",
        "push",
        "flush, idle to run",
        LATENCY,
        (45, 61),
        "corba_cdr, flush, p50",
        "theirs marshals and calls a listener; ours wakes a task of another context on the loop",
    ),
    Peer(
        "Context of 2 ms, one component, executed",
        "context",
        "periodic, 1",
        _EXECUTED,
        (465.9, 468.9, 467.3),
        "mean period 2.146, 2.133 and 2.140 ms",
        _RELATIVE,
    ),
    Peer(
        "Context of 2 ms, one component, 99 % of the intervals within",
        "context",
        "periodic, 1",
        _INTERVAL,
        (2.870, 2.754, 2.408),
        "PeriodicExecutionContext",
        _RELATIVE,
    ),
    Peer(
        "Context of 2 ms, four components, executed",
        "context --paper",
        "periodic",
        _EXECUTED,
        (460.2, 465.4, 463.0),
        "mean period 2.173, 2.149 and 2.160 ms, PeriodicECSharedComposite",
        "theirs are empty, ours compute the paper's manipulator",
    ),
    Peer(
        "Context of 2 ms, four components, 99 % of the intervals within",
        "context --paper",
        "periodic",
        _INTERVAL,
        (3.215, 2.463, 2.729),
        "PeriodicECSharedComposite",
        "theirs are empty, ours compute the paper's manipulator",
    ),
    Peer(
        "From the start of an interpreter to its end, with the middleware imported",
        "startup",
        "from aiorts import Kernel",
        _TIME,
        (121.0,),
        "import OpenRTM_aist",
        "ours is the kernel alone, and what else there is comes when it is used",
    ),
)


def times(ours: float, theirs: float, better: str) -> str:
    """How many times better or worse `ours` is, in words."""
    good, base = (theirs, ours) if better == "less" else (ours, theirs)
    if good <= 0 or base <= 0:
        return "not comparable"
    ratio = good / base
    if 0.95 < ratio < 1.05:
        return "the same within 5 %"
    return f"{_short(ratio)} times better" if ratio > 1 else f"{_short(1 / ratio)} times worse"


def _short(ratio: float) -> str:
    return f"{ratio:.0f}" if ratio >= 10 else f"{ratio:.1f}" if ratio >= 2 else f"{ratio:.2f}"


def sentences(part: str, report: Report, peers: Iterable[Peer] = PEERS) -> list[str]:
    """One sentence for each figure of OpenRTM-aist-Python that has a row in `report`."""
    found = []
    for peer in peers:
        if peer.part != part:
            continue
        ours = {
            row.loop: row.figures[peer.measure.name].displayed
            for row in report.rows
            if row.case.name == peer.case and peer.measure.name in row.figures
        }
        if ours:
            found.append(_sentence(peer, ours))
    return found


def _sentence(peer: Peer, ours: Mapping[str, float]) -> str:
    worst = max if peer.measure.better == "less" else min
    figures = ", ".join(
        f"{figure_text(value, peer.measure)}{'' if loop == 'none' else f' ({loop})'}" for loop, value in ours.items()
    )
    theirs = " and ".join(figure_text(value, peer.measure) for value in peer.figures)
    return (
        f"{peer.title}: aiorts {figures}; OpenRTM-aist-Python {theirs} ({peer.theirs}): "
        f"{times(worst(ours.values()), peer.best, peer.measure.better)}; measured in another run. "
        f"What differs: {peer.differs}."
    )
