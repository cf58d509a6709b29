"""Groups of a composite run side by side within a cycle, which ends when all of them have."""

from __future__ import annotations

import asyncio

import pytest

from aiorts import (
    Component,
    Composite,
    EventContext,
    ExternalContext,
    Kernel,
    LifecycleState,
    PeriodicContext,
    SimulatedClock,
    ThreadContext,
)
from aiorts.composites.parallel import Together
from aiorts.errors import ConfigurationError, HookAbandoned, HookTimeout, StateError
from aiorts.events import HookFailed
from aiorts.kernel.execution.cell import cell
from aiorts.testing.simulation import simulate

pytestmark = pytest.mark.row(30)

I, A, E = LifecycleState.INACTIVE, LifecycleState.ACTIVE, LifecycleState.ERROR  # noqa: E741
Entry = tuple[float, str]


class Waits(Component):
    """Takes its time, and says when it began and ended."""

    def __init__(self, name: str, diary: list[Entry], takes: float) -> None:
        super().__init__(name)
        self.diary, self.takes = diary, takes
        self.fails: BaseException | None = None
        self.running = 0

    def note(self, what: str) -> None:
        self.diary.append((round(self.clock.monotonic_ns() / 1e9, 6), f"{what}{self.name}"))

    async def on_execute(self) -> None:
        assert self.context.members
        self.running += 1
        assert self.running == 1
        self.note("+")
        await self.sleep(self.takes)
        if self.fails is not None:
            self.running -= 1
            raise self.fails
        self.note("-")
        self.running -= 1


class Updates(Waits):
    async def on_state_update(self) -> None:
        self.note("u")


def test_groups_run_side_by_side_and_members_of_a_group_in_turn() -> None:
    async def main(clock: SimulatedClock) -> list[Entry]:
        diary: list[Entry] = []
        async with Kernel() as kernel:
            times = {"a": 0.002, "b": 0.001, "c": 0.002, "d": 0.002}
            members = [Updates(name, diary, takes) for name, takes in times.items()]
            team = await kernel.add(Composite("team", *members, groups="a,b|c,d"))
            before, after = [await kernel.add(Updates(name, diary, 0.001)) for name in ("before", "after")]
            loop = await kernel.start(PeriodicContext(100.0), before, team, after, activate=True)
            assert [one.name for one in loop.members] == ["before", "a", "b", "c", "d", "after"]
            started = clock.monotonic_ns() / 1e9
            await asyncio.sleep(0.0095)
            assert (loop.ticks, team.state, [member.state for member in members]) == (1, A, [A] * 4)
            hooks = loop.statistics.hooks
            assert hooks["a.on_execute"].total_ns == 2_000_000
            assert hooks["b.on_execute"].total_ns == 1_000_000
            assert loop.statistics.overruns == 0
        return [(round((at - started) * 1000), what) for at, what in diary]

    seen = simulate(main)
    assert seen == [
        *[(0, "+before"), (1, "-before")],
        *[(1, "+a"), (1, "+c"), (3, "-a"), (3, "+b"), (3, "-c"), (3, "+d"), (4, "-b"), (5, "-d")],
        *[(5, "+after"), (6, "-after")],
        *[(6, "ubefore"), (6, "ua"), (6, "ub"), (6, "uc"), (6, "ud"), (6, "uafter")],
    ]
    assert seen == simulate(main)


def test_an_error_in_one_group_is_its_own_and_is_blamed_by_name() -> None:
    async def main(clock: SimulatedClock) -> None:
        diary: list[Entry] = []
        async with Kernel() as kernel:
            told: list[str] = []
            kernel.bus.subscribe(HookFailed, lambda event: told.append(f"{event.component}.{event.hook}"))
            a, b, c = (Waits(name, diary, 0.001) for name in "abc")
            team = await kernel.add(Composite("team", a, b, c, groups="a,b|c", errors="isolate"))
            loop = await kernel.start(ExternalContext(), team, activate=True)
            a.fails = asyncio.CancelledError()
            await loop.tick()
            assert (told, a.state, b.state, c.state, team.state) == (["a.on_execute"], E, A, A, A)
            assert [what for _, what in diary] == ["+a", "+c", "+b", "-c", "-b"]
            await loop.tick()
            assert [what for _, what in diary[5:]] == ["+b", "+c", "-b", "-c"]

    simulate(main)


def test_each_hook_has_its_own_deadline_and_one_that_never_ends_is_left_behind() -> None:
    class Deaf(Waits):
        async def on_execute(self) -> None:
            while True:
                try:
                    await self.sleep(3600.0)
                except asyncio.CancelledError:
                    continue

    async def main(clock: SimulatedClock) -> None:
        diary: list[Entry] = []
        async with Kernel() as kernel:
            slow, deaf = Waits("slow", diary, 5.0), Deaf("deaf", diary, 0.0)
            quick, last = Waits("quick", diary, 0.06), Waits("last", diary, 0.06)
            team = Composite("team", slow, deaf, quick, last, groups="slow|deaf|quick,last", errors="isolate")
            await kernel.add(team)
            loop = await kernel.start(ExternalContext(deadline=0.1), team, activate=True)
            await loop.tick()
            assert (slow.state, deaf.state, quick.state, last.state) == (E, E, A, A)
            assert type(slow.last_error) is HookTimeout
            assert type(deaf.last_error) is HookAbandoned
            assert [what for _, what in diary] == ["+slow", "+quick", "-quick", "+last", "-last"]
            await loop.tick()
            assert [what for _, what in diary[5:]] == ["+quick", "-quick", "+last", "-last"]

    simulate(main)


def test_a_stop_while_groups_run_ends_in_time() -> None:
    async def main(clock: SimulatedClock) -> float:
        diary: list[Entry] = []
        async with Kernel() as kernel:
            a, b = Waits("a", diary, 3600.0), Waits("b", diary, 3600.0)
            team = await kernel.add(Composite("team", a, b, groups="a|b"))
            loop = await kernel.start(PeriodicContext(10.0), team, activate=True)
            await asyncio.sleep(0.05)
            before = clock.monotonic_ns()
            await loop.stop()
            return (clock.monotonic_ns() - before) / 1e9

    assert simulate(main) == 2.0


def test_groups_come_and_go_while_running() -> None:
    async def main(clock: SimulatedClock) -> None:
        diary: list[Entry] = []
        async with Kernel() as kernel:
            a, b, c = (Waits(name, diary, 0.001) for name in "abc")
            team = await kernel.add(Composite("team", a, b))
            loop = await kernel.start(ExternalContext(), team, activate=True)

            async def cycle() -> str:
                diary.clear()
                await loop.tick()
                return " ".join(what for _, what in diary)

            assert await cycle() == "+a -a +b -b"
            await team.change(groups="b|a")
            assert await cycle() == "+b +a -b -a"
            await kernel.add(c)
            with pytest.raises(ConfigurationError, match="c: in no group"):
                await team.add_members(c)
            await team.change(members=[a, b, c], groups="c|a,b")
            assert await cycle() == "+c +a -c -a +b -b"
            await team.remove_members(c)
            assert await cycle() == "+a -a +b -b"
            await team.change(groups="")
            assert await cycle() == "+a -a +b -b"
            await team.change(groups="a|b")
            assert await cycle() == "+a +b -a -b"
            await loop.remove(team)
            assert (await cycle(), team.state) == ("", None)
            await loop.add(team)
            await team.activate()
            assert await cycle() == "+a +b -a -b"

    simulate(main)


class Gives(Component):
    """Waits in each cycle until the other has run."""

    gave: asyncio.Event

    async def on_execute(self) -> None:
        self.gave = asyncio.Event()
        await self.gave.wait()


class Frees(Component):
    other: Gives

    async def on_execute(self) -> None:
        await self.sleep(0.001)
        self.other.gave.set()


@pytest.mark.parametrize("where", [(PeriodicContext, "_end_cycle"), (Together, "carry_out")], ids=["cycle", "driver"])
def test_after_a_fault_of_the_kernels_own_groups_still_run_side_by_side(
    where: tuple[type, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            one, two = Gives("one"), Frees("two")
            two.other = one
            team = await kernel.add(Composite("team", one, two, groups="one|two"))
            loop = await kernel.start(PeriodicContext(100.0), team, activate=True)
            await kernel.sleep(0.1)

            owner, method = where
            right, left = getattr(owner, method), 0

            def fault(*args: object) -> object:
                nonlocal left
                if left:
                    left -= 1
                    raise RuntimeError("a mistake of the kernel's own")
                return right(*args)

            monkeypatch.setattr(owner, method, fault)
            for faults in (1, 2, 3):
                left, before = 1, loop.ticks
                await kernel.sleep(1.0)
                assert (left, loop._faults) == (0, faults)
                assert loop.ticks - before >= 98
            assert (kernel.exit_status, one.state, two.state) == (1, A, A)
            left = 1
            await kernel.sleep(0.1)
            assert not loop.running

    simulate(main)


class Busy(Component):
    """Has always something to do."""

    async def on_execute(self) -> None:
        assert isinstance(self.context, EventContext)
        self.context.trigger()


def test_a_stop_of_the_kernel_gets_on_though_the_next_cycle_of_the_groups_is_due() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            one, two = Busy("one"), Busy("two")
            team = await kernel.add(Composite("team", one, two, groups="one|two"))
            loop = await kernel.start(EventContext(), team, activate=True)
            loop.trigger()
            for _ in range(30):
                await asyncio.sleep(0)
            assert loop.ticks > 3
            kernel.request_stop()
            before = loop.ticks
            for _ in range(15):
                await asyncio.sleep(0)
            assert loop.ticks - before <= 1

    simulate(main)


def test_groups_that_cannot_be_are_refused_by_name() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            a, b = Waits("a", [], 0.0), Waits("b", [], 0.0)
            for groups, says in (
                ("a|c,b", "c: no member"),
                ("a", "b: in no group"),
                ("a,b|a", "a: in two places"),
                ("a,b|", "a group is empty"),
            ):
                with pytest.raises(ConfigurationError, match=says):
                    await kernel.add(Composite("team", a if cell(a).kernel is None else "a", b, groups=groups))
                a, b = Waits("a", [], 0.0), Waits("b", [], 0.0)
            team = await kernel.add(Composite("team", a, b, groups=[["a"], ["b"]]))
            with pytest.raises(StateError, match="groups that run side by side, and thread0 runs in one thread"):
                await kernel.start(ThreadContext(), team)
            assert (team.contexts, a.contexts, dict(kernel.contexts)) == ((), (), {})

    simulate(main)
