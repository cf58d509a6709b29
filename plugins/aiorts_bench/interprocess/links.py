"""`aiorts bench links`: the table of its cases."""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
from typing import Final, TypeVar

from aiorts_bench.harness.bench import Bench, Options
from aiorts_bench.harness.case import COST, LATENCY, RATE, Aim, Case, Measure, Sense, tails
from aiorts_bench.harness.report import Report, Row
from aiorts_bench.interprocess.near import Ends

CORE: Final = Measure("core", "%", digits=2)
"""Share of one core that a process used."""
TAIL: Final = tails("latency", 99.0)
ECHO: Final = "socket pair, echo"
_WORKING: Final = "socket pair, both work"
_ECHO_LARGE: Final = "socket pair, 1 MiB"
_ZENOH: Final = "Zenoh, there and back"
ZENOH_LARGE: Final = "Zenoh, 1 MiB"
_ZENOH_MANY: Final = "Zenoh, stream"
_PER_SECOND: Final = 100_000.0
AnyEnds = TypeVar("AnyEnds", bound=Ends)


def cases(ends: Ends) -> tuple[Case, ...]:
    """The cases, baselines first; without Zenoh where `ends` has none."""
    flush: tuple[Aim, ...] = (Aim(ECHO, factor=2.5), Aim(_WORKING))
    small = flush
    large: tuple[Aim, ...] = (Aim(_ECHO_LARGE),)
    many: tuple[Aim, ...] = (Aim("", Sense.AT_LEAST, _PER_SECOND, measure=RATE),)
    found = [
        Case(ECHO, "24 bytes there and back, nothing else", LATENCY, ends.bare, 300, columns=TAIL),
        Case(_WORKING, "the same, and each end works 40 us", LATENCY, ends.bare_working, 300, columns=TAIL),
        Case(_ECHO_LARGE, "1 MiB there and back, nothing else", LATENCY, ends.bare_large, 10, columns=TAIL),
    ]
    if ends.peers:
        small += (Aim(_ZENOH, factor=0.6),)
        large += (Aim(ZENOH_LARGE, factor=0.85),)
        many += (Aim(_ZENOH_MANY, measure=COST),)
        how = "puts with the same codec, handed to the loop"
        found += [
            Case(_ZENOH, how, LATENCY, ends.zenoh, 300, columns=TAIL, peer=True),
            Case(ZENOH_LARGE, how, LATENCY, ends.zenoh_large, 10, columns=TAIL, peer=True),
            Case(_ZENOH_MANY, f"{how}; lost ones are not waited for", COST, ends.zenoh_many, 5_000, columns=(RATE,)),
        ]
    return (
        *found,
        Case("link, there and back", "a small sample over two links", LATENCY, ends.link, 300, small, columns=TAIL),
        Case("link, flush", "until it is acknowledged", LATENCY, ends.link_flush, 300, flush, True, TAIL),
        Case("link, 1 MiB", "there and back over two links", LATENCY, ends.link_large, 10, large, columns=TAIL),
        Case("link, stream", "small samples, full=block", COST, ends.link_many, 5_000, many, True, (RATE,)),
        Case("links, idle", "seven links, nothing written", CORE, ends.idle, 10, (Aim("", factor=0.1),), warm=False),
    )


def report_of(
    options: Options, bench: str, kind: type[AnyEnds], cases: Callable[[AnyEnds], tuple[Case, ...]], how: str
) -> Report:
    """Measure the cases of ends of this kind on each loop, with Zenoh where it is installed."""
    zenoh = options.peers and find_spec("zenoh") is not None
    rows: tuple[Row, ...] = ()
    for loop in options.loops:
        ends = kind(loop, peers=zenoh)
        rows += options.rows(cases(ends), beside=ends.open, loop=loop)
    notes = () if zenoh or not options.peers else ("left out: Zenoh is not installed: pip install aiorts[bench]",)
    return options.report(bench, rows, notes=notes, how=how)


def report(options: Options) -> Report:
    """Measure on each loop."""
    how = (
        "Two processes on one host. A link confirms each sample and counts what became of it; Zenoh and the "
        "socket pair do not. Zenoh runs over TCP on 127.0.0.1. The idle row is the process that has nothing but links."
    )
    return report_of(options, "links", Ends, cases, how)


BENCH: Final = Bench(
    "links",
    "Connectors into another process, beside a bare socket pair and bare Zenoh.",
    report,
)
