"""What a transport raises, what one peer asks for in vain, and ends that are disconnected before the first answer."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from aiorts.links import Links, arrivals, ends
from aiorts.links.messages import Answer, LinkRequest
from aiorts.model.links import versions
from aiorts.testing import MemoryNetwork, simulate
from links.memory_kernels import Face, Sink, Source, kernel_of, until


class Raising:
    """A transport one of whose methods raises once, which no transport is to do."""

    def __init__(self, transport: Any, what: str) -> None:
        self._transport, self._what = transport, what

    def __getattr__(self, name: str) -> Any:
        if name == self._what:
            self._what = ""
            return self._fail
        return getattr(self._transport, name)

    async def _fail(self, *_: object, **__: object) -> Any:
        raise RuntimeError("the engine is not itself")


@pytest.mark.parametrize("side", ["one", "two"])
@pytest.mark.parametrize("what", ["ask", "channel"])
def test_a_link_is_made_whatever_a_transport_raises(what: str, side: str) -> None:
    async def main() -> None:
        network = MemoryNetwork()
        async with kernel_of(network, "one") as one, kernel_of(network, "two") as two:
            source, sink = await one.add(Source("source")), await two.add(Sink("sink"))
            there = {"one": one, "two": two}[side].service(Links).reach
            for peer in there.peers:
                there.peers[peer] = Raising(there.peers[peer], what)
            connector = await (
                one.connect(source.out, "two/sink.inp")
                if side == "one" or what == "channel"
                else two.connect("one/source.out", sink.inp)
            )
            await until(lambda: set(one.service(Links).report().values()) == {"up"}, 10.0)
            assert set(two.service(Links).report().values()) == {"up"}
            assert not connector.closed

    simulate(main())


async def _ask(network: MemoryNetwork, name: str, writers: list[str]) -> list[Answer]:
    """What kernel "two" answers to these requests of another one, which then ends."""
    transport = network.transport(name)
    await transport.open(Face(name))
    found: list[Any] = []
    transport.presence(lambda peer, up: found.append(peer))
    while not found:
        await asyncio.sleep(0.01)
    bodies = [
        LinkRequest(f"two/{one}", f"{name}/sink.x{i}", {}, versions.SPOKEN).to_bytes() for i, one in enumerate(writers)
    ]
    answers = [Answer.from_bytes(await transport.ask(found[0], "request", body, within=2.0)) for body in bodies]
    await transport.close()
    await asyncio.sleep(0.1)
    return answers


def test_one_kernel_that_waits_for_many_components_takes_no_place_of_another(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(arrivals, "_AWAITED", 5)

    async def main() -> None:
        network = MemoryNetwork()
        async with kernel_of(network, "two") as two:
            answers = await _ask(network, "evil", [f"later{i}.out" for i in range(8)])
            assert [bool(one.refused) for one in answers] == [False] * 5 + [True] * 3
            (answer,) = await _ask(network, "good", ["later.out"])
            assert (answer.refused, "later" in answer.absent) == ("", True)
            kept = two.service(Links)._arrivals
            assert (kept._awaited, kept._waits) == ({}, {})  # both have gone

    simulate(main())


def test_other_kernels_connect_a_bounded_number_of_times_with_one_port(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ends, "_READERS", 3)

    async def main() -> None:
        network = MemoryNetwork()
        async with kernel_of(network, "two") as two:
            await two.add(Source("source"))
            await two.add(Source("other"))
            answers = await _ask(network, "evil", ["source.out"] * 5 + ["other.out"])
            assert [bool(one.refused) for one in answers] == [False] * 3 + [True] * 2 + [False]
            assert "source.out: other kernels have made 3 connectors with it" in answers[3].refused

    simulate(main())


def test_a_link_that_is_disconnected_before_its_first_answer_does_not_come_up() -> None:
    async def main() -> None:
        network = MemoryNetwork()
        async with kernel_of(network, "one") as one, kernel_of(network, "two") as two:
            source, sink = await one.add(Source("source")), await two.add(Sink("sink"))
            network.stop("one")
            connecting = asyncio.ensure_future(two.connect("one/source.out", sink.inp))
            await until(lambda: two.connectors)
            await asyncio.sleep(0.1)  # the request is on its way
            for connector in tuple(two.connectors.values()):
                await two.disconnect(connector)
            network.go("one")
            await asyncio.wait([connecting])
            await asyncio.sleep(5.0)
            assert (two.service(Links).report(), one.service(Links).report()) == ({}, {})
            assert (two.connectors, one.connectors) == ({}, {})
            await two.connect("one/source.out", sink.inp)  # connected again it is there
            await until(lambda: set(one.service(Links).report().values()) == {"up"}, 10.0)
            source.out.write_nowait(source.out.type(0, 7))
            assert (await sink.inp.read(5.0)).data == 7

    simulate(main())
