"""The ledger of a link from end to end: one equation, asked for at either end at any moment."""

from __future__ import annotations

import asyncio
from contextlib import AsyncExitStack, suppress
from random import Random
from typing import Any

import msgpack
import pytest
from anyio import WouldBlock

from aiorts import EventContext, Kernel, LifecycleState
from aiorts.errors import LinkError, WriteTimeout
from aiorts.links import LinkLedger, Links
from aiorts.links.messages import packed
from aiorts.links.transport import Peer
from aiorts.testing import MemoryNetwork, simulate
from campaign import cases
from links.memory_kernels import Sink, Source, kernel_of, long, until

OPTIONS: list[dict[str, Any]] = [
    {"full": "overwrite", "length": 4},
    {"full": "reject", "length": 4},
    {"subscription": "flush", "full": "reject", "length": 3, "timeout": 0.05},
    {"subscription": "flush", "full": "overwrite", "length": 3},
    {"subscription": "new", "push": "new"},
    {"subscription": "periodic", "push_rate": 50.0, "push": "all", "out_length": 9},
    {"dataflow": "pull"},
    {"dataflow": "pull", "keep_last": True, "lifespan": 0.2},
    {"keep_last": True, "full": "overwrite"},
    {"keep_last": True, "lifespan": 0.2, "full": "overwrite"},
    {"keep_last": True, "subscription": "flush", "full": "overwrite"},
]


async def ask(kernel: Kernel) -> LinkLedger:
    (connector,) = kernel.connectors.values()
    return await kernel.service(Links).ledger(connector)


async def play(seed: int) -> list[LinkLedger]:
    """Writes, reads, cuts, restarts, and looks at the ledger from either end at random moments."""
    random = Random(seed)
    network = MemoryNetwork(
        seed=seed, loss=random.choice((0, 0.2)), duplicate=0.1, reorder=0.1, delay=random.choice((0.0, 0.003))
    )
    found: list[LinkLedger] = []
    async with kernel_of(network, "one") as one, AsyncExitStack() as stack:
        source = await one.add(Source())

        async def start() -> tuple[Kernel, Sink, Any]:
            two = await stack.enter_async_context(kernel_of(network, "two"))
            sink = await two.add(Sink())
            return two, sink, await two.start(EventContext(), sink, activate=random.random() < 0.7)

        two, sink, context = await start()
        options = random.choice(OPTIONS)
        connector = await one.connect(source.out, "two/sink0.inp", **options)
        for value in range(random.randrange(20, 80)):
            for _ in range(random.choice((1, 1, 4))):
                with suppress(WouldBlock):
                    source.out.write_nowait(long(value))
            act = random.randrange(14)
            if act < 4:
                sink.inp.drain()
            elif act == 4 and "flush" in options.values():
                with suppress(WriteTimeout, TimeoutError):
                    await asyncio.wait_for(source.out.write(long(value)), 0.01)
            elif act == 5:
                network.cut("one", "two")
                await asyncio.sleep(random.choice((0.0, 0.5)))
                network.restore("one", "two")
            elif act == 6:
                await stack.aclose()
                two, sink, context = await start()
            elif act == 7:
                is_active = sink.states[context.name] is LifecycleState.ACTIVE
                await (context.deactivate(sink) if is_active else context.activate(sink))
            elif act < 11:
                with suppress(LinkError):
                    found.append(await ask(random.choice((one, two)) if two.connectors else one))
            await asyncio.sleep(random.choice((0.0, 0.001, 0.02, 0.1)))
        network.loss = 0.0
        await until(lambda: (sink.inp.drain(), two.connectors and connector.statistics.buffered == 0)[1], 60)
        for _ in range(400):
            sink.inp.drain()
            await asyncio.sleep(0.05)
            if not connector.statistics.in_flight:
                break
        found += [await ask(one), await ask(two)]
        assert found[-1] == found[-2]
        assert found[-1].in_flight == 0
        assert connector.statistics.balanced
    return found


@pytest.mark.slow(kept_by="test_the_ledger_of_a_link_is_the_same_from_either_end")
def test_at_any_moment_every_sample_is_accounted_for_once() -> None:
    for seed in range(cases(1_000)):
        for ledger in simulate(play(seed), seed=seed):
            assert ledger.unexplained == 0, (seed, str(ledger))
            assert min(ledger.written, ledger.delivered, ledger.buffered, ledger.in_flight) >= 0, (seed, str(ledger))
            assert all(count > 0 for count in ledger.dropped.values()), (seed, str(ledger))


def test_the_ledger_of_a_link_is_the_same_from_either_end() -> None:
    async def run() -> None:
        network = MemoryNetwork(delay=0.001)
        async with kernel_of(network, "two") as two, kernel_of(network, "one") as one:
            source, sink = await one.add(Source()), await two.add(Sink())
            await one.connect(source.out, "two/sink0.inp", length=8)
            for value in range(20):
                source.out.write_nowait(long(value))
            await until(lambda: sink.inp.is_new)
            assert [sink.inp.read_nowait().data for _ in range(5)] == list(range(5))
            network.stop("two")
            source.out.write_nowait(long(20))
            network.go("two")
            ledger = await ask(one)
            assert (ledger.written, ledger.delivered, ledger.buffered + ledger.in_flight) == (21, 5, 16)
            assert (dict(ledger.dropped), ledger.unexplained) == ({}, 0)
            await asyncio.sleep(1)  # nobody reads: what waits for room takes the place of the oldest
            assert (await ask(one)) == (await ask(two)) == LinkLedger(21, 5, {"overwritten": 8}, 8, 0, 0)

    simulate(run())


def test_what_the_readers_end_has_lost_is_logged_once(caplog: pytest.LogCaptureFixture) -> None:
    async def run() -> None:
        network = MemoryNetwork(delay=0.001)
        async with kernel_of(network, "two") as two, kernel_of(network, "one") as one:
            source, sink = await one.add(Source()), await two.add(Sink())
            connector = await one.connect(source.out, "two/sink0.inp")
            for value in range(connector.profile.length + 1):
                source.out.write_nowait(long(value))
            await until(lambda: connector.statistics.dropped.get("overwritten") == 1)
            for value in range(100):  # it is read in time from now on
                sink.inp.drain()
                await asyncio.sleep(1)
                source.out.write_nowait(long(value))
            assert dict(connector.statistics.dropped) == {"overwritten": 1}

    simulate(run())
    (said,) = (line for line in caplog.messages if line.startswith("source0.out -> two/sink0.inp: "))
    assert "1 sample lost so far: overwritten" in said


def test_a_link_that_the_readers_kernel_connected_has_its_ledger_too() -> None:
    async def run() -> None:
        network = MemoryNetwork(delay=0.001)
        async with kernel_of(network, "two") as two, kernel_of(network, "one") as one:
            source, sink = await one.add(Source()), await two.add(Sink())
            connector = await two.connect("one/source0.out", sink.inp)
            await until(lambda: source.out.connectors)
            for value in range(5):
                source.out.write_nowait(long(value))
            await until(lambda: sink.inp.is_new)
            assert sink.inp.read_nowait() == long(0)
            await asyncio.sleep(1)
            statistics = connector.statistics
            assert (statistics.written, statistics.delivered, statistics.balanced) == (5, 1, True)
            assert (await ask(one)) == (await ask(two)) == LinkLedger(5, 1, {}, 4, 0, 0)

    simulate(run())


def test_the_equation_is_printed() -> None:
    ledger = LinkLedger(20, 10, {"expired": 2, "unknown_fate": 1}, 3, 1, 3)
    assert ledger.unexplained == 0
    assert str(ledger) == (
        "20 written = 10 delivered + 3 dropped (expired 2, unknown_fate 1) + 3 buffered + 1 in flight"
        " + 3 acknowledged before"
    )
    assert str(LinkLedger(1, 0, {}, 0, 1, 0)) == "1 written = 0 delivered + 0 dropped + 0 buffered + 1 in flight"


def test_a_ledger_that_cannot_be_had_says_why() -> None:
    async def run() -> None:
        network = MemoryNetwork()
        async with kernel_of(network, "one") as one:
            source, sink = await one.add(Source()), await one.add(Sink())
            links = one.service(Links)
            far = await one.connect(source.out, "two/sink0.inp")
            with pytest.raises(LinkError, match=r"ledger: there is no kernel 'two'"):
                await links.ledger(far)
            with pytest.raises(LinkError, match=r"both ports are in this kernel"):
                await links.ledger(await one.connect(source.out, sink.inp))
            async with kernel_of(network, "two") as two:
                for what, body in (("ledger", packed(["x"])), ("joined", packed(["x"])), ("joined", b"\xc1")):
                    with pytest.raises(LinkError, match=r"has no link 'x'|no message"):
                        await links.ask(links.peers[0], what, body, 1.0)
                assert two.connectors == {}

    simulate(run())


def test_the_readers_end_is_measured_while_the_writers_end_is_or_its_own_kernel_has_it_so() -> None:
    async def run() -> None:
        network = MemoryNetwork(delay=0.001)
        async with kernel_of(network, "two") as two, kernel_of(network, "one") as one:
            source, sink = await one.add(Source()), await two.add(Sink())
            there = await one.connect(source.out, "two/sink0.inp", measure=5_000)
            (here,) = two.connectors.values()

            async def counts() -> list[int]:
                """Of the samples that either end says were measured as they were read, after one more."""
                source.out.write_nowait(long(1))
                await until(lambda: sink.inp.is_new)
                sink.inp.read_nowait()
                return [(found.read or {}).get("waited", [0])[0] for found in (await ask(one), await ask(two))]

            assert here.profile.measure == 1_000  # of another kernel's
            assert [await counts() for _ in range(2)] == [[1, 1], [2, 2]]
            one.connections.measure(there, 0)
            await until(lambda: here.profile.measure == 0)
            assert await counts() == [0, 0]
            one.connections.measure(there, 10)
            await until(lambda: here.profile.measure == 10)
            assert await counts() == [1, 1]
            one.connections.measure(there, 0)
            await until(lambda: here.profile.measure == 0)
            two.connections.measure(here, 7)
            one.connections.measure(there, 10)
            assert await counts() == [1, 1]
            one.connections.measure(there, 0)
            assert (await counts(), here.profile.measure) == ([2, 2], 7)

    simulate(run())


def test_a_kernel_of_an_older_release_says_nothing_of_how_old_samples_were() -> None:
    async def run() -> None:
        network = MemoryNetwork(delay=0.001)
        transport = network.transport("one")
        carry = transport.ask

        async def ask_older(peer: Peer, what: str, body: bytes, *, within: float) -> bytes:
            answer = await carry(peer, what, body, within=within)
            return packed(msgpack.unpackb(answer)[:7]) if what == "ledger" else answer

        async with kernel_of(network, "two") as two, Kernel("one") as one:
            transport.ask = ask_older  # type: ignore[method-assign]
            one.service(Links).use(transport)
            await one.service(Links).opened()
            source, sink = await one.add(Source()), await two.add(Sink())
            await one.connect(source.out, "two/sink0.inp", measure=10)
            source.out.write_nowait(long(1))
            await until(lambda: sink.inp.is_new)
            assert ((await ask(one)).read, (await ask(one)).written) == (None, 1)

    simulate(run())
