"""`python -m aiorts_bench.cases.crowd N MESSAGES`: prints the cost of N components in a process as one JSON object.

Each component has two ports, one connector to the next one round a ring, and an event context of its own. Memory is
the growth of the resident set; with `--trace` that of tracemalloc, which slows everything else down. Modules and
other things that exist once are loaded before.
"""

from __future__ import annotations

import asyncio
import gc
import json
import os
import sys
import tracemalloc
from itertools import repeat
from pathlib import Path
from time import perf_counter_ns
from typing import Any

from aiorts import Component, EventContext, InPort, Kernel, OutPort, run
from aiorts.types import TimedDouble


class Node(Component):
    """One of N components; reads what arrives."""

    inp = InPort(TimedDouble)
    out = OutPort(TimedDouble)

    def on_execute(self) -> None:
        self.inp.drain()


class Bare:
    """An object as a user writes it without aiorts: a name, and two attributes in a dictionary."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.inp: Any = None
        self.out: Any = None


_FEW = 97
"""Components among which messages are written while all the others are idle."""


async def measure(count: int, messages: int, *, trace: bool = False) -> dict[str, float | list[str]]:
    """Create, connect, start, write through, and stop `count` components; return seconds, bytes and ns."""
    await _first_ones()
    gc.collect()
    gc.freeze()
    bare_before = _memory(trace)
    bare = [Bare(f"n{n}") for n in range(count)]
    bare_bytes = _memory(trace) - bare_before
    del bare
    gc.collect()
    before = _memory(trace)
    began = perf_counter_ns()
    kernel = await Kernel().open()
    nodes = [await kernel.add(Node(f"n{n}")) for n in range(count)]
    created = perf_counter_ns()
    connectors = [await kernel.connect(node.out, nodes[(n + 1) % count].inp, length=1) for n, node in enumerate(nodes)]
    connected = perf_counter_ns()
    for node in nodes:
        await kernel.start(EventContext(), node, activate=True)
    started = perf_counter_ns()
    gc.collect()
    memory = _memory(trace) - before - bare_bytes
    await _write(nodes, count)  # warm-up: the first message of a component allocates what later ones reuse
    few = await _write(nodes[:: max(1, count // _FEW)], messages)
    every = await _write(nodes, messages)
    faults = [f"{one.profile.name}: the ledger does not balance" for one in connectors if not one.statistics.balanced]
    delivered = sum(one.statistics.arrived for one in connectors)
    if delivered != count + 2 * messages:
        faults.append(f"{count + 2 * messages} written, {delivered} delivered")
    stopping = perf_counter_ns()
    await kernel.aclose()
    stopped = perf_counter_ns()
    return {
        "create": (created - began) / 1e9,
        "connect": (connected - created) / 1e9,
        "start": (started - connected) / 1e9,
        "stop": (stopped - stopping) / 1e9,
        "total": (started - began + stopped - stopping) / 1e9,
        "memory": memory / count,
        "message": few,
        "message, all": every,
        "faults": faults[:5],
    }


async def _first_ones() -> None:
    """Make a few of everything, so that modules and tables which exist once are loaded before memory is measured."""
    async with Kernel(name="first") as kernel:
        one, two = [await kernel.add(Node(f"first{n}")) for n in range(2)]
        await kernel.connect(one.out, two.inp, length=1)
        await kernel.start(EventContext(), two, activate=True)
        await _write([one], 1)


async def _write(nodes: list[Node], messages: int) -> float:
    """Nanoseconds of one write that wakes an idle event context, the run of its component included."""
    sample = TimedDouble(0, 1.0)
    size = len(nodes)
    step = 103 if size % 103 else 101  # coprime to the size: each is written to once a round, in another order
    number = 0
    began = perf_counter_ns()
    for _ in repeat(None, messages):
        number = (number + step) % size
        nodes[number].out.write_nowait(sample)
        await asyncio.sleep(0)
    for _ in range(3):
        await asyncio.sleep(0)
    return (perf_counter_ns() - began) / messages


def _memory(trace: bool) -> int:
    """Bytes in use; 0 where the system does not tell."""
    if trace:
        return tracemalloc.get_traced_memory()[0]
    try:
        return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, AttributeError):
        return 0


def main(arguments: list[str]) -> None:
    """Measure as the arguments say and print the result."""
    trace = "--trace" in arguments
    count, messages = (int(word) for word in arguments if not word.startswith("-"))
    if trace:
        tracemalloc.start()
    print(json.dumps(run(measure(count, messages, trace=trace))))


if __name__ == "__main__":
    main(sys.argv[1:])
