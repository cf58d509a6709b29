"""`kernel.activate`, `deactivate` and `reset`: a component or its path, in its only context or in the one named."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import pytest

from aiorts import (
    Component,
    Composite,
    Context,
    EventContext,
    ExternalContext,
    InPort,
    Kernel,
    LifecycleState,
    Param,
    PeriodicContext,
    SimulatedClock,
    ThreadContext,
)
from aiorts.errors import (
    ClosedError,
    ComponentError,
    ConfigurationError,
    InvalidNameError,
    StateError,
    ThreadError,
    TransitionTimeout,
    WiringError,
)
from aiorts.testing.simulation import simulate
from aiorts.types import TimedLong
from contexts.parts import Doer, Idle

ACTIVE, INACTIVE, ERROR = LifecycleState.ACTIVE, LifecycleState.INACTIVE, LifecycleState.ERROR
KINDS: dict[str, Callable[[], Context]] = {
    "periodic": lambda: PeriodicContext(0.001),
    "event": EventContext,
    "external": ExternalContext,
    "thread": ThreadContext,
}


@pytest.mark.parametrize("kind", KINDS)
def test_a_component_or_its_path_is_activated_deactivated_and_reset(kind: str) -> None:
    async def main(clock: SimulatedClock) -> None:
        class Broken(Component):
            def on_activated(self) -> None:
                raise ValueError("no device")

        async with Kernel("robot") as kernel:
            pid, broken = await kernel.add(Idle("pid0")), await kernel.add(Broken("broken"))
            context = await kernel.start(KINDS[kind](), pid, broken)
            for target in ("pid0", "robot/pid0", pid):
                for where in (None, context, context.name):
                    await kernel.activate(target, context=where)
                    assert (pid.state, broken.state) == (ACTIVE, INACTIVE)
                    await kernel.deactivate(target, context=where)
                    assert pid.state is INACTIVE
            with pytest.raises(ComponentError, match="on_activated raised ValueError: no device"):
                await kernel.activate("broken")
            assert broken.state is ERROR
            await kernel.reset("broken")
            assert broken.state is INACTIVE
            with pytest.raises(StateError, match="pid0"):
                await kernel.reset("pid0")
            assert [context.state(one) for one in context.members] == [INACTIVE, INACTIVE]

    simulate(main)


def test_of_several_contexts_one_has_to_be_named() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel("robot") as kernel:
            pid, free = await kernel.add(Idle("pid0")), await kernel.add(Idle("free"))
            fast = await kernel.start(ExternalContext(name="fast"), pid)
            slow = await kernel.start(ExternalContext(name="slow"), pid)
            said = "pid0: cannot activate: it is in 2 contexts, fast, slow; say which: context='fast'"
            with pytest.raises(StateError, match=said):
                await kernel.activate(pid)
            await kernel.activate(pid, context="slow")
            await kernel.activate(pid, context=fast)
            assert dict(pid.states) == {"fast": ACTIVE, "slow": ACTIVE}
            await kernel.deactivate("pid0", context=slow)
            assert dict(pid.states) == {"fast": ACTIVE, "slow": INACTIVE}
            with pytest.raises(StateError, match=r"free: cannot reset: it is in no context; kernel\.start one with it"):
                await kernel.reset(free)
            with pytest.raises(StateError, match="free: is not in fast"):
                await kernel.activate(free, context="fast")
            await kernel.stop(slow)
            await kernel.deactivate(pid)  # one is left
            assert pid.state is INACTIVE
            with pytest.raises(StateError, match="the context does not run"):
                await kernel.activate(pid, context=slow)

    simulate(main)


def test_what_is_not_there_is_refused_by_name() -> None:
    async def main(clock: SimulatedClock) -> None:
        class Reader(Idle):
            inp = InPort(TimedLong)

        async with Kernel("robot") as kernel, Kernel("other") as other:
            pid, foreign = await kernel.add(Reader("pid0")), await other.add(Idle("foreign"))
            await kernel.start(ExternalContext(name="loop"), pid)
            wrong: list[tuple[Any, Any, type[Exception], str]] = [
                ("pdi0", None, WiringError, "pdi0: no component 'pdi0'; did you mean 'pid0'?"),
                ("nobody", None, WiringError, "nobody: no component 'nobody'; there are pid0"),
                ("other/pid0", None, WiringError, "is in the kernel 'other'"),
                ("a b", None, InvalidNameError, "' ' not allowed"),
                ("pid0.inp", None, StateError, "cannot activate pid0.inp: it is no component; give a component"),
                (pid.inp, None, StateError, "cannot activate pid0.inp: it is no component; give a component"),
                (7, None, StateError, "cannot activate 7: it is no component"),
                (foreign, None, StateError, "foreign: does not belong to robot"),
                (Idle("new"), None, StateError, "new: does not belong to robot; await kernel.add"),
                (pid, "lopo", StateError, "no context 'lopo' runs in robot; did you mean 'loop'?"),
                (pid, "far", StateError, "no context 'far' runs in robot; there are loop"),
                (pid, 7, ConfigurationError, "context = 7: expected a context or its name"),
                (pid, PeriodicContext(1.0), StateError, "the context does not run; kernel.start it"),
            ]
            for component, context, error, said in wrong:
                with pytest.raises(error) as caught:
                    await kernel.activate(component, context=context)
                assert said in str(caught.value)
            assert pid.state is INACTIVE
        with pytest.raises(ClosedError, match="robot: cannot activate: is closed"):
            await kernel.activate("pid0")
        with pytest.raises(ClosedError, match="cannot reset: is not open"):
            await Kernel().reset("pid0")

    simulate(main)


def test_a_transition_that_takes_too_long_is_a_time_out_as_in_the_context() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            slow = await kernel.add(Doer("slow", activated=lambda: kernel.sleep(1.0)))
            await kernel.start(ExternalContext(), slow)
            with pytest.raises(TransitionTimeout):
                await kernel.activate("slow", timeout=0.5)
            await kernel.sleep(0.6)
            assert slow.state is ACTIVE
            await kernel.deactivate("slow")
            await kernel.activate("slow", timeout=None)

    simulate(main)


def test_a_hook_may_ask_for_itself_and_for_its_neighbour() -> None:
    async def main(clock: SimulatedClock) -> None:
        class Chief(Component):
            async def on_execute(self) -> None:
                await kernel.deactivate(self)
                await kernel.activate("worker")
                at.append((self.state, worker.state))

        at: list[Any] = []
        async with Kernel() as kernel:
            chief, worker = await kernel.add(Chief("chief")), await kernel.add(Idle("worker"))
            loop = await kernel.start(ExternalContext(), chief, worker)
            await kernel.activate(chief)
            await loop.tick()
            await kernel.sleep(0.001)
            assert at == [(ACTIVE, INACTIVE)]  # queued until the cycle is over
            assert (chief.state, worker.state) == (INACTIVE, ACTIVE)

    simulate(main)


def test_a_composite_and_its_members_are_asked_alike() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            parts = [Idle("left"), Idle("right")]
            arm = await kernel.add(Composite("arm", *parts))
            with pytest.raises(StateError, match="arm: cannot activate: it is in no context"):
                await kernel.activate("arm")
            await kernel.start(ExternalContext(name="loop"), arm)
            await kernel.activate("arm")
            assert [one.state for one in (arm, *parts)] == [ACTIVE, ACTIVE, ACTIVE]
            await kernel.deactivate("left")
            assert [one.state for one in parts] == [INACTIVE, ACTIVE]
            await kernel.deactivate(arm, context="loop")
            assert [one.state for one in parts] == [INACTIVE, INACTIVE]

    simulate(main)


def test_while_the_kernel_closes_what_still_runs_can_be_asked() -> None:
    async def main(clock: SimulatedClock) -> None:
        async def leave() -> None:
            await kernel.deactivate("other")
            at.append(other.state)

        at: list[Any] = []
        async with Kernel() as kernel:
            other, last = await kernel.add(Idle("other")), await kernel.add(Doer("last", deactivated=leave))
            await kernel.start(ExternalContext(), other, activate=True)
            await kernel.start(ExternalContext(), last, activate=True)
        assert at == [INACTIVE]

    simulate(main)


@pytest.mark.anyio
async def test_another_thread_is_refused(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        pid = await kernel.add(Idle("pid0"))
        await kernel.start(EventContext(), pid)
        with pytest.raises(ThreadError, match="activate called from thread"):
            await asyncio.to_thread(lambda: kernel.activate("pid0").send(None))
        await asyncio.to_thread(kernel.call_from_thread, kernel.activate, pid, timeout=5.0)
        assert pid.state is ACTIVE


PUBLIC = {
    *("add_param", "add_port", "alone", "check_configuration", "clock", "configuration", "configurations", "configure"),
    *("context", "contexts", "finish", "has_finished", "kernel", "last_error", "log", "max_instance", "name"),
    *("on_aborting", "on_activated", "on_deactivated", "on_error", "on_execute", "on_finalize", "on_initialize"),
    *(
        "on_link_lost",
        "on_rate_changed",
        "on_reload",
        "on_reset",
        "on_shutdown",
        "on_startup",
        "on_state_update",
        "params",
        "parks",
        "ports",
    ),
    *("ports_for", "profile", "remove_param", "remove_port", "sleep", "state", "states"),
}


def test_every_name_that_a_component_takes_from_its_ports_and_parameters_is_listed_here() -> None:
    """A new one would refuse, or shadow, ports, parameters and methods of the same name in the components there are."""
    assert {name for name in dir(Component) if not name.startswith("_")} == PUBLIC


@pytest.mark.parametrize("kind", ["port", "parameter", "method"])
def test_names_of_the_kernels_requests_are_free_for_ports_parameters_and_methods(kind: str) -> None:
    names = ("activate", "deactivate", "reset", "change", "connect")
    make: dict[str, Callable[[], Any]] = {
        "port": lambda: InPort(TimedLong),
        "parameter": lambda: Param(1),
        "method": lambda: lambda self: 1,
    }

    async def main(clock: SimulatedClock) -> None:
        cls = type("Own", (Component,), {name: make[kind]() for name in names})
        async with Kernel() as kernel:
            own = await kernel.add(cls("own"))
            loop = await kernel.start(ExternalContext(), own)
            await kernel.activate("own")
            await loop.tick()
            assert own.state is ACTIVE
            await kernel.deactivate(own)
            if kind == "port":
                assert sorted(own.ports) == sorted(names)
            elif kind == "parameter":
                await own.configure(reset=2)
                assert [getattr(own, name) for name in names] == [1, 1, 2, 1, 1]
            else:
                assert [getattr(own, name)() for name in names] == [1] * 5

    simulate(main)
