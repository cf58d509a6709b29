"""Parameters are attributes, assigned by the component's own code alone; its state is that of all its contexts."""

from __future__ import annotations

import asyncio
import re
from typing import Protocol

import pytest

from aiorts import (
    Component,
    Kernel,
    LifecycleState,
    Param,
    PeriodicContext,
    Provided,
    Required,
    ThreadContext,
)
from aiorts.errors import ComponentError, ConfigurationError, DeclarationError
from aiorts.testing import simulated


class Doer(Protocol):
    async def do(self, value: float) -> None: ...


class Own(Component):
    """Assigns its parameter wherever its own code runs."""

    low = high = Param(0.5, ge=0.0, le=1.0)
    doing = Provided[Doer]()
    done = ""

    def on_initialize(self) -> None:
        self.low = 0.1

    async def on_activated(self) -> None:
        await asyncio.create_task(self.work())

    async def work(self) -> None:
        self.high = 0.2

    def on_execute(self) -> None:
        self.low = 7.0  # plain Python, which asks no bounds

    async def do(self, value: float) -> None:
        self.high = value


class Threaded(Component):
    low = Param(0.5)

    def on_execute(self) -> None:
        self.low = 7.0
        self.finish()


class Caller(Component):
    doer = Required[Doer]()

    async def on_execute(self) -> None:
        await self.doer.proxy.do(0.3)
        self.finish()


@simulated
async def test_a_parameter_is_assigned_by_the_components_own_code_wherever_that_runs() -> None:
    async with Kernel() as kernel:
        own = Own()
        own.high = 0.9
        assert (own.low, own.high) == (0.5, 0.9)
        await kernel.add(own)
        assert own.low == 0.1
        await kernel.start(PeriodicContext(rate=10.0), own, activate=True)
        await kernel.sleep(0.15)
        assert (own.low, own.high) == (7.0, 0.2)
        caller = await kernel.create(Caller)
        await kernel.connect(caller.doer, own.doing)
        await kernel.start(PeriodicContext(rate=10.0), caller, activate=True)
        await kernel.sleep(0.3)
        assert own.high == 0.3
        threaded = await kernel.create(Threaded)
        await kernel.start(ThreadContext(rate=10.0), threaded, activate=True)
        await kernel.sleep(0.3)
        assert threaded.low == 7.0


class Meddling(Component):
    other: Own

    def on_execute(self) -> None:
        self.other.low = 0.4


@simulated
async def test_from_outside_it_is_refused_with_the_remedy_and_nothing_has_changed() -> None:
    async with Kernel() as kernel:
        own, meddling = await kernel.create(Own, "pump"), await kernel.create(Meddling)
        meddling.other = own
        said = (
            "pump.low: is not assigned from outside, where nothing checks it and a hook may be using it; "
            "await pump.configure(low=9)"
        )
        with pytest.raises(ConfigurationError, match=f"^{re.escape(said)}$"):
            own.low = 9
        with pytest.raises(ConfigurationError, match=r"await pump.configure\(high=9\)"):
            own.high = 9
        with pytest.raises(ConfigurationError, match=r"await pump.configure\(low=9\)"):
            await asyncio.to_thread(setattr, own, "low", 9)
        assert (own.low, own.configuration.values["low"]) == (0.1, 0.5)
        await kernel.start(PeriodicContext(rate=10.0), meddling, activate=True)
        await kernel.sleep(0.15)
        assert "await pump.configure(low=0.4)" in str(meddling.last_error)
        await own.configure(low=0.4)
        assert (own.low, own.configuration.values["low"]) == (0.4, 0.4)


def test_before_it_is_a_component_it_is_refused_with_what_to_call_first() -> None:
    class Hasty(Component):
        low = Param(0.5)

        def __init__(self, name: str = "") -> None:
            self.low = 0.1
            super().__init__(name)

    said = "Hasty.low: is assigned before super().__init__() has run; call that first"
    with pytest.raises(DeclarationError, match=f"^{re.escape(said)}$"):
        Hasty()


@simulated
async def test_the_state_of_a_component_in_two_contexts_is_that_of_both() -> None:
    """It was that of the first: inactive, while the component executed in the second."""
    async with Kernel() as kernel:
        component = await kernel.create(Meddling)
        component.other = Own()
        first = await kernel.start(PeriodicContext(rate=10.0), component)
        second = await kernel.start(PeriodicContext(rate=10.0), component)
        assert component.state is LifecycleState.INACTIVE
        await second.activate(component)
        assert component.state is LifecycleState.ACTIVE
        await first.activate(component)
        await second.deactivate(component)
        assert component.state is LifecycleState.ACTIVE


class Watched(Protocol):
    async def state_inside(self) -> LifecycleState | None: ...


class Partly(Component):
    """Cannot be active in one of its contexts."""

    watched = Provided[Watched](always=True)

    def on_activated(self) -> None:
        if self.context.name == "refusing":
            raise ValueError("not here")

    async def state_inside(self) -> LifecycleState | None:
        return self.state


class Watching(Component):
    watched = Required[Watched]()


@simulated
async def test_in_a_call_that_it_serves_it_is_in_error_as_outside_and_active_where_it_is_active_in_any() -> None:
    """The call read inactive, the state of the first context, of a component that was in error outside."""
    async with Kernel() as kernel:
        partly, watching = await kernel.create(Partly), await kernel.create(Watching)
        await kernel.connect(watching.watched, partly.watched)
        willing = await kernel.start(PeriodicContext(rate=10.0, name="willing"), partly)
        refusing = await kernel.start(PeriodicContext(rate=10.0, name="refusing"), partly)
        with pytest.raises(ComponentError, match="not here"):
            await refusing.activate(partly)
        assert partly.states == {"willing": LifecycleState.INACTIVE, "refusing": LifecycleState.ERROR}
        assert await watching.watched.proxy.state_inside() is partly.state is LifecycleState.ERROR
        await willing.activate(partly)
        assert await watching.watched.proxy.state_inside() is LifecycleState.ACTIVE
        assert partly.state is LifecycleState.ERROR
