"""What kernels of other versions say, byte for byte, and what this one answers.

`versions.json` holds it for the version before, this one, the next, which adds fields at the end of everything, and the
next but one, which has another form but for the versions in front.
"""

from __future__ import annotations

import asyncio
import json
import logging
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import msgpack
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aiorts import Kernel
from aiorts.errors import LinkError, WiringError
from aiorts.links import Caller, LinkOffer, Links, Peer
from aiorts.links.messages import Answer, LinkRequest
from aiorts.model.links import LinkState, ReaderEnd, WriterEnd, versions
from aiorts.testing import MemoryNetwork, simulate
from links.memory_kernels import Face, Sink, Source, kernel_of

VERSIONS = json.loads((Path(__file__).parent / "versions.json").read_text())
each = pytest.mark.parametrize("peer", VERSIONS, ids=[str(one["speaks"]) for one in VERSIONS])


async def another(network: MemoryNetwork, name: str) -> Any:
    """The transport of a kernel of another version, of which the test says what it asks and answers."""
    transport = network.transport(name)
    await transport.open(Face(name))
    await asyncio.sleep(0.1)
    return transport


@contextmanager
def warnings(caplog: pytest.LogCaptureFixture) -> Iterator[list[str]]:
    found: list[str] = []
    with caplog.at_level(logging.WARNING):
        yield found
        found += [record.getMessage() for record in caplog.records]


@each
@pytest.mark.parametrize("question", ["offer", "request"])
def test_what_is_asked_by_each_version_is_answered_or_refused_with_both_versions(
    peer: dict[str, Any], question: str, caplog: pytest.LogCaptureFixture
) -> None:
    async def run() -> Answer:
        network = MemoryNetwork()
        async with kernel_of(network, "two") as two:
            await two.add(Source())
            await two.add(Sink())
            transport = await another(network, "one")
            transport.answer("offer", _later)
            met: list[Peer] = []
            transport.presence(lambda found, up: met.append(found))
            (to,) = met
            body = await transport.ask(to, question, bytes.fromhex(peer[question]), within=2.0)
            await transport.close()
            return Answer.from_bytes(body)

    with warnings(caplog) as said:
        answer = simulate(run())
    assert answer.protocol == versions.SPOKEN
    if peer["refused"]:
        assert answer.refused == f"versions of links differ: {peer['refused']}"
        assert any(f"refused a{'n' * (question == 'offer')} {question} of one: {answer.refused}" in one for one in said)
    else:
        assert (answer.refused, answer.absent) == ("", "")
        assert bool(answer.number) is (question == "offer")


async def _later(_body: bytes, _caller: Caller) -> bytes:
    return Answer(absent="not yet", protocol=versions.SPOKEN).to_bytes()


@each
def test_what_each_version_answers_is_understood(peer: dict[str, Any], caplog: pytest.LogCaptureFixture) -> None:
    async def run() -> tuple[str, list[LinkOffer]]:
        network, channels = MemoryNetwork(), []
        mine = network.transport("two")
        channel = mine.channel

        async def watched(offer: LinkOffer, events: Any) -> Any:
            channels.append(offer)
            return await channel(offer, events)

        async def answer(_body: bytes, _caller: Caller) -> bytes:
            return bytes.fromhex(peer["answer"])

        mine.channel = watched  # type: ignore[method-assign]
        async with Kernel("two") as two:
            two.service(Links).use(mine)
            await two.service(Links).opened()
            source = await two.add(Source())
            transport = await another(network, "one")
            transport.answer("offer", answer)
            said = ""
            try:
                await two.connect(source.out, "one/sink0.inp")
                assert len(two.connectors) == 1
            except WiringError as error:
                said = str(error)
                assert not two.connectors
            await transport.close()
            return said, channels

    said, channels = simulate(run())
    if peer["refused"]:
        assert said.endswith(peer["refused"])
        assert f"refused by one: versions of links differ: {peer['refused']}" in caplog.text
    else:
        assert [(one.protocol, one.number, one.reader_epoch) for one in channels] == [((1, 1), 77, 12)]


def test_an_option_that_this_version_does_not_have_is_refused_and_not_asked_again(
    caplog: pytest.LogCaptureFixture,
) -> None:
    offer = msgpack.unpackb(bytes.fromhex(VERSIONS[1]["offer"]))
    offer[4][1]["telepathy"] = "on"

    async def run() -> Answer:
        network = MemoryNetwork()
        async with kernel_of(network, "two") as two:
            await two.add(Sink())
            transport = await another(network, "one")
            met: list[Peer] = []
            transport.presence(lambda found, up: met.append(found))
            body = await transport.ask(met[0], "offer", msgpack.packb(offer), within=2.0)
            await transport.close()
            assert not two.connectors
            return Answer.from_bytes(body)

    with warnings(caplog) as said:
        answer = simulate(run())
    assert "an offer of options that this kernel does not have" in answer.refused
    assert "unknown option 'telepathy'" in answer.refused
    assert any(f"refused an offer of one: {answer.refused}" in one for one in said)


@each
def test_hello_of_each_version_is_understood(peer: dict[str, Any]) -> None:
    writer, reader = WriterEnd(77, 5), ReaderEnd(77, 12)
    writer.channel_up(0, 12)
    reader.channel_up(0, 12)
    for end in (writer, reader):
        end.receive(0, bytes.fromhex(peer["hello"]))
        assert end.ledger.bad_frames == 0
    assert writer.state(0) is LinkState.UP


def test_the_highest_version_that_both_speak_is_spoken(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(versions, "SPOKEN", (1, 2))
    assert [versions.agreed("one", theirs) for theirs in ((1, 1), (0, 1), (2, 5), (1, 2))] == [1, 1, 2, 2]
    for theirs, said in (((3, 3), "one speaks 3, this speaks 1-2"), ((0, 0), "one speaks 0"), ((2, 1), "speaks 2-1")):
        with pytest.raises(WiringError, match=said):
            versions.agreed("one", theirs)


@given(st.binary(max_size=60))
def test_no_bytes_are_more_than_refused(body: bytes) -> None:
    for read in (Answer.from_bytes, LinkRequest.from_bytes, LinkOffer.from_bytes):
        with suppress(LinkError, WiringError):
            read(body)
