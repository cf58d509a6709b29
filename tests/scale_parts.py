"""What a system of thousands costs, bytes each and seconds for each step; `python tests/scale_parts.py` prints it.

Bytes each are those of Python's own allocator (`tracemalloc`, exact and the same in every run) between before the first
component is created and when all run, by n, less a bare object: an instance of a plain class with the same user
attributes. The first few of everything are made before, so that what exists once is not counted. Resident memory is
beside it, from a process of its own.
"""

from __future__ import annotations

import gc
import sys
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import aiorts
from aiorts import Component, Context, EventContext, ExternalContext, InPort, Kernel, OutPort, PeriodicContext
from aiorts.types import TimedDouble


class Node(Component):
    """One in-port, one out-port, one hook."""

    inp = InPort(TimedDouble)
    out = OutPort(TimedDouble)

    async def on_execute(self) -> None:
        if self.inp.is_new:
            self.inp.read_nowait()


class Source(Component):
    """One out-port."""

    out = OutPort(TimedDouble)


class Sink(Component):
    """One in-port."""

    inp = InPort(TimedDouble)


class Bare:
    """What a Node is without aiorts: the same attributes of the user."""

    def __init__(self) -> None:
        self.inp = None
        self.out = None


def resident() -> int:
    """Bytes of memory this process has in RAM."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096


def traced() -> int:
    """Bytes that Python's allocator has given out and not got back."""
    gc.collect()
    return tracemalloc.get_traced_memory()[0]


def bare_bytes(count: int) -> float:
    """What one bare object takes."""
    kept: list[Bare] = [Bare() for _ in range(10)]
    before = traced()
    kept += [Bare() for _ in range(count)]
    return (traced() - before) / count


async def ring(
    kernel: Kernel,
    count: int,
    names: str,
    marks: Callable[[str], None],
    context: Callable[[], Context] = EventContext,
) -> list[Node]:
    """So many components, connected in a ring, each active in a context of its own, each run once with a sample."""
    nodes = [await kernel.create(Node, f"{names}{number}" if names else "") for number in range(count)]
    marks("create")
    for one, two in zip(nodes, [*nodes[1:], nodes[0]], strict=True):
        await kernel.connect(one.out, two.inp)
    marks("connect")
    for node in nodes:
        await kernel.start(context(), node)
    marks("start")
    for node in nodes:
        await node.context.activate()
    marks("activate")
    sample = TimedDouble(0, 1.0)
    for node in nodes:
        node.out.write_nowait(sample)
    for node in nodes:
        if isinstance(node.context, ExternalContext):
            await node.context.tick()
        while node.inp.is_new:
            await kernel.sleep(0.001)
    marks("run once")
    return nodes


async def ring_bytes(count: int, context: Callable[[], Context] = EventContext) -> dict[str, float]:
    """Bytes for each component, step by step."""
    tracemalloc.start()
    try:
        bare = bare_bytes(count)
        async with Kernel() as kernel:
            kept: list[Any] = [await ring(kernel, 10, "warm", lambda _step: None, context)]
            taken = {"": traced()}
            kept.append(await ring(kernel, count, "node", lambda step: taken.update({step: traced()}), context))
        values = list(taken.items())
        parts = {step: (after - values[at][1]) / count for at, (step, after) in enumerate(values[1:])}
        return {**parts, "bare": bare, "total": sum(parts.values()) - bare}
    finally:
        tracemalloc.stop()


async def ring_seconds(count: int, *, named: bool = True) -> dict[str, float]:
    """Seconds for each step, the end of the kernel included; bytes of RAM each as "rss"."""
    gc.collect()
    before, steps = resident(), {"": time.perf_counter()}

    def mark(step: str) -> None:
        steps[step] = time.perf_counter()

    async with Kernel() as kernel:
        nodes = await ring(kernel, count, "node" if named else "", mark)
        rss = (resident() - before) / count
        del nodes
    mark("stop")
    values = list(steps.items())
    parts = {step: after - values[at][1] for at, (step, after) in enumerate(values[1:])}
    return {**parts, "total": values[-1][1] - values[0][1], "rss": rss}


class Ticker(Component):
    """Notes how late each tick is."""

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        self.late: list[int] = []

    async def on_execute(self) -> None:
        context = self.context
        assert isinstance(context, PeriodicContext)
        assert context.due_ns is not None
        self.late.append(self.clock.monotonic_ns() - context.due_ns)


async def periodic(count: int, rate: float, seconds: float) -> dict[str, float]:
    """Lateness (s), share of one core and resident bytes each of so many components in contexts of their own."""
    gc.collect()
    before = resident()
    async with Kernel() as kernel:
        tickers = [await kernel.create(Ticker) for _ in range(count)]
        for ticker in tickers:
            await kernel.start(PeriodicContext(rate), ticker, activate=True)
        rss = (resident() - before) / count
        for ticker in tickers:
            ticker.late.clear()
        wall, cpu = time.perf_counter(), time.process_time()
        await kernel.sleep(seconds)
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        late = sorted(ns for ticker in tickers for ns in ticker.late)
    return {
        "ticks": len(late) / count / seconds / rate,
        "p50": late[len(late) // 2] / 1e9,
        "p99": late[len(late) * 99 // 100] / 1e9,
        "max": late[-1] / 1e9,
        "core": cpu / wall,
        "rss": rss,
    }


async def fan_out(count: int) -> dict[str, float]:
    """One out-port and so many readers: seconds to connect, write once, disconnect; bytes of a connection."""
    async with Kernel() as kernel:
        source = await kernel.create(Source)
        sinks = [await kernel.create(Sink) for _ in range(count)]
        gc.collect()
        tracemalloc.start()
        before = traced()
        connectors = [await kernel.connect(source.out, sink.inp) for sink in sinks[: count // 10]]
        for connector in connectors:
            assert connector.statistics.written == 0
        size = (traced() - before) / len(connectors)
        tracemalloc.stop()
        rss, start = resident(), time.perf_counter()
        connectors += [await kernel.connect(source.out, sink.inp) for sink in sinks[count // 10 :]]
        connected = time.perf_counter()
        rss = resident() - rss
        source.out.write_nowait(TimedDouble(0, 1.0))
        written = time.perf_counter()
        assert all(sink.inp.read_nowait().data == 1.0 for sink in sinks)
        reading = time.perf_counter()
        for connector in connectors:
            await kernel.disconnect(connector)
        ended = time.perf_counter()
    return {
        "connect": connected - start,
        "write": written - connected,
        "disconnect": ended - reading,
        "bytes": size,
        "rss": rss / (count - count // 10),
    }


async def churn(rounds: int) -> dict[str, float]:
    """Create, start, activate, deactivate, remove, over and over; RAM that stayed and components that live on."""
    import weakref

    dead = 0
    rss = 0

    def count_dead(_reference: object) -> None:
        nonlocal dead
        dead += 1

    async with Kernel() as kernel:
        standing = await kernel.create(Sink, "standing")
        context = await kernel.start(EventContext())
        for number in range(rounds):
            if number == rounds // 10:
                gc.collect()
                rss = resident()
            node = await kernel.create(Node)
            await kernel.connect(node.out, standing.inp)
            await context.add(node)
            await context.activate(node)
            await context.deactivate(node)
            await kernel.remove(node)
            reference = weakref.ref(node, count_dead)
            _KEPT.append(reference)
            if len(_KEPT) > 1000:
                gc.collect()
                _KEPT[:] = [kept for kept in _KEPT if kept() is not None]
        del node, reference
        gc.collect()
        return {"rss": resident() - rss, "dead": dead, "alive": rounds - dead}


_KEPT: list[Any] = []


FIGURES: dict[str, Callable[[], Any]] = {
    "bytes": lambda: ring_bytes(2000),
    "seconds": lambda: ring_seconds(10_000),
    "unnamed": lambda: ring_seconds(10_000, named=False),
    "periodic": lambda: periodic(1000, 10.0, 20.0),
    "fan-out": lambda: fan_out(10_000),
    "churn": lambda: churn(10_000),
}


def main(names: list[str]) -> None:
    """Print the figures asked for, each a process of its own where resident memory counts."""
    for name in names or FIGURES:
        measured = aiorts.run(FIGURES[name])
        shown = "  ".join(f"{part} {value:.4g}" for part, value in measured.items())
        print(f"{name}: {shown}")


if __name__ == "__main__":
    main(sys.argv[1:])
