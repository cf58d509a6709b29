"""`aiorts bench network`: the table of its cases."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from importlib.util import find_spec
from typing import Final

import click

from aiorts.errors import MissingExtra
from aiorts_bench.harness.bench import Bench, Options
from aiorts_bench.harness.case import COST, LATENCY, RATE, Aim, Case, Sense, tails
from aiorts_bench.harness.report import Report, Row
from aiorts_bench.interprocess.networked import PLAIN, ROUTED, SECURED, BesideEnds, NetworkEnds

WAYS: Final = (PLAIN, SECURED, ROUTED)
"""The measured ways, each together with bare Zenoh over the same way; --quick measures only the first."""
_TAIL: Final = tails("latency", 99.0)
_P99: Final = _TAIL[0]
_FASTER: Final = Sense.AT_LEAST


def beside(ends: BesideEnds) -> tuple[Case, ...]:
    """The cases that carry bytes and nothing else; without ZeroMQ where `ends` has none."""
    bare, echoed = "24 bytes there and back, nothing else", "there and back, nothing else"
    found = [
        Case("TCP, echo", bare, LATENCY, ends.bare, 300, columns=_TAIL),
        Case("TCP, 1 MiB", echoed, LATENCY, ends.bare_large, 10, columns=_TAIL),
    ]
    if ends.peers:
        found += [
            Case("ZeroMQ, echo", bare, LATENCY, ends.zmq, 300, columns=_TAIL, peer=True),
            Case("ZeroMQ, 1 MiB", echoed, LATENCY, ends.zmq_large, 10, columns=_TAIL, peer=True),
            Case("ZeroMQ, stream", "24 bytes each", COST, ends.zmq_many, 5_000, columns=(RATE,), peer=True),
        ]
    return tuple(found)


def cases(ends: NetworkEnds) -> tuple[Case, ...]:
    """The cases of one way, baselines first."""
    name = ends.way.name
    echo, large, flood = f"{name}Zenoh, there and back", f"{name}Zenoh, 1 MiB", f"{name}Zenoh, callbacks"
    express, batched = f"{name}Zenoh, stream", f"{name}Zenoh, batches"
    how = "express puts with the same codec and hand-over"
    quick = (Aim(echo, factor=1.2), Aim(echo, factor=1.5, measure=_P99))
    many = (Aim(express, _FASTER, 1.0), Aim(batched, _FASTER, 0.8))
    handed = (Aim(flood, _FASTER, 1.0),)
    floods = (
        Case(flood, "24 bytes each, counted in the callback", COST, ends.flood, 10_000, columns=(RATE,), peer=True),
        Case(f"{name}hand-over", "counted on the loop", COST, ends.flood_handed, 10_000, handed, columns=(RATE,)),
    )
    return (
        Case(echo, how, LATENCY, ends.zenoh, 300, columns=_TAIL, peer=True),
        Case(large, how, LATENCY, ends.zenoh_large, 10, columns=_TAIL, peer=True),
        Case(express, how, COST, ends.zenoh_many, 5_000, columns=(RATE,), peer=True),
        Case(batched, "puts that Zenoh sends together", COST, ends.zenoh_batched, 5_000, columns=(RATE,), peer=True),
        *(floods if ends.way is PLAIN else ()),  # the hand-over is the same on every way
        Case(f"{name}link, there and back", "two links", LATENCY, ends.link, 300, quick, columns=_TAIL),
        Case(f"{name}link, flush", "until it is acknowledged", LATENCY, ends.link_flush, 300, (), True, _TAIL),
        Case(f"{name}link, 1 MiB", "two links", LATENCY, ends.link_large, 10, (Aim(large, factor=1.0),), columns=_TAIL),
        Case(f"{name}link, stream", "small samples, full=block", COST, ends.link_many, 5_000, many, True, (RATE,)),
    )


def report(options: Options) -> Report:
    """Measure on each loop.

    Raises:
        click.UsageError: Zenoh is not installed.
    """
    if find_spec("zenoh") is None:
        raise click.UsageError(str(MissingExtra("links to other hosts", "eclipse-zenoh", "zenoh")))
    zmq = options.peers and find_spec("zmq") is not None
    rows: tuple[Row, ...] = ()
    for loop in options.loops:
        bare, ways = BesideEnds(loop, zmq=zmq), [NetworkEnds(loop, way) for way in WAYS[: 1 if options.quick else None]]

        @asynccontextmanager
        async def opened(ends: tuple[BesideEnds | NetworkEnds, ...] = (bare, *ways)) -> AsyncIterator[None]:
            async with AsyncExitStack() as stack:
                for one in ends:
                    await stack.enter_async_context(one.open())
                yield

        table = (*beside(bare), *(case for way in ways for case in cases(way)))
        rows += options.rows(table, beside=opened, loop=loop)
    notes = () if zmq or not options.peers else ("left out: ZeroMQ is not installed: pip install aiorts[bench]",)
    return options.report(
        "network",
        rows,
        notes=notes,
        how="Two processes on one host, over TCP on 127.0.0.1; TLS with certificates at both ends; the router is a "
        "third process. A link confirms each sample and counts what became of it, and a component reads it; the others "
        "do neither. Bare Zenoh has the settings, the codec and the hand-over of a kernel.",
    )


BENCH: Final = Bench(
    "network",
    "Connectors into a kernel of another host, beside bare Zenoh, ZeroMQ and a bare connection.",
    report,
    rounds=11,
    full_scale=2.0,
)
