"""A kernel that answers offers late has all its links in the end, and nothing is left of those that came to nothing."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from typing import Any

import pytest

from aiorts import Kernel
from aiorts.links import Caller, Channel, ChannelEvents, LinkOffer, Links
from aiorts.testing import MemoryNetwork, simulate
from links.memory_kernels import Sink, Source, kernel_of, until

pytestmark = pytest.mark.slow

COUNT = 400
EACH = 0.01
"""Seconds that the reader's kernel takes for one offer: 400 take longer than a question waits."""


class Counted:
    """A channel that is among the open ones until it is closed."""

    def __init__(self, channel: Channel, among: set[Counted]) -> None:
        self._channel, self._open = channel, among
        among.add(self)

    def send(self, head: Any, parts: Sequence[Any] = ()) -> bool:
        return self._channel.send(head, parts)

    def close(self) -> None:
        self._open.discard(self)
        self._channel.close()


class Deaf:
    """A channel that leads nowhere."""

    def send(self, head: Any, parts: Sequence[Any] = ()) -> bool:
        return True

    def close(self) -> None:
        pass


class Late:
    """A transport whose kernel answers offers one after the other, each after so many seconds.

    Its first channels, as many as `deaf`, lead nowhere.
    """

    def __init__(self, transport: Any, seconds: Callable[[], float], deaf: int) -> None:
        self._transport, self._seconds, self._turn, self._deaf = transport, seconds, asyncio.Lock(), deaf
        self.open_channels: set[Counted] = set()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._transport, name)

    async def channel(self, offer: LinkOffer, events: ChannelEvents) -> Counted:
        if self._deaf:
            self._deaf -= 1
            return Counted(Deaf(), self.open_channels)
        return Counted(await self._transport.channel(offer, events), self.open_channels)

    def answer(self, what: str, handler: Callable[[bytes, Caller], Awaitable[bytes]]) -> None:
        async def answered(body: bytes, caller: Caller) -> bytes:
            async with self._turn:
                answer = await handler(body, caller)
                await asyncio.sleep(self._seconds())
                return answer

        self._transport.answer(what, answered if what == "offer" else handler)


async def linked(count: int, seconds: Callable[[], float], within: float, deaf: int = 0) -> int:
    """Has so many links to a kernel that comes and answers late; how many channels its own ends have at the end."""
    network = MemoryNetwork()
    async with Kernel("one") as one, Kernel("two") as two:
        one.service(Links).use(network.transport("one"))
        await one.service(Links).opened()
        source, sink = await one.add(Source()), await two.add(Sink())
        for _ in range(count):
            await one.connect(source.out, f"two/{sink.name}.inp", allow_duplicate=True)
        late: Any = Late(network.transport("two"), seconds, deaf)
        two.service(Links).use(late)
        await two.service(Links).opened()
        states = one.service(Links).report
        await until(lambda: set(states().values()) == {"up"}, within)
        return len(late.open_channels)


def test_many_links_to_a_kernel_that_takes_its_time_for_each_are_all_up_when_it_has_answered_each_once() -> None:
    assert simulate(linked(COUNT, lambda: EACH, 1.5 * COUNT * EACH)) == COUNT


def test_of_an_offer_whose_answer_came_too_late_no_channel_is_left() -> None:
    waits = [5.0, 0.0]
    assert simulate(linked(1, lambda: waits.pop(0) if waits else 0.0, 30.0)) == 1
    assert waits == []


def test_a_channel_on_which_nobody_answers_is_given_up_and_the_link_offered_again() -> None:
    assert simulate(linked(1, lambda: 0.0, 25.0, deaf=2)) == 1


async def left_over(seconds_until_disconnected: float) -> int:
    """Ends 20 links that were down and wait for their turn; how many connectors the reader's kernel has in the end."""
    network = MemoryNetwork(delay=0.03)
    async with kernel_of(network, "one") as one, kernel_of(network, "two") as two:
        source, sink = await one.add(Source()), await two.add(Sink())
        port = f"two/{sink.name}.inp"
        made = [await one.connect(source.out, port, allow_duplicate=True) for _ in range(100)]
        states = one.service(Links).report
        await until(lambda: set(states().values()) == {"up"})
        network.cut("one", "two")
        await until(lambda: "up" not in states().values())
        network.restore("one", "two")
        await asyncio.sleep(seconds_until_disconnected)
        for connector in made[-20:]:
            await one.disconnect(connector)
        await until(lambda: set(states().values()) == {"up"})
        await asyncio.sleep(20.0)
        return len(two.connectors)


@pytest.mark.parametrize("seconds", [0.0, 0.01, 0.05, 0.1, 0.5])
def test_of_a_link_that_is_disconnected_before_it_was_offered_again_no_end_is_left(seconds: float) -> None:
    assert simulate(left_over(seconds)) == 80
