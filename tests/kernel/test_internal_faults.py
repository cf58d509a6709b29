"""What happens when aiorts itself is at fault, or is robbed of what it keeps: said, and no more harm than need be."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Any

import pytest

from aiorts import (
    Component,
    Composite,
    ExternalContext,
    InPort,
    Kernel,
    OutPort,
    PeriodicContext,
    ThreadContext,
)
from aiorts.errors import ComponentError, StateError
from aiorts.kernel.loop import guarded
from aiorts.kernel.loop.bus import ContextStarted, ContextStopped, HookBefore
from aiorts.kernel.ports.transport import Transport
from aiorts.model.lifecycle import HOOKS, LifecycleState
from aiorts.testing.simulation import simulate
from aiorts.types import TimedLong
from hostile import Refused
from kernel_parts import Diary, PlainDiary

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from aiorts import SimulatedClock
    from aiorts.kernel.execution.member import Member

A, E = LifecycleState.ACTIVE, LifecycleState.ERROR


class _Faulty(PeriodicContext):
    """Its own code raises in these cycles."""

    faults: Callable[[int], bool] = staticmethod(lambda cycle: False)

    def _begin_cycle(self) -> Sequence[Member]:
        if self.faults(self.ticks):
            self.ticks += 1
            raise RuntimeError("a mistake of the context's own")
        return super()._begin_cycle()


class _FaultyThread(_Faulty, ThreadContext):
    """The same in a thread."""


KINDS = pytest.mark.parametrize("kind", [_Faulty, _FaultyThread], ids=["loop", "thread"])


@pytest.mark.row(13)
@KINDS
def test_a_context_goes_on_after_a_fault_of_its_own_and_the_run_has_failed(
    kind: type[_Faulty], caplog: pytest.LogCaptureFixture
) -> None:
    async def main(clock: SimulatedClock) -> int:
        async with Kernel() as kernel:
            told: list[Any] = []
            kernel.bus.subscribe(ContextStarted, told.append)
            kernel.bus.subscribe(ContextStopped, told.append)
            parts: list[Any] = [await kernel.add(PlainDiary(name)) for name in ("a", "b")]
            context = kind(100.0)
            context.faults = lambda cycle: cycle in (10, 20, 30)
            await kernel.start(context, *parts, activate=True)
            await clock.advance(1.0)
            assert kernel.exit_status == 1
            assert context.running
            for part in parts:
                assert context.state(part) is A
                assert 90 <= part.count("on_execute") <= 101
                assert part.count("on_startup") == part.count("on_activated") == 1
            assert [type(event) for event in told] == [ContextStarted]
            await context.deactivate(parts[0])
            kernel.request_stop()
            status = await kernel.wait_stop_requested()
        assert parts[1].ran[-3:] == ["on_deactivated", "on_shutdown", "on_finalize"]
        return status

    assert simulate(main) == 1
    lines = [record.getMessage() for record in caplog.records if record.levelno == logging.ERROR]
    assert len(lines) == 3
    assert all("a fault of aiorts itself; it goes on" in line and "please report it" in line for line in lines)


@pytest.mark.row(13)
@KINDS
def test_a_context_that_fails_again_and_again_ends_in_order(kind: type[_Faulty]) -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            told: list[Any] = []
            kernel.bus.subscribe(ContextStopped, told.append)
            part: Any = await kernel.add(PlainDiary("a"))
            other: Any = await kernel.add(PlainDiary("other"))
            context = kind(100.0)
            context.faults = lambda cycle: cycle >= 10
            await kernel.start(context, part, activate=True)
            healthy = await kernel.start(PeriodicContext(100.0), other, activate=True)
            await clock.advance(1.0)
            assert not context.running
            assert part.ran[-2:] == ["on_deactivated", "on_shutdown"]
            assert [event.error for event in told] == ["RuntimeError: a mistake of the context's own"]
            assert healthy.state(other) is A
            assert other.count("on_execute") >= 99
            assert kernel.exit_status == 1

    simulate(main)


class Amnesiac(Diary):
    """Clears its own attributes in one hook, and raises then or not."""

    hook = "on_execute"
    error: BaseException | None = None

    def _forget(self, hook: str) -> None:
        if hook == self.hook:
            vars(self).clear()
            if self.error is not None:
                raise self.error


def _forgetting(hook: str) -> Any:
    return lambda self, *error: self._forget(hook)


for _hook in HOOKS:
    setattr(Amnesiac, _hook, _forgetting(_hook))


@pytest.mark.slow(kept_by="first")
@pytest.mark.row(13)
@pytest.mark.fault("A01")
@pytest.mark.parametrize("watched", [False, True], ids=["", "watched"])
@pytest.mark.parametrize("error", [None, ValueError("lost"), Refused(3)], ids=["returns", "raises", "refuses"])
@pytest.mark.parametrize("kind", [PeriodicContext, ThreadContext])
@pytest.mark.parametrize("hook", HOOKS)
def test_a_component_that_clears_its_own_attributes_harms_nobody_else(
    hook: str, kind: type[PeriodicContext], error: BaseException | None, watched: bool
) -> None:
    amnesiac = type("Forgetful", (Amnesiac,), {name: _forgetting(name) for name in HOOKS} | {"hook": hook})
    amnesiac.error = error  # type: ignore[attr-defined]

    async def main(clock: SimulatedClock) -> None:
        kernel = await Kernel().open()
        if watched:
            kernel.bus.subscribe(HookBefore, lambda event: None)
        first, last = [await kernel.add(PlainDiary(name)) for name in ("first", "last")]
        lost: Component | None = None
        try:
            lost = await kernel.add(amnesiac("lost"))
        except (ValueError, Refused, AttributeError):
            assert hook == "on_initialize"
        parts = [first, *([] if lost is None else [lost]), last]
        context = await kernel.start(kind(100.0), *parts)
        for part in parts:
            try:
                await context.activate(part)
            except Exception:  # the one that it is about
                assert part is lost
        await clock.advance(0.1)
        ran = first.count("on_execute"), last.count("on_execute")
        await clock.advance(1.0)
        assert context.running
        assert (first.count("on_execute") - ran[0], last.count("on_execute") - ran[1]) == (100, 100)
        if lost is not None and hook == "on_execute" and error is not None:
            assert context.state(lost) is E
        await kernel.aclose()
        assert kernel.exit_status == 0
        assert first.ran[-3:] == last.ran[-3:] == ["on_deactivated", "on_shutdown", "on_finalize"]

    simulate(main)


def test_what_the_kernel_keeps_is_there_again_for_whoever_looks() -> None:
    """Its own attributes are gone, and missing them is a failure of its own."""

    class Lost(Component):
        output = OutPort(TimedLong)

        def on_execute(self) -> None:
            if self.context.ticks == 3:
                vars(self).clear()
            self.output.write_nowait(TimedLong(0, 1))

    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            lost = await kernel.add(Lost("lost"))
            context = await kernel.start(PeriodicContext(100.0), lost, activate=True)
            await clock.advance(0.1)
            assert context.state(lost) is lost.state is E
            assert lost.name == "lost"
            assert list(lost.ports) == ["output"]
            assert isinstance(lost.last_error, Exception)
            assert kernel.profile().components["lost"].states
            await kernel.remove(lost)
            assert not kernel.components

    simulate(main)


def test_a_lane_goes_on_beside_one_that_forgot_everything() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            kernel.bus.subscribe(HookBefore, lambda event: None)
            lost = await kernel.add(type("Lost", (Component,), {"on_execute": lambda self: vars(self).clear()})("lost"))
            first, second = [await kernel.add(PlainDiary(name)) for name in ("first", "second")]
            whole = await kernel.add(Composite("whole", lost, first, second, groups="lost,first|second"))
            context = await kernel.start(ExternalContext(), whole, activate=True)
            await context.tick(10)
            assert context.running
            assert first.count("on_execute") == second.count("on_execute") == 10

    simulate(main)


@pytest.mark.fault("A01")
@pytest.mark.parametrize("kind", [PeriodicContext, ThreadContext])
@pytest.mark.parametrize("hook", [hook for hook in HOOKS if hook not in ("on_initialize", "on_finalize")])
def test_a_component_whose_hooks_cannot_be_looked_up_is_the_only_one_in_error(
    hook: str, kind: type[PeriodicContext]
) -> None:
    armed: list[bool] = []

    class Veiled(PlainDiary):  # type: ignore[misc, valid-type]
        def __getattribute__(self, name: str) -> Any:
            if armed and name == hook:
                raise RuntimeError(f"no {name}")
            return super().__getattribute__(name)

    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            first, last = [await kernel.add(PlainDiary(name)) for name in ("first", "last")]
            veiled = await kernel.add(Veiled("veiled"))
            armed.append(True)
            context = await kernel.start(kind(100.0), first, veiled, last)
            await context.activate(first, last)
            try:
                await context.activate(veiled)
            except (ComponentError, StateError):
                assert hook in ("on_startup", "on_activated")
            await clock.advance(0.1)
            ran = first.count("on_execute"), last.count("on_execute")
            await clock.advance(1.0)
            assert (first.count("on_execute") - ran[0], last.count("on_execute") - ran[1]) == (100, 100)
            failing = hook in ("on_startup", "on_activated", "on_execute", "on_state_update")
            assert context.state(veiled) is (E if failing else A)
        assert kernel.exit_status == 0

    simulate(main)


class _Wired(PlainDiary):
    out = OutPort(TimedLong)
    inp = InPort(TimedLong)


@pytest.mark.row(13)
@pytest.mark.parametrize("removed", [False, True], ids=["closed", "removed"])
def test_a_connector_that_cannot_be_ended_keeps_nobody_from_their_end(
    removed: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    right = Transport.close

    def close(transport: Transport) -> None:
        if transport.connector.name == "wire1":
            raise RuntimeError("a mistake of the kernel's own")
        right(transport)

    monkeypatch.setattr(Transport, "close", close)
    # Standard error takes 20 such lines in a second, and the tests before may have written them.
    monkeypatch.setattr(guarded, "_LAST_RESORT", type(guarded._LAST_RESORT)())

    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            parts = [await kernel.add(_Wired(name)) for name in ("a", "b", "c")]
            a, b, c = parts
            ends = [(a, b), (b, c), (b, a)]
            wires = [await kernel.connect(one.out, other.inp, name=f"wire{n}") for n, (one, other) in enumerate(ends)]
            if removed:
                await kernel.remove(b)
                assert list(kernel.components) == ["a", "c"]
                assert [wire.closed for wire in wires] == [True, False, True]
                assert b.ran[-1] == "on_finalize"
        assert [wire.closed for wire in wires] == [True, False, True]
        assert [part.ran[-1] for part in parts] == ["on_finalize"] * 3
        assert kernel.exit_status == 1

    simulate(main)
    assert "wire1: could not be ended: RuntimeError: a mistake of the kernel's own" in capsys.readouterr().err
