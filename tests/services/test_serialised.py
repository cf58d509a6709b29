"""A call and the hooks of a provider never run at once, unless it says so; circles of calls are found at once."""

from __future__ import annotations

import asyncio
from typing import Any, Protocol

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts import Component, EventContext, ExternalContext, Kernel, Param, PeriodicContext, Provided, Required
from aiorts.errors import ServiceCycle, ServiceError, ServiceTimeout, ServiceUnavailable
from aiorts.kernel.execution.cell import cell
from aiorts.testing import simulated
from aiorts.testing.simulation import simulate
from campaign import ORDERS
from services.parts import Arm, Brake, Quick, wired
from services_api import waits


class Busy(Component):
    """Its hook and its method each take time; notes who is inside."""

    service = Provided[Brake]()

    def __init__(self, name: str = "brake0") -> None:
        super().__init__(name)
        self.inside = 0
        self.most = 0
        self.notes: list[str] = []

    async def _take(self, what: str, seconds: float) -> None:
        self.inside += 1
        self.most = max(self.most, self.inside)
        self.notes.append(what)
        await self.sleep(seconds)
        self.inside -= 1

    async def on_execute(self) -> None:
        await self._take("hook", 0.006)

    async def stop(self, force: float = 1.0) -> float:
        await self._take("call", 0.003)
        return force

    def held(self) -> bool:
        return self.inside > 0


class BusyConcurrent(Busy):
    service = Provided[Brake](concurrent=True)


@pytest.mark.row(71)
@pytest.mark.parametrize("context", [lambda: PeriodicContext(100.0), EventContext], ids=["periodic", "event"])
def test_a_call_waits_for_the_hook_that_runs_and_the_hook_for_the_call(context: Any) -> None:
    """OpenRTM runs the servant in a thread of the ORB, at once with on_execute."""

    async def main() -> None:
        async with Kernel() as kernel:
            brake = Busy()
            arm = await wired(kernel, brake)
            loop = await kernel.start(context(), brake, activate=True)
            for _ in range(20):
                if isinstance(loop, EventContext):
                    loop.trigger()
                await kernel.sleep(0.001)
                await asyncio.gather(*(arm.brake.proxy.stop() for _ in range(3)))
            assert brake.notes.count("hook") > 10
            assert brake.notes.count("call") == 60
            assert brake.most == 1

    simulate(main())


@pytest.mark.row(71)
@simulated
async def test_one_that_says_so_is_called_at_once() -> None:
    async with Kernel() as kernel:
        brake = BusyConcurrent()
        arm = await wired(kernel, brake)
        await kernel.start(PeriodicContext(100.0), brake, activate=True)
        await kernel.sleep(0.001)
        assert await arm.brake.proxy.held() is True
        await asyncio.gather(*(arm.brake.proxy.stop() for _ in range(3)))
        assert brake.most == 4


@pytest.mark.row(71)
@simulated
async def test_the_deadline_of_a_call_counts_the_wait_to_be_let_in() -> None:
    async with Kernel() as kernel:
        brake = Busy()
        arm = await wired(kernel, brake)
        loop = await kernel.start(ExternalContext(), brake, activate=True)
        ticking = asyncio.ensure_future(loop.tick())
        await kernel.sleep(0.001)
        begun = asyncio.get_running_loop().time()
        with pytest.raises(ServiceTimeout, match=r"busy in .*on_execute"):
            await arm.brake.within(0.002).stop()
        assert asyncio.get_running_loop().time() - begun == pytest.approx(0.002, abs=1e-6)
        await ticking
        assert brake.notes == ["hook"]


@simulated
async def test_a_call_that_waits_is_refused_when_the_provider_is_active_no_more() -> None:
    async with Kernel() as kernel:
        brake = Busy()
        arm = await wired(kernel, brake)
        loop = await kernel.start(ExternalContext(name="loop"), brake, activate=True)
        ticking = asyncio.ensure_future(loop.tick())
        await kernel.sleep(0.001)
        calls = [asyncio.ensure_future(arm.brake.proxy.stop()) for _ in range(3)]
        await kernel.sleep(0)
        brake.finish()
        await ticking
        await loop.tick()
        for call in calls:
            await asyncio.wait([call])
        outcomes = [call.exception() for call in calls]
        assert all(error is None or isinstance(error, ServiceUnavailable) for error in outcomes)
        with pytest.raises(ServiceUnavailable, match="inactive in loop"):
            await arm.brake.proxy.stop()
        assert cell(brake).entry_lock.open


@simulated
async def test_calls_that_wait_for_a_hook_that_fails_are_refused() -> None:
    class Failing(Busy):
        async def on_execute(self) -> None:
            await super().on_execute()
            raise ValueError("worn")

    async with Kernel() as kernel:
        brake = Failing()
        arm = await wired(kernel, brake)
        loop = await kernel.start(ExternalContext(name="loop"), brake, activate=True)
        ticking = asyncio.ensure_future(loop.tick())
        await kernel.sleep(0.001)
        calls = [arm.brake.proxy.stop() for _ in range(3)]
        for outcome in await asyncio.gather(*calls, return_exceptions=True):
            assert isinstance(outcome, ServiceUnavailable)
            assert "reset and activate it" in str(outcome)
        await ticking
        assert brake.notes == ["hook"]
        assert cell(brake).entry_lock.open


@simulated
async def test_calls_are_let_in_in_the_order_they_came() -> None:
    class Counting(Busy):
        service = Provided[Brake]()

        def __init__(self) -> None:
            super().__init__("brake0")
            self.order: list[float] = []

        async def stop(self, force: float = 1.0) -> float:
            self.order.append(force)
            await self.sleep(0.001)
            return force

    async with Kernel() as kernel:
        brake = Counting()
        arm = await wired(kernel, brake)
        numbers = [float(n) for n in range(20)]
        await asyncio.gather(*(arm.brake.proxy.stop(n) for n in numbers))
        assert brake.order == numbers


@simulated
async def test_a_plain_method_that_would_have_to_wait_says_so() -> None:
    class Counter(Busy):
        quick = Provided[Quick]()

        def count(self) -> int:
            return self.most

    class Asking(Component):
        counter = Required[Quick]()

    async with Kernel() as kernel:
        asking, counter = await kernel.add(Asking("asking")), await kernel.add(Counter("counter"))
        await kernel.connect(asking.counter, counter.quick)
        loop = await kernel.start(ExternalContext(), counter, activate=True)
        assert asking.counter.proxy.count() == 0
        ticking = asyncio.ensure_future(loop.tick())
        await kernel.sleep(0.001)
        with pytest.raises(ServiceUnavailable, match=r"busy in .*on_execute; a plain method does not wait"):
            asking.counter.proxy.count()
        await ticking
        assert asking.counter.proxy.count() == 1


@simulated
async def test_a_served_method_knows_where_it_is() -> None:
    seen: list[Any] = []

    class Curious(Component):
        service = Provided[Brake]()

        async def stop(self, force: float = 1.0) -> float:
            seen.append((self.context, self.state))
            await self.context.deactivate(self)  # of its own component: queued, as in a hook
            task = asyncio.ensure_future(asyncio.sleep(0))
            await task
            return force

        def held(self) -> bool:
            seen.append((self.context, self.state))
            self.finish()
            return True

    async with Kernel() as kernel:
        brake = Curious("brake0")
        arm = await wired(kernel, brake)
        loop = await kernel.start(ExternalContext(), brake, activate=True)
        assert await arm.brake.proxy.stop(2.0) == 2.0
        await loop.tick()
        assert str(loop.state(brake)) == "inactive"
        await loop.activate()
        assert await arm.brake.proxy.held()
        await loop.tick()
        assert str(loop.state(brake)) == "inactive"
        assert [str(state) for context, state in seen if context is loop] == ["active", "active"]


class Ask(Protocol):
    """One of a ring of components that ask one another."""

    async def ask(self, path: tuple[int, ...]) -> int: ...


class Node(Component):
    """Serves `ask` by asking the next on the path; its hook asks, too."""

    answer = Provided[Ask]()
    others = Required[Ask](many=True)

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        self.plan: tuple[int, ...] = ()
        self.outcome: object = None

    async def ask(self, path: tuple[int, ...]) -> int:
        if not path:
            return 0
        return 1 + await self.others.proxies[path[0]].ask(path[1:])

    async def on_execute(self) -> None:
        try:
            self.outcome = await self.ask(self.plan)
        except ServiceError as error:
            self.outcome = error


class Loose(Node):
    answer = Provided[Ask](concurrent=True)


def root(error: BaseException) -> BaseException:
    while error.__cause__ is not None:
        error = error.__cause__
    return error


@simulated
async def test_a_circle_of_calls_is_an_error_at_once_that_tells_the_way() -> None:
    async with Kernel() as kernel:
        a, b = await kernel.add(Node("a")), await kernel.add(Node("b"))
        await kernel.connect(a.others, b.answer)
        await kernel.connect(b.others, a.answer)
        loop = await kernel.start(ExternalContext(name="loop"), a, activate=True)
        other = await kernel.start(ExternalContext(), b, activate=True)
        a.plan = (0, 0)
        begun = asyncio.get_running_loop().time()

        await loop.tick()
        assert asyncio.get_running_loop().time() == begun
        assert isinstance(a.outcome, ServiceError)
        found = root(a.outcome)
        assert isinstance(found, ServiceCycle)
        for part in ("b.others -> a.answer.ask", "a is in loop, in on_execute", "calls b.answer.ask"):
            assert part in str(found)
        assert b.answer.statistics.calls == 1
        assert cell(a).entry_lock.open
        assert cell(b).entry_lock.open
        await other.stop()


@simulated
async def test_two_hooks_that_call_one_another_do_not_wait_for_ever() -> None:
    async with Kernel() as kernel:
        a, b = await kernel.add(Node("a")), await kernel.add(Node("b"))
        await kernel.connect(a.others, b.answer)
        await kernel.connect(b.others, a.answer)
        loops = [await kernel.start(ExternalContext(), one, activate=True) for one in (a, b)]
        a.plan = b.plan = (0,)
        begun = asyncio.get_running_loop().time()
        await asyncio.gather(*(loop.tick() for loop in loops))
        assert asyncio.get_running_loop().time() == begun
        outcomes = [a.outcome, b.outcome]
        assert sum(isinstance(one, ServiceCycle) for one in outcomes) == 1
        assert outcomes.count(1) == 1


@st.composite
def systems(draw: st.DrawFn) -> tuple[list[bool], list[tuple[int, ...]], bool]:
    count = draw(st.integers(2, 5))
    loose = draw(st.lists(st.booleans(), min_size=count, max_size=count))
    path = st.lists(st.integers(0, count - 1), max_size=5).map(tuple)
    plans = draw(st.lists(path, min_size=count, max_size=count))
    return loose, plans, draw(st.booleans())


@pytest.mark.slow(kept_by="test_two_hooks_that_call_one_another_do_not_wait_for_ever")
@settings(max_examples=ORDERS)
@given(systems(), st.integers(0, ORDERS))
def test_no_system_of_calls_ever_waits_for_a_deadline(
    system: tuple[list[bool], list[tuple[int, ...]], bool], seed: int
) -> None:
    """Every call of hooks that call one another along any paths is answered, or told of its circle, in no time."""
    loose, plans, together = system

    async def main() -> None:
        async with Kernel() as kernel:
            nodes: list[Node] = []
            for number, free in enumerate(loose):
                nodes.append(await kernel.add((Loose if free else Node)(f"n{number}")))
            for node in nodes:
                for other in nodes:
                    await kernel.connect(node.others, other.answer)
            for node, plan in zip(nodes, plans, strict=True):
                node.plan = plan
            if together:
                loops = [await kernel.start(ExternalContext(), *nodes, activate=True)]
            else:
                loops = [await kernel.start(ExternalContext(), node, activate=True) for node in nodes]
            begun = asyncio.get_running_loop().time()
            await asyncio.gather(*(loop.tick() for loop in loops))
            assert asyncio.get_running_loop().time() == begun
            for node, plan in zip(nodes, plans, strict=True):
                if isinstance(node.outcome, ServiceError):
                    assert isinstance(root(node.outcome), ServiceCycle)
                else:
                    assert node.outcome == len(plan)
                assert cell(node).entry_lock.open
            assert not waits(kernel)

    simulate(main(), seed=seed)


@simulated
async def test_what_nobody_waits_for_is_no_circle() -> None:
    """A task that a hook leaves behind may call its own component: it waits until the hook is over."""

    class Later(Node):
        async def on_execute(self) -> None:
            self.task = asyncio.ensure_future(self.others.proxies[0].ask(()))
            await self.sleep(0.01)

    async with Kernel() as kernel:
        node = await kernel.add(Later("node"))
        await kernel.connect(node.others, (await kernel.add(Node("other"))).answer)
        own = await kernel.add(Asking("own"))
        await kernel.connect(own.others, node.answer)
        loop = await kernel.start(ExternalContext(), node, activate=True)
        ticking = asyncio.ensure_future(loop.tick())
        await kernel.sleep(0.001)
        assert await own.others.proxies[0].ask(()) == 0
        await ticking
        assert await node.task == 0


class Asking(Component):
    others = Required[Ask](many=True)


@simulated
async def test_a_component_without_provided_ports_passes_by_its_gate() -> None:
    async with Kernel() as kernel:
        arm = await kernel.add(Arm())
        node = await kernel.add(Node("node"))
        loop = await kernel.start(ExternalContext(), arm, node, activate=True)
        assert cell(arm).entry_lock.shared is False
        assert cell(node).entry_lock.shared is True
        await loop.tick()


class Tuned(Component):
    """Its method reads a parameter twice."""

    service = Provided[Brake]()
    gain = Param(1.0)

    async def stop(self, force: float = 1.0) -> float:
        before = self.gain
        await self.sleep(0.1)
        return 0.0 if self.gain == before else 1.0

    async def held(self) -> bool:
        await self.configure(gain=7.0)  # its own: done when the call is over
        return self.gain == 7.0


@pytest.mark.row(71)
@pytest.mark.parametrize("contexts", [0, 1, 2])
def test_parameters_do_not_change_while_a_call_is_served(contexts: int) -> None:
    async def main() -> None:
        async with Kernel() as kernel:
            tuned = await kernel.add(Tuned("tuned"))
            arm = await kernel.add(Arm())
            await kernel.connect(arm.brake, tuned.service)
            for _ in range(contexts):
                await kernel.start(PeriodicContext(100.0), tuned, activate=True)
            calls = [asyncio.ensure_future(arm.brake.proxy.stop()) for _ in range(2)]
            await kernel.sleep(0.05)
            await tuned.configure(gain=5.0)
            assert tuned.gain == 5.0
            assert [await call for call in calls] == [0.0, 0.0]
            assert await arm.brake.proxy.held() is False
            await kernel.sleep(0.05)
            assert tuned.gain == 7.0

    simulate(main())
