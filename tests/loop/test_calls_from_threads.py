"""Calls from another thread: refused with the name of the call, and nothing is changed."""

from __future__ import annotations

import asyncio
import threading
from typing import TYPE_CHECKING, Any

import pytest

from aiorts import (
    Component,
    Composite,
    EventContext,
    ExternalContext,
    InPort,
    Kernel,
    MultiModeComponent,
    OutPort,
    Param,
    PeriodicContext,
    StateMachineComponent,
    Supervision,
)
from aiorts.errors import ThreadError
from aiorts.events import Event
from aiorts.statechart import Chart, On, State
from aiorts.types import TimedLong

if TYPE_CHECKING:
    from collections.abc import Callable


class Plant(Component):
    out = OutPort(TimedLong)
    in_ = InPort(TimedLong)
    gain = Param(1.0)


CALLS: dict[str, Callable[[Any, Any, Any, Any], Any]] = {
    "add": lambda k, c, p, w: k.add(Plant("other")),
    "create": lambda k, c, p, w: k.create(Plant),
    "remove": lambda k, c, p, w: k.remove(p),
    "connect": lambda k, c, p, w: k.connect(p.out, p.in_),
    "disconnect": lambda k, c, p, w: k.disconnect(w),
    "start": lambda k, c, p, w: k.start(EventContext(), p),
    "stop": lambda k, c, p, w: k.stop(c["event0"]),
    "sleep": lambda k, c, p, w: k.sleep(0.0),
    "aclose": lambda k, c, p, w: k.aclose(),
    "wait_stop_requested": lambda k, c, p, w: k.wait_stop_requested(),
    "event0.activate": lambda k, c, p, w: c["event0"].activate(p),
    "event0.deactivate": lambda k, c, p, w: c["event0"].deactivate(p),
    "event0.reset": lambda k, c, p, w: c["event0"].reset(p),
    "event0.add": lambda k, c, p, w: c["event0"].add(p),
    "event0.remove": lambda k, c, p, w: c["event0"].remove(p),
    "event0.stop": lambda k, c, p, w: c["event0"].stop(),
    "event0.trigger": lambda k, c, p, w: c["event0"].trigger(),
    "external0.tick": lambda k, c, p, w: c["external0"].tick(),
    "periodic0.set_rate": lambda k, c, p, w: c["periodic0"].set_rate(5.0),
    "plant.configure": lambda k, c, p, w: p.configure(gain=2.0),
    "plant.add_port": lambda k, c, p, w: p.add_port("more", InPort(TimedLong)),
    "plant.remove_port": lambda k, c, p, w: p.remove_port("out"),
    "plant.finish": lambda k, c, p, w: p.finish(),
}


@pytest.mark.anyio
@pytest.mark.fault("A16")
async def test_every_call_from_another_thread_names_itself_and_changes_nothing(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        plant = await kernel.add(Plant("plant"))
        wire = await kernel.connect(plant.out, plant.in_)
        for context in (EventContext(), ExternalContext(), PeriodicContext(1.0)):
            await kernel.start(context, plant)
        before = (repr(kernel), repr(plant), dict(kernel.contexts), dict(plant.ports))
        wrong: list[str] = []
        calls = [(name, call) for _ in range(50) for name, call in CALLS.items()]
        assert len(calls) >= 1000

        async def attempt(call: Any) -> None:
            result = call(kernel, kernel.contexts, plant, wire)
            if asyncio.iscoroutine(result):
                await result

        def from_a_thread() -> None:
            loop = asyncio.new_event_loop()
            for name, call in calls:
                try:
                    loop.run_until_complete(attempt(call))
                    wrong.append(f"{name}: accepted")
                except ThreadError as error:
                    if f"{name} called from thread" not in str(error):
                        wrong.append(f"{name}: {error}")
            loop.close()

        thread = threading.Thread(target=from_a_thread)
        thread.start()
        while thread.is_alive():
            await asyncio.sleep(0.001)
        thread.join()
        assert sorted(set(wrong)) == []
        assert (repr(kernel), repr(plant), dict(kernel.contexts), dict(plant.ports)) == before


@pytest.mark.anyio
@pytest.mark.fault("A16")
@pytest.mark.parametrize("call", ["write_nowait", "read_nowait", "latest"])
async def test_in_debug_mode_a_port_used_from_another_thread_says_so(call: str, anyio_backend: Any) -> None:
    async with Kernel(debug=True) as kernel:
        plant = await kernel.add(Plant("plant"))
        await kernel.connect(plant.out, plant.in_)

        def use() -> Any:
            if call == "write_nowait":
                return plant.out.write_nowait(TimedLong(0, 1))
            return plant.in_.read_nowait() if call == "read_nowait" else plant.in_.latest

        with pytest.raises(ThreadError, match=r"plant\.(out|in_): used from thread"):
            await asyncio.to_thread(use)


MORE: dict[str, Callable[[Any, Any, Any, Any], Any]] = {
    "arm.add_param": lambda k, a, w, d: a.add_param("mass", Param(1.0)),
    "arm.configuration": lambda k, a, w, d: a.configuration.add("soft", {}),
    "arm.set_mode": lambda k, a, w, d: a.set_mode("automatic"),
    "change": lambda k, a, w, d: w.remove_members("plant"),
    "door: send": lambda k, a, w, d: d.machine.send("go"),
    "supervise": lambda k, a, w, d: k.supervise(a, Supervision("reset")),
    "wait_ready": lambda k, a, w, d: k.wait_ready(),
    "start in order": lambda k, a, w, d: k.start_in_order([]),
    "stop in order": lambda k, a, w, d: k.stop_in_order(),
    "monitor the loop": lambda k, a, w, d: k.watch_loop(),
    "notify systemd": lambda k, a, w, d: k.notify_systemd(environ={"NOTIFY_SOCKET": "/nowhere"}),
    "changes": lambda k, a, w, d: k.changes(),
    "monitor": lambda k, a, w, d: k.monitor(["arm.gain"]),
    "profile": lambda k, a, w, d: k.profile(),
    "heartbeat": lambda k, a, w, d: k.heartbeat(),
    "bus.subscribe": lambda k, a, w, d: k.bus.subscribe(Event, print),
    "listen": lambda k, a, w, d: k.listen(next(iter(k.connectors.values())), print),
    "save_configuration": lambda k, a, w, d: k.save_configuration("/nowhere/values.toml"),
    "load_configuration": lambda k, a, w, d: k.load_configuration("/nowhere/values.toml"),
}


class Arm(MultiModeComponent):
    modes = ("manual", "automatic")
    gain = Param(1.0)


class Door(StateMachineComponent):
    chart = Chart(State("a", On("go", to="b"), initial=True), State("b"))


@pytest.mark.anyio
@pytest.mark.fault("A16")
@pytest.mark.parametrize("name", MORE)
async def test_what_came_later_is_refused_as_well(name: str, anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        arm, door, plant = (
            await kernel.add(Arm("arm")),
            await kernel.add(Door("door")),
            await kernel.add(Plant("plant")),
        )
        whole = await kernel.add(Composite("whole", plant))
        await kernel.connect(plant.out, plant.in_)
        await kernel.start(ExternalContext(), door, activate=True)
        before = (kernel.profile().structure(), kernel.bus.observers, dict(kernel.supervised), arm.mode, whole.members)

        async def attempt() -> None:
            result = MORE[name](kernel, arm, whole, door)
            if asyncio.iscoroutine(result):
                await result

        with pytest.raises(ThreadError, match=f"{name} called from thread"):
            await asyncio.to_thread(asyncio.run, attempt())
        now = (kernel.profile().structure(), kernel.bus.observers, dict(kernel.supervised), arm.mode, whole.members)
        assert now == before


@pytest.mark.anyio
async def test_stop_may_be_requested_from_any_thread(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        thread = threading.Thread(target=kernel.request_stop, args=(3,))
        thread.start()
        assert await asyncio.wait_for(kernel.wait_stop_requested(), 1.0) == 3
        thread.join()


@pytest.mark.slow
@pytest.mark.anyio
async def test_kernels_in_several_threads_know_nothing_of_each_other(anyio_backend: Any) -> None:
    import aiorts

    ticks: list[int] = []

    async def main() -> None:
        async with Kernel() as kernel:
            plant = await kernel.add(Plant("plant"))
            context = await kernel.start(PeriodicContext(200.0), plant, activate=True)
            await asyncio.sleep(0.1)
            ticks.append(context.ticks)

    threads = [threading.Thread(target=aiorts.run, args=(main,)) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(ticks) == 3
    assert min(ticks) >= 10
