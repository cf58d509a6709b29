"""Transports that plugins offer, by name."""

from __future__ import annotations

import pytest
from anyio import fail_after

from aiorts import Catalogue, Component, InPort, Kernel, OutPort
from aiorts.errors import PluginError
from aiorts.links import find_transport
from aiorts.types import TimedLong
from plugin_dists import project

pytestmark = [pytest.mark.anyio, pytest.mark.row(54)]
MODULE = """
from aiorts.testing import MemoryNetwork

NETWORK = MemoryNetwork()


class Pigeons:
    def __init__(self):
        self.answers = []

    async def open(self, kernel):
        self.inner = NETWORK.transport(kernel.name)
        for what, handler in self.answers:
            self.inner.answer(what, handler)
        await self.inner.open(kernel)

    async def close(self):
        await self.inner.close()

    def presence(self, tell):
        return self.inner.presence(tell)

    async def channel(self, offer, events):
        return await self.inner.channel(offer, events)

    async def ask(self, peer, what, body, *, within):
        return await self.inner.ask(peer, what, body, within=within)

    def answer(self, what, handler):
        self.answers.append((what, handler))


class Deaf:
    async def open(self, kernel): ...


class Broken:
    def __init__(self):
        raise OSError("no pigeons")
"""


class Source(Component):
    out = OutPort(TimedLong)


class Sink(Component):
    inp = InPort(TimedLong)


@pytest.fixture(scope="module")
def plugins(tmp_path_factory: pytest.TempPathFactory) -> Catalogue:
    # For all tests the same folder: a module is imported once.
    folder = tmp_path_factory.mktemp("pigeons")
    offers = {f"transports/{name.lower()}": f"pigeons:{name}" for name in ("Pigeons", "Deaf", "Broken")}
    return Catalogue([project(folder, "pigeons", {"pigeons": MODULE}, offers)])


@pytest.mark.slow
async def test_a_transport_of_a_plugin_carries_links(plugins: Catalogue) -> None:
    links = {"links": {"transport": "pigeons"}}
    async with (
        Kernel("station", plugins=plugins, services=links) as station,
        Kernel("robot", plugins=plugins, services=links) as robot,
    ):
        source, sink = await robot.add(Source("source")), await station.add(Sink("sink"))
        with fail_after(5):
            await robot.connect(source.out, "station/sink.inp")
            source.out.write_nowait(TimedLong(0, 7))
            assert (await sink.inp.read()).data == 7


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("pigeon", "did you mean 'pigeons'|did you mean pigeons"),
        ("deaf", "Deaf has no method close"),
        ("broken", "cannot be made: OSError: no pigeons"),
    ],
)
def test_what_is_no_transport_is_refused_by_name(plugins: Catalogue, name: str, why: str) -> None:
    with pytest.raises(PluginError, match=why):
        find_transport(name, plugins)
