"""News and questions of services that are lost, late, refused or overtaken on the way to another kernel."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from cProfile import Profile
from typing import Any, Protocol

import pytest

from aiorts import Component, Goal, Kernel, Provided, Required, idempotent
from aiorts.errors import GoalFailed, LinkError, LinkTimeout, ServiceTimeout, ServiceUnavailable
from aiorts.links import Links, Peer
from aiorts.testing import MemoryNetwork, simulated
from links.memory_kernels import Sink, Source, kernel_of, long, until

Carry = Callable[[], Awaitable[bytes]]


class Arm(Protocol):
    async def add(self, left: float) -> float: ...
    @idempotent
    async def read(self) -> float: ...
    async def reach(self) -> Goal[int, str]: ...


class Robot(Component):
    arm = Provided[Arm](concurrent=True, max_connectors=1)

    def on_initialize(self) -> None:
        self.goals: list[Goal[int, str]] = []

    async def add(self, left: float) -> float:
        return left + 1.0

    async def read(self) -> float:
        return 2.0

    async def reach(self) -> Goal[int, str]:
        self.goals.append(Goal())
        return self.goals[-1]


class Client(Component):
    arm = Required[Arm](timeout=5.0)


class Rough:
    """The transport of a kernel whose questions a test meddles with: by what is asked, it is given what carries it."""

    def __init__(self, transport: Any) -> None:
        self._transport = transport
        self.asked: list[str] = []
        self.meddle: dict[str, Callable[[Carry], Awaitable[bytes]]] = {}

    def __getattr__(self, name: str) -> Any:
        return getattr(self._transport, name)

    async def ask(self, peer: Any, what: str, body: bytes, *, within: float) -> bytes:
        self.asked.append(what)

        async def carry() -> bytes:
            answer: bytes = await self._transport.ask(peer, what, body, within=within)
            return answer

        meddle = self.meddle.get(what)
        return await (carry() if meddle is None else meddle(carry))


class Pair:
    def __init__(self) -> None:
        self.network = MemoryNetwork()
        self.plant, self.station = Kernel("plant"), Kernel("station")
        self.from_plant, self.from_station = (Rough(self.network.transport(one)) for one in ("plant", "station"))
        self.client, self.robot = Client("client"), Robot("robot")

    async def connected(self) -> None:
        await self.station.add(self.robot)
        await self.plant.add(self.client)
        await self.plant.connect(self.client.arm, "station/robot.arm")

    @property
    def is_up(self) -> bool:
        return self.plant.service(Links).report() == {"client.arm-station/robot.arm": "up"}


@asynccontextmanager
async def a_pair() -> AsyncIterator[Pair]:
    pair = Pair()
    async with pair.station, pair.plant:
        pair.plant.service(Links).use(pair.from_plant)
        pair.station.service(Links).use(pair.from_station)
        await pair.plant.service(Links).opened()
        await pair.station.service(Links).opened()
        yield pair


def refused(times: int, text: str = "takes no more questions now") -> Callable[[Carry], Awaitable[bytes]]:
    """The first questions are refused."""
    left = [times]

    async def meddle(carry: Carry) -> bytes:
        left[0] -= 1
        if left[0] >= 0:
            raise LinkError(text)
        return await carry()

    return meddle


def unanswered(times: int) -> Callable[[Carry], Awaitable[bytes]]:
    """The first questions are lost."""
    left = [times]

    async def meddle(carry: Carry) -> bytes:
        left[0] -= 1
        if left[0] < 0:
            return await carry()
        await asyncio.sleep(2.0)
        raise LinkTimeout("no answer within 2 s")

    return meddle


@simulated
async def test_a_provider_is_bound_whose_coming_was_refused() -> None:
    async with a_pair() as pair:
        await pair.plant.add(pair.client)
        await pair.plant.connect(pair.client.arm, "station/robot.arm")
        pair.from_station.meddle["come"] = refused(2)
        await pair.station.add(pair.robot)
        await until(lambda: pair.is_up, 2.0)
        assert await pair.client.arm.proxy.add(1.0) == 2.0


@simulated
async def test_a_provider_is_bound_of_whose_coming_nothing_is_ever_heard() -> None:
    async with a_pair() as pair:
        await pair.plant.add(pair.client)
        await pair.plant.connect(pair.client.arm, "station/robot.arm")
        pair.from_station.meddle["come"] = refused(1_000)
        await pair.station.add(pair.robot)
        await until(lambda: pair.is_up, 20.0)


@simulated
async def test_a_provider_is_bound_whose_coming_overtakes_the_answer_that_it_is_not_there() -> None:
    async with a_pair() as pair:
        answered = asyncio.Event()

        async def late(carry: Carry) -> bytes:
            answer = await carry()
            pair.from_plant.meddle.clear()
            answered.set()
            await asyncio.sleep(0.5)
            return answer

        pair.from_plant.meddle["bind"] = late
        await pair.plant.add(pair.client)
        connecting = asyncio.ensure_future(pair.plant.connect(pair.client.arm, "station/robot.arm"))
        await answered.wait()
        await pair.station.add(pair.robot)
        await until(lambda: pair.is_up, 2.0)
        await connecting


@pytest.mark.parametrize("what", ["bind", "left", "goal", "call"])
@simulated
async def test_a_transport_that_fails_in_another_way_is_asked_again(what: str) -> None:
    async with a_pair() as pair:
        failed = asyncio.Event()

        async def fail_once(carry: Carry) -> bytes:
            if not failed.is_set():
                failed.set()
                raise OSError("no buffers")
            return await carry()

        asking = pair.from_station if what == "goal" else pair.from_plant
        asking.meddle[what] = fail_once
        match what:
            case "bind":
                await pair.connected()
                await until(lambda: pair.is_up, 3.0)
            case "left":
                await disconnected_while_it_is_offered_again(pair)
                await until(lambda: not pair.station.connectors, 5.0)
            case "goal":
                await pair.connected()
                goal = await pair.client.arm.proxy.reach()
                pair.robot.goals[0].succeed("there")
                assert await goal.result(5.0) == "there"
            case "call":
                await pair.connected()
                assert await pair.client.arm.proxy.read() == 2.0
        assert failed.is_set()


@simulated
async def test_what_is_disconnected_while_it_is_being_bound_leaves_nothing_bound() -> None:
    async with a_pair() as pair:
        answered = asyncio.Event()

        async def late(carry: Carry) -> bytes:
            answer = await carry()
            answered.set()
            await asyncio.sleep(0.5)
            return answer

        pair.from_plant.meddle["bind"] = late
        connecting = asyncio.ensure_future(pair.connected())
        await answered.wait()
        (connector,) = pair.client.arm.connectors
        await pair.plant.disconnect(connector)
        await connecting
        pair.from_plant.meddle.clear()
        await asyncio.sleep(1.0)
        await pair.plant.connect(pair.client.arm, "station/robot.arm")  # it takes one connector alone
        assert pair.is_up


@simulated
async def test_what_is_bound_in_the_turn_in_which_its_kernel_goes_is_not_up() -> None:
    async with a_pair() as pair:

        async def and_gone(carry: Carry) -> bytes:
            answer = await carry()
            pair.network.cut("plant", "station")
            await asyncio.sleep(0.1)
            return answer

        pair.from_plant.meddle["bind"] = and_gone
        await pair.connected()
        assert not pair.is_up
        with pytest.raises(ServiceUnavailable):
            await pair.client.arm.proxy.add(1.0)
        pair.from_plant.meddle.clear()
        pair.network.restore("plant", "station")
        await until(lambda: pair.is_up, 2.0)


@simulated
async def test_an_idempotent_call_that_is_refused_is_made_again_after_pauses() -> None:
    async with a_pair() as pair:
        await pair.connected()
        began = asyncio.get_running_loop().time()
        pair.from_plant.meddle["call"] = refused(3)
        assert await pair.client.arm.proxy.read() == 2.0
        assert asyncio.get_running_loop().time() - began > 0.5
        pair.from_plant.asked.clear()
        pair.from_plant.meddle["call"] = refused(100, "of 2000000 bytes; a question has 1048576 at the most")
        with pytest.raises(ServiceUnavailable, match="a question has 1048576"):
            await pair.client.arm.proxy.read()
        assert len(pair.from_plant.asked) < 10


@simulated
async def test_a_client_that_stood_still_hears_what_became_of_its_goal() -> None:
    async with a_pair() as pair:
        await pair.connected()
        goal = await pair.client.arm.proxy.reach()
        pair.network.stop("plant")
        pair.robot.goals[0].succeed("there")
        await asyncio.sleep(5.0)
        pair.network.go("plant")
        assert await goal.result(5.0) == "there"


@simulated
async def test_the_end_of_a_goal_is_told_until_it_is_heard() -> None:
    async with a_pair() as pair:
        await pair.connected()
        goal = await pair.client.arm.proxy.reach()
        pair.from_station.meddle["goal"] = refused(2)
        pair.robot.goals[0].succeed("there")
        assert await goal.result(5.0) == "there"


@simulated
async def test_a_goal_that_cannot_be_followed_fails_at_its_client() -> None:
    async with a_pair() as pair:
        await pair.connected()
        goal = await pair.client.arm.proxy.reach()
        pair.from_station.meddle["goal"] = refused(1)
        pair.robot.goals[0].feedback(1)
        with pytest.raises(GoalFailed, match="takes no more questions now"):
            await goal.result(5.0)
        await until(lambda: pair.robot.goals[0].cancel_requested, 1.0)


async def disconnected_while_it_is_offered_again(pair: Pair) -> None:
    """A link that was up, and is disconnected after a cut, before the other kernel has answered the offer."""
    source, sink = await pair.plant.add(Source("source")), await pair.station.add(Sink("sink"))
    connector = await pair.plant.connect(source.out, "station/sink.inp")
    await until(lambda: sink.inp.connectors and pair.plant.service(Links).report()[connector.name] == "up")
    pair.network.cut("plant", "station")
    await asyncio.sleep(0.1)

    pair.from_plant.meddle["offer"] = unanswered(1_000)
    pair.network.restore("plant", "station")
    await asyncio.sleep(0.1)
    await pair.plant.disconnect(connector)
    assert sink.inp.connectors


@simulated
async def test_a_departure_is_told_again_whose_kernel_has_not_answered() -> None:
    async with a_pair() as pair:
        pair.from_plant.meddle["left"] = unanswered(1)
        await disconnected_while_it_is_offered_again(pair)
        await until(lambda: not pair.station.connectors, 5.0)


@simulated
async def test_a_departure_is_told_to_a_kernel_that_is_back_and_went_while_it_was_told() -> None:
    async with a_pair() as pair:

        async def and_gone(carry: Carry) -> bytes:
            pair.from_plant.meddle.clear()
            pair.network.cut("plant", "station")
            raise LinkError("station: is gone")

        pair.from_plant.meddle["left"] = and_gone
        await disconnected_while_it_is_offered_again(pair)
        await asyncio.sleep(1.0)
        assert pair.station.connectors
        pair.network.restore("plant", "station")
        await until(lambda: not pair.station.connectors, 5.0)


@simulated
async def test_a_kernel_that_was_started_anew_connects_what_it_had_connected() -> None:
    network = MemoryNetwork()
    async with kernel_of(network, "one") as one:
        source = await one.add(Source("source"))
        async with kernel_of(network, "two") as former:
            sink = await former.add(Sink("sink"))
            await former.connect(sink.inp, "one/source.out")
            await source.out.write(long(1))
            assert (await sink.inp.read()).data == 1
            network.cut("one", "two")  # it is killed
        network.restore("one", "two")
        async with kernel_of(network, "two") as two:
            sink = await two.add(Sink("sink"))
            await asyncio.sleep(0.5)
            await two.connect(sink.inp, "one/source.out")
            await source.out.write(long(2))
            assert (await sink.inp.read()).data == 2
            assert len(one.connectors) == len(two.connectors) == 1


@simulated
async def test_a_connector_of_a_kernel_that_was_started_anew_and_does_not_make_it_goes_on_later() -> None:
    network = MemoryNetwork()
    async with kernel_of(network, "one") as one:
        source = await one.add(Source("source"))
        async with kernel_of(network, "two") as former:
            sink = await former.add(Sink("sink"))
            await former.connect(sink.inp, "one/source.out")
            await source.out.write(long(1))
            assert (await sink.inp.read()).data == 1
            network.cut("one", "two")
        network.restore("one", "two")
        async with kernel_of(network, "two") as two:
            sink = await two.add(Sink("sink"))
            await until(lambda: one.service(Links).report() == {"source.out-two/sink.inp": "up"}, 15.0)
            await source.out.write(long(2))
            assert (await sink.inp.read()).data == 2


@simulated
async def test_a_kernel_that_comes_and_goes_costs_nothing_more_with_many_links_to_others() -> None:
    async with kernel_of(MemoryNetwork(), "one") as one:
        source = await one.add(Source("source"))

        def calls() -> int:
            profile, peer = Profile(), Peer("memory", "stranger", 9)
            profile.enable()
            one.service(Links)._present(peer, True)
            one.service(Links)._present(peer, False)
            profile.disable()
            return sum(entry.callcount for entry in profile.getstats())

        few = calls()
        for number in range(100):
            one.connections.make((source.out, f"k{number}/sink.inp"), {})
        assert calls() == few


@simulated
@pytest.mark.parametrize("seconds", [0.1, 1.1])
async def test_what_was_disconnected_before_its_offer_was_heard_is_not_up_at_the_other_end(seconds: float) -> None:
    network = MemoryNetwork()
    async with kernel_of(network, "one") as one, kernel_of(network, "two") as two:
        source = await one.add(Source("source"))
        await two.add(Sink("sink"))
        network.stop("two")
        connector = await one.connect(source.out, "two/sink.inp")  # it has waited in vain for the first answer
        await asyncio.sleep(seconds)
        await one.disconnect(connector)
        await asyncio.sleep(3.0)
        network.go("two")
        await asyncio.sleep(0.1)
        await until(lambda: not two.connectors, 5.0)


@simulated
async def test_a_late_departure_does_not_end_the_connector_that_was_made_since() -> None:
    async with a_pair() as pair:
        sink = await pair.station.add(Sink("sink"))
        source = await pair.plant.add(Source("source"))
        free = asyncio.Event()

        async def held(carry: Carry) -> bytes:
            await free.wait()
            return await carry()

        pair.from_plant.meddle |= {"offer": unanswered(1), "left": held}
        await pair.plant.disconnect(await pair.plant.connect(source.out, "station/sink.inp"))
        connector = await pair.plant.connect(source.out, "station/sink.inp")
        free.set()
        await asyncio.sleep(1.0)
        await source.out.write(long(1))
        assert (await sink.inp.read()).data == 1
        assert not connector.closed


@simulated
async def test_a_provider_that_stood_still_is_bound_once() -> None:
    async with a_pair() as pair:
        await pair.station.add(pair.robot)
        await pair.plant.add(pair.client)
        pair.network.stop("station")
        await pair.plant.connect(pair.client.arm, "station/robot.arm")  # it takes one connector alone
        await asyncio.sleep(4.0)
        pair.network.go("station")
        await until(lambda: pair.is_up, 2.0)
        assert pair.client.arm.connectors
        assert await pair.client.arm.proxy.add(1.0) == 2.0


@simulated
@pytest.mark.parametrize("seconds", [0.1, 2.5])
async def test_what_was_disconnected_before_it_was_heard_to_be_bound_takes_no_place(seconds: float) -> None:
    async with a_pair() as pair:
        await pair.station.add(pair.robot)
        await pair.plant.add(pair.client)
        other = await pair.plant.add(Client("other"))
        pair.network.stop("station")
        connecting = asyncio.ensure_future(pair.plant.connect(pair.client.arm, "station/robot.arm"))
        await asyncio.sleep(seconds)
        (connector,) = pair.client.arm.connectors
        await pair.plant.disconnect(connector)
        await connecting
        await asyncio.sleep(3.0)
        pair.network.go("station")
        await asyncio.sleep(1.0)
        await pair.plant.connect(other.arm, "station/robot.arm")
        assert await other.arm.proxy.add(1.0) == 2.0


@simulated
async def test_a_kernel_that_stands_still_is_told_rarely_and_of_a_call_that_was_given_up_once() -> None:
    async with a_pair() as pair:
        await pair.connected()
        goal = await pair.client.arm.proxy.reach()
        pair.network.stop("station")
        pair.from_plant.asked.clear()
        for _ in range(3):
            with pytest.raises(ServiceTimeout):
                await pair.client.arm.within(0.1).add(1.0)
        goal.cancel()
        await asyncio.sleep(100.0)
        assert pair.from_plant.asked.count("cancel") == 3
        assert 1 < pair.from_plant.asked.count("cancel goal") < 15
        pair.network.go("station")
        await until(lambda: pair.robot.goals[0].cancel_requested, 2.0)
