"""Tasks that a component starts: their failures are the component's, unless it asks for them itself."""

from __future__ import annotations

import asyncio
import gc
from typing import Any

import pytest

import aiorts
from aiorts import Component, ExternalContext, Kernel, PeriodicContext, SimulatedClock
from aiorts.errors import ComponentError
from aiorts.kernel.loop.bus import HookFailed, StateChanged
from aiorts.model.lifecycle import LifecycleState
from aiorts.testing.simulation import simulate


class Spawner(Component):
    """Starts a task that fails 10 ms later."""

    def __init__(self, name: str = "", *, keep: bool = False, nested: bool = False) -> None:
        super().__init__(name)
        self.keep, self.nested = keep, nested
        self.kept: list[Any] = []

    async def _fail(self) -> None:
        await asyncio.sleep(0.01)
        raise ValueError(f"task of {self.name}")

    async def _parent(self) -> None:
        self._spawn(self._fail())
        await asyncio.sleep(0)

    def _spawn(self, coroutine: Any) -> None:
        task = asyncio.get_running_loop().create_task(coroutine)
        if self.keep:
            self.kept.append(task)

    async def on_activated(self) -> None:
        self._spawn(self._parent() if self.nested else self._fail())


@pytest.mark.slow(kept_by="first")
@pytest.mark.fault("A14")
@pytest.mark.row(13)
@pytest.mark.parametrize("keep", [False, True], ids=["dropped", "kept"])
@pytest.mark.parametrize("nested", [False, True], ids=["its own", "its task's"])
def test_failure_of_a_task_is_attributed_within_a_second_a_hundred_times(keep: bool, nested: bool) -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            context = await kernel.start(ExternalContext())
            members = [await kernel.add(Spawner(f"s{n}", keep=keep, nested=nested)) for n in range(100)]
            await context.add(*members)
            await context.activate()
            gc.collect()
            await clock.advance(0.9)
            gc.collect()
            for member in members:
                assert context.state(member) is LifecycleState.ERROR
                assert str(member.last_error) == f"task of {member.name}"
                assert "started by component" in member.last_error.__notes__[0]  # type: ignore[union-attr]

    simulate(main)


@pytest.mark.slow(kept_by="test_task_whose_exception_the_component_asks_for_itself_is_no_error")
@pytest.mark.anyio
@pytest.mark.fault("A14")
async def test_failure_of_a_task_is_attributed_in_real_time_on_both_loops(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        heard: list[HookFailed] = []
        kernel.bus.subscribe(HookFailed, heard.append)
        member = await kernel.add(Spawner("s0", keep=True))
        await kernel.start(PeriodicContext(100.0), member, activate=True)
        await asyncio.sleep(0.9)
        assert [(event.component, event.hook, str(event.error)) for event in heard] == [("s0", "task", "task of s0")]
        assert member.state is LifecycleState.ERROR


class Gatherer(Spawner):
    """Asks for the exceptions of its own tasks, late."""

    async def on_activated(self) -> None:
        return

    async def on_execute(self) -> None:
        tasks = [asyncio.create_task(self._fail()), asyncio.create_task(asyncio.sleep(3.0))]
        results = await asyncio.gather(*tasks, return_exceptions=True)
        assert isinstance(results[0], ValueError)
        late = asyncio.create_task(self._fail())
        await asyncio.sleep(2.0)
        with pytest.raises(ValueError, match="task of"):
            await late
        with pytest.raises(ExceptionGroup):
            await self._in_a_group()
        self.kept.append("done")
        self.finish()

    async def _in_a_group(self) -> None:
        async with asyncio.TaskGroup() as group:
            group.create_task(self._fail())
            group.create_task(asyncio.sleep(5.0))


@pytest.mark.fault("A14")
def test_task_whose_exception_the_component_asks_for_itself_is_no_error() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            member = await kernel.add(Gatherer("g"))
            context = await kernel.start(PeriodicContext(10.0), member, activate=True)
            await clock.advance(10.0)
            assert member.kept == ["done"]
            assert (context.state(member), member.last_error) == (LifecycleState.INACTIVE, None)

    simulate(main)


@pytest.mark.fault("A14")
def test_task_that_failed_just_before_the_close_is_reported_all_the_same() -> None:
    async def main(clock: SimulatedClock) -> Spawner:
        async with Kernel() as kernel:
            member = await kernel.add(Spawner("s0", keep=True))
            await kernel.start(PeriodicContext(10.0), member, activate=True)
            await clock.advance(0.02)
        return member

    assert str(simulate(main).last_error) == "task of s0"


def test_tasks_of_a_component_end_with_it_and_those_of_others_do_not() -> None:
    class Keeper(Component):
        task: asyncio.Task[None]

        async def on_activated(self) -> None:
            self.task = asyncio.create_task(asyncio.sleep(1000))

    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            one, two = await kernel.add(Keeper("one")), await kernel.add(Keeper("two"))
            await kernel.start(PeriodicContext(10.0), one, two, activate=True)
            await kernel.remove(one)
            assert one.task.cancelled()
            assert not two.task.done()
        assert two.task.cancelled()

    simulate(main)


def test_context_started_by_a_hook_is_the_kernels_and_outlives_that_component() -> None:
    class Starter(Component):
        async def on_activated(self) -> None:
            ticker = await self.kernel.add(Ticker("ticker"))
            await self.kernel.start(PeriodicContext(10.0, name="made"), ticker, activate=True)

    class Ticker(Component):
        async def on_execute(self) -> None:
            if self.context.ticks == 3:
                asyncio.get_running_loop().create_task(self._fail())

        async def _fail(self) -> None:
            raise ValueError("the ticker's")

    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            starter = await kernel.add(Starter("starter"))
            await kernel.start(PeriodicContext(10.0), starter, activate=True)
            await kernel.remove(starter)
            await clock.advance(2.0)
            assert kernel.contexts["made"].ticks == 21
            assert str(kernel.components["ticker"].last_error) == "the ticker's"
            assert starter.last_error is None

    simulate(main)


# -- what would end the process from within a task -------------------------------------------------------------------


class Quitter(Component):
    """Starts a task that raises what would end the loop."""

    def __init__(self, name: str, error: BaseException, how: str) -> None:
        super().__init__(name)
        self.error, self.how = error, how
        self.told: list[BaseException] = []

    async def _quit(self) -> None:
        await asyncio.sleep(0.01)
        raise self.error

    async def _swallow(self) -> None:
        """Ends so when it is cancelled."""
        try:
            await asyncio.sleep(10.0)
        except asyncio.CancelledError:
            raise self.error from None

    async def _group(self) -> None:
        async with asyncio.TaskGroup() as group:
            group.create_task(self._quit())

    async def _gather(self) -> None:
        await asyncio.gather(self._quit(), asyncio.sleep(1.0))

    async def on_activated(self) -> None:
        if self.how == "awaited":
            await asyncio.create_task(self._quit())
        elif self.how == "cancelled":
            task = asyncio.create_task(self._swallow())
            await asyncio.sleep(0)
            task.cancel()
        else:
            asyncio.create_task(getattr(self, f"_{self.how}")(), name="quitting")  # noqa: RUF006 - nobody keeps it


def _last(error: BaseException | None) -> BaseException | None:
    """What it all came from."""
    while error is not None:
        inner = error.exceptions[0] if isinstance(error, BaseExceptionGroup) else error.__cause__
        if inner is None:
            return error
        error = inner
    return None


@pytest.mark.fault("A05")
@pytest.mark.row(13)
@pytest.mark.parametrize("how", ["quit", "group", "gather", "awaited", "cancelled"])
@pytest.mark.parametrize("error", [SystemExit(3), KeyboardInterrupt()], ids=lambda error: type(error).__name__)
def test_what_would_end_the_process_is_the_failure_of_the_component_whose_task_it_is(
    how: str, error: BaseException
) -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel(contain_interrupts=True) as kernel:
            quitter, other = await kernel.add(Quitter("quitter", error, how)), await kernel.add(Spawner("other"))
            other._fail = lambda: asyncio.sleep(0)  # type: ignore[method-assign]
            context = await kernel.start(PeriodicContext(100.0), quitter, other)
            await context.activate(other)
            try:
                await context.activate(quitter)
            except ComponentError:
                assert how == "awaited"
            await clock.advance(1.0)
            assert context.state(quitter) is LifecycleState.ERROR
            assert context.state(other) is LifecycleState.ACTIVE
            assert _last(quitter.last_error) is error
            if how in ("quit", "cancelled"):
                assert quitter.last_error is error
                assert "started by component quitter" in error.__notes__[-1]

    simulate(main)


@pytest.mark.fault("A05")
@pytest.mark.parametrize("loop", ["asyncio", "uvloop"])
def test_embedded_an_interrupt_in_a_task_goes_on_once_its_component_is_in_error(loop: str) -> None:
    seen: list[object] = []

    async def main() -> None:
        async with Kernel() as kernel:
            kernel.bus.subscribe(StateChanged, lambda event: seen.append(event.new))
            quitter = await kernel.add(Quitter("quitter", KeyboardInterrupt(), "quit"))
            await kernel.start(ExternalContext(), quitter, activate=True)
            try:
                await asyncio.sleep(5.0)
            finally:
                seen.append("interrupted")

    with pytest.raises(KeyboardInterrupt):
        aiorts.run(main, loop=loop)
    assert seen[: seen.index("interrupted")] == [LifecycleState.ACTIVE, LifecycleState.ERROR]


@pytest.mark.slow(kept_by="test_tasks_of_a_component_end_with_it_and_those_of_others_do_not")
def test_a_component_s_task_shows_and_ends_as_any_other() -> None:
    """Its coroutine is seen in stacks and names; cancelled before it began, it leaves no warning."""

    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            tasks: list[Any] = []

            class Starter(Component):
                async def wait_long(self) -> None:
                    await asyncio.sleep(10.0)

                async def on_activated(self) -> None:
                    tasks.extend(asyncio.create_task(self.wait_long()) for _ in range(2))
                    tasks[1].cancel()
                    await asyncio.sleep(0)

            await kernel.start(ExternalContext(), await kernel.add(Starter("starter")), activate=True)
            assert "wait_long" in repr(tasks[0])
            assert tasks[0].get_stack()[0].f_code.co_name == "wait_long"
            assert tasks[1].cancelled()

    simulate(main)
    gc.collect()
