"""What another kernel may say to hold this one up: it is refused in a time that the loop has."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Protocol

import pytest

from aiorts import Component, Kernel, Provided, Required
from aiorts.errors import InterfaceMismatch, LinkError
from aiorts.links import Caller, LinkOffer, Peer, ends, serving
from aiorts.links.call_values import frame_of, interface_text, restored
from aiorts.links.layout import difference, layout_of
from aiorts.links.messages import Answer, LinkRequest, fields
from aiorts.model.interface import read_interface
from aiorts.model.links import ReaderEnd, WriterEnd, versions
from aiorts.model.links.frames import BATCH, BATCH_BYTES, acknowledgement, data, hello
from aiorts.model.names import Path
from aiorts.model.profile import ConnectorProfile
from aiorts.testing import MemoryNetwork, simulate
from aiorts.types import TimedLong, TimedString
from links.memory_kernels import Face, Sink, Source, kernel_of

LARGEST = 1_048_576
"""Bytes of a message at the most."""


def held_up(read: Callable[[], object]) -> float:
    """Seconds of the processor that it takes at the least."""

    def once() -> float:
        began = time.thread_time()
        with suppress(LinkError):
            read()
        return time.thread_time() - began

    return min(once() for _ in range(3))


@pytest.mark.fault("E13")
@pytest.mark.parametrize(
    "bomb",
    [
        (b"\xdd\x00\x0f\x42\x40" * 500).ljust(LARGEST, b"\xc0"),
        (b"\xdc\xff\xff" * 300).ljust(LARGEST, b"\x90"),
        b"\xdd\x00\x0f\xff\x00" + b"\x90" * 0xFFF00,
        b"\x91" * LARGEST,
    ],
    ids=["claims", "claims with lists", "lists", "deep"],
)
def test_a_message_that_is_a_bomb_takes_10_ms_of_the_processor(bomb: bytes) -> None:
    assert held_up(lambda: fields(bomb, (list,), longer=True)) < 0.010
    with pytest.raises(LinkError, match="no message of this protocol"):
        fields(bomb, (list,), longer=True)


@pytest.mark.slow
def test_an_acknowledgement_says_what_became_of_no_more_samples_than_may_be_on_their_way() -> None:
    end = WriterEnd(7, 1_000, window=256)
    end.channel_up(0, 2_000)
    end.receive(0, hello(7, 2_000, 0))
    for _ in range(256):
        end.offer(0, b"x")
    end.poll(0, lambda _head, _parts: True)
    frame = acknowledgement(7, 256, 256, dict.fromkeys(range(1, 65536), "x" * 255))
    assert held_up(lambda: end.receive(0, frame)) < 0.010
    assert (end.ledger.bad_frames, end.ledger.in_flight) == (3, 256)
    end.receive(0, acknowledgement(7, 256, 256, dict.fromkeys(range(1, 257), "rejected")))
    assert (end.ledger.bad_frames, end.ledger.dropped) == (3, 256)


def test_reasons_that_no_reader_has_count_as_one() -> None:
    end = WriterEnd(7, 1_000, window=256)
    end.channel_up(0, 2_000)
    end.receive(0, hello(7, 2_000, 0))
    for _ in range(5):
        end.offer(0, b"x")
    end.poll(0, lambda _head, _parts: True)
    reasons = {1: "mine", 2: "acknowledged", 3: "rejected", 4: "undecodable", 5: "unknown_fate"}
    end.receive(0, acknowledgement(7, 5, 5, reasons))
    assert end.fates() == [(1, 2, "refused"), (3, 3, "rejected"), (4, 4, "undecodable"), (5, 5, "refused")]


async def _asked(kernel: Kernel, network: MemoryNetwork, name: str, what: str, bodies: list[bytes]) -> list[Answer]:
    """What a kernel answers to such questions of another one, which then ends."""
    transport = network.transport(name)
    await transport.open(Face(name))
    transport.answer("offer", _never)
    found: list[Peer] = []
    transport.presence(lambda peer, up: found.append(peer))
    while not found:
        await asyncio.sleep(0.01)
    answers = [Answer.from_bytes(await transport.ask(found[0], what, body, within=2.0)) for body in bodies]
    await asyncio.sleep(0.1)
    await transport.close()
    await asyncio.sleep(0.1)
    return answers


async def _never(_body: bytes, _caller: Caller) -> bytes:
    return Answer(absent="not yet", protocol=versions.SPOKEN).to_bytes()


def _request(reader: str) -> bytes:
    return LinkRequest("two/source0.out", reader, {}, versions.SPOKEN).to_bytes()


def _offer(link: str, writer: str) -> bytes:
    schema, text = layout_of(TimedLong)
    profile = ConnectorProfile(name=link, ports=(writer, "two/sink0.inp"))
    ends = (Path.parse(writer), Path.parse("two/sink0.inp"), 7, 0, 0)
    return LinkOffer(versions.SPOKEN, link, *ends, schema, text, None, None, profile, 256, 8 << 20).to_bytes()


@pytest.mark.fault("E13")
@pytest.mark.parametrize("what", ["request", "offer"])
def test_another_kernel_makes_a_bounded_number_of_connectors_and_of_its_own_ports_alone(
    what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ends, "_BY_ONE", 3)
    monkeypatch.setattr(ends, "_BY_ALL", 5)

    def bodies(kernel: str, count: int) -> list[bytes]:
        if what == "request":
            return [_request(f"{kernel}/sink{number}.inp") for number in range(count)]
        return [_offer(f"link{number}", f"{kernel}/source{number}.out") for number in range(count)]

    async def run() -> None:
        network = MemoryNetwork()
        async with kernel_of(network, "two") as two:
            await two.add(Source())
            await two.add(Sink())
            answers = await _asked(two, network, "one", what, bodies("one", 5))
            assert [bool(answer.refused) for answer in answers] == [False, False, False, True, True]
            assert "other kernels have made 3 connectors; no more are made" in answers[4].refused
            (answer,) = await _asked(two, network, "three", what, bodies("one", 1))
            assert "is no port of three, which asks" in answer.refused
            if what == "request":
                assert not two.connectors  # it was never answered what was to be offered
                assert not (await _asked(two, network, "one", what, bodies("one", 1)))[0].refused

    simulate(run())


@pytest.mark.fault("E13")
def test_little_is_kept_of_what_another_kernel_says_of_a_connector() -> None:
    async def run() -> None:
        network = MemoryNetwork()
        async with kernel_of(network, "two") as two:
            await two.add(Source())
            await two.add(Sink())
            for options in ({"name": "x" * 100_000}, {"dataport.x": "x" * 100_000}):
                body = LinkRequest("two/source0.out", "one/sink.inp", options, versions.SPOKEN).to_bytes()
                (answer,) = await _asked(two, network, "one", "request", [body])
                assert "a request of 100," in answer.refused
                assert "at most 16,384 are allowed" in answer.refused
            (answer,) = await _asked(two, network, "one", "offer", [_offer("x" * 100_000, "one/source.out")])
            assert "an offer without its type of 200," in answer.refused
            assert not two.connectors

    simulate(run())


class Meter(Protocol):
    async def read(self) -> float: ...


class Device(Component):
    meter = Provided[Meter]()

    async def read(self) -> float:
        return 1.0


class Client(Component):
    meter = Required[Meter]()


@pytest.mark.fault("E13")
def test_a_kernel_that_binds_too_many_interfaces_leaves_room_for_others(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serving, "_BY_ONE", 3)
    monkeypatch.setattr(serving, "_BY_ALL", 5)
    wanted = interface_text(read_interface(Meter))
    bodies = [frame_of([f"one/client{number}.meter", "meter", "two/device0.meter", wanted]) for number in range(5)]

    async def run() -> None:
        network = MemoryNetwork()
        async with kernel_of(network, "two") as two, kernel_of(network, "three") as three:
            await two.add(Device())
            greedy = network.transport("one")
            await greedy.open(Face("one"))
            await asyncio.sleep(0.1)
            found: list[Peer] = []
            greedy.presence(lambda peer, up: found.append(peer))
            (to,) = [peer for peer in found if peer.kernel == "two"]
            answers = [Answer.from_bytes(await greedy.ask(to, "bind", body, within=2.0)) for body in bodies]
            assert [bool(answer.refused) for answer in answers] == [False, False, False, True, True]
            assert "other kernels have bound 3 interfaces; no more are bound" in answers[4].refused
            client = await three.add(Client())
            await three.connect(client.meter, "two/device0.meter")
            assert await client.meter.proxy.read() == 1.0
            await greedy.ask(to, "unbind", frame_of([answers[0].number]), within=2.0)
            assert not Answer.from_bytes(await greedy.ask(to, "bind", bodies[4], within=2.0)).refused
            await greedy.close()

    simulate(run())


def test_samples_of_one_frame_are_together_as_large_as_a_writer_sends_them() -> None:
    end = ReaderEnd(7, 2_000)
    end.channel_up(0, 1_000)
    end.receive(0, data(7, 1, 1, [bytes(10_000)] * BATCH, confirm=False))
    assert (end.ledger.bad_frames, end.held) == (1, 0)
    end.receive(0, data(7, 1, 1, [bytes(BATCH_BYTES // 2)] * 2, confirm=False))
    end.receive(0, data(7, 3, 1, [bytes(1_000_000)], confirm=False))
    assert (end.ledger.bad_frames, end.held) == (1, 3)


def test_the_text_of_a_type_that_is_a_bomb_takes_20_ms_of_the_processor() -> None:
    ours = layout_of(TimedString)[1]
    for count in (20_000, 340_000):
        bomb = '{"prefixItems":[' + "[]," * count + '[]],"title":"TimedString"}'
        assert held_up(lambda bomb=bomb: difference(bomb, ours)) < 0.020  # type: ignore[misc]
        assert difference(bomb, ours)


@pytest.mark.parametrize("hint", [set[int], frozenset[int]])
def test_a_set_of_what_cannot_be_in_one_is_no_such_value(hint: object) -> None:
    with pytest.raises(InterfaceMismatch, match=r"no .*set.*unhashable"):
        restored(hint, [[1]])
