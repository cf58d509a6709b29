"""`aiorts bench isolation`: the table of its cases."""

from __future__ import annotations

from typing import Final

from aiorts_bench.harness.bench import Bench, Options
from aiorts_bench.harness.case import LATENCY, RATE, Aim, Case, Measure
from aiorts_bench.harness.report import Report
from aiorts_bench.interprocess.isolated import IsolatedEnds
from aiorts_bench.interprocess.links import ECHO, TAIL, ZENOH_LARGE, report_of

TIME: Final = Measure("time", "ms", digits=1)
"""Time from asking for the work until all of it is done."""
CPU_EACH: Final = Measure("cpu each", "us", digits=0)
"""Processor time of both processes for each array."""
_WORK: Final = "bare processes, work"
_ZENOH_ARRAYS: Final = "Zenoh, arrays"


def cases(ends: IsolatedEnds) -> tuple[Case, ...]:
    """The cases, baselines first; without Zenoh where `ends` has none."""
    hop, work = (Aim(ECHO, factor=2.0),), (Aim(_WORK, factor=1.15),)
    large: tuple[Aim, ...] = ()
    arrays: tuple[Aim, ...] = ()
    found = [
        Case(ECHO, "24 bytes there and back, nothing else", LATENCY, ends.bare, 300, columns=TAIL),
        Case(_WORK, "two processes of Python code alone", TIME, ends.bare_work, 50),
    ]
    if ends.peers:
        large, arrays = (Aim(ZENOH_LARGE, factor=0.5),), (Aim(_ZENOH_ARRAYS, factor=0.2),)
        how = "puts with the same codec, handed to the loop"
        found += [
            Case(ZENOH_LARGE, how, LATENCY, ends.zenoh_large, 10, columns=TAIL, peer=True),
            Case(_ZENOH_ARRAYS, how, CPU_EACH, ends.zenoh_arrays, 100, columns=(RATE,), peer=True),
        ]
    return (
        *found,
        Case("isolated, hop", "a small sample in and out again", LATENCY, ends.hop, 300, hop, columns=TAIL),
        Case("isolated, work", "the same in two isolated components", TIME, ends.work, 50, work),
        Case("isolated, 1 MiB", "in and out again", LATENCY, ends.hop_large, 10, large, columns=TAIL),
        Case("isolated, arrays", "1 MiB in, 1,000/s at the most", CPU_EACH, ends.arrays, 100, arrays, True, (RATE,)),
    )


def report(options: Options) -> Report:
    """Measure on each loop."""
    how = (
        "Components in processes of their own. A hop is a sample in and a sample out, each over a link that "
        "confirms it and counts what became of it; Zenoh and the socket pair do not. Zenoh runs over TCP on 127.0.0.1. "
        "The processor time of arrays is that of both processes."
    )
    return report_of(options, "isolation", IsolatedEnds, cases, how)


BENCH: Final = Bench(
    "isolation",
    "Components in processes of their own, beside bare processes, a socket pair and bare Zenoh.",
    report,
)
