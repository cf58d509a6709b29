"""Reloads at awkward moments: long hooks, other reloads, a kernel that closes, callers that give up, who goes."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Any

import pytest

from aiorts import Component, Kernel, LifecycleState, PeriodicContext, RealtimeContext, Supervision
from aiorts.errors import (
    AbsentError,
    AiortsError,
    ClosedError,
    ComponentError,
    HookTimeout,
    PluginError,
    StateError,
    TransitionTimeout,
)
from aiorts.events import ComponentReloaded
from aiorts.kernel.configuring import put_parameters
from aiorts.kernel.execution.cell import cell
from aiorts.planning import Setting
from aiorts.testing import simulated

if TYPE_CHECKING:
    from collections.abc import Callable

    from reload_files import Source

    Make = Callable[[str], Source]

pytestmark = pytest.mark.row(23)
ACTIVE = LifecycleState.ACTIVE

SLOW = """
class Slow(Component):
    pause = Param(0.0)
    version = 1
    finalized = 0

    def __init__(self, name=""):
        super().__init__(name)
        self.ran = []
        self.mark = {"inside": False}
        self.ends = 0

    async def on_initialize(self):
        await self.sleep(0.05)

    async def on_execute(self):
        assert not self.mark["inside"]
        self.mark["inside"] = True
        try:
            await self.sleep(self.pause)
            # execute
        finally:
            self.mark["inside"] = False
        self.ran.append(self.clock.monotonic_ns())

    async def on_finalize(self):
        await self.sleep(0.02)
        self.ends += 1

    async def on_reload(self, old):
        self.mark = old.mark
        assert not self.mark["inside"]
        self.ran_before = len(old.ran)
        await self.sleep(0.05)
"""
NEW = ("version = 1", "version = 2")


@simulated
async def test_a_hook_that_runs_for_long_is_waited_for(source: Make) -> None:
    file = source(SLOW)
    async with Kernel() as kernel:
        old = await kernel.create(file.get("Slow"), "slow", pause=3.0)
        context = await kernel.start(PeriodicContext(rate=10.0), old, activate=True)
        await kernel.sleep(1.0)
        file.replace(*NEW)
        await kernel.reload("Slow", timeout=5.0)
        new: Any = kernel.components["slow"]
        assert (new.version, len(old.ran)) == (2, 1)
        assert context.members == (new,)


@simulated
async def test_a_hook_that_runs_for_too_long_leaves_all_as_it_was_for_good(source: Make) -> None:
    file = source(SLOW)
    async with Kernel() as kernel:
        old = await kernel.create(file.get("Slow"), "slow", pause=20.0)
        free = await kernel.create(file.get("Slow"), "free", pause=0.001)
        await kernel.start(PeriodicContext(rate=10.0), old, activate=True)
        other = await kernel.start(PeriodicContext(rate=10.0), free, activate=True)
        await kernel.sleep(1.0)
        file.replace(*NEW)
        with pytest.raises(TransitionTimeout, match="slow in periodic0"):
            await kernel.reload("Slow", timeout=5.0)
        assert dict(kernel.components) == {"slow": old, "free": free}
        await kernel.sleep(60.0)
        assert dict(kernel.components) == {"slow": old, "free": free}
        assert (other.members, free.state, old.state) == ((free,), ACTIVE, ACTIVE)
        await old.configure(pause=0.0)
        await kernel.reload("Slow", timeout=30.0)
        assert kernel.components["free"].version == 2  # type: ignore[attr-defined]


@simulated
async def test_one_reload_at_a_time(source: Make) -> None:
    file = source(SLOW)
    async with Kernel() as kernel:
        old = await kernel.create(file.get("Slow"), "slow")
        await kernel.start(PeriodicContext(rate=100.0), old, activate=True)
        tasks = [asyncio.ensure_future(kernel.reload(file.get("Slow"))) for _ in range(3)]
        events = [(await task).components[0] for task in tasks]
        assert [(one.old, one.new) for one in events] == [(0, 1), (1, 2), (2, 3)]
        assert all(type(one) is ComponentReloaded for one in events)


@pytest.mark.parametrize("after", [0.0, 0.01, 0.049, 0.06, 0.1, 0.15, 0.3])
@pytest.mark.parametrize("what", ["close", "remove", "stop", "cancel", "deactivate"])
def test_anything_else_in_the_midst_of_a_reload(what: str, after: float, source: Make) -> None:
    @simulated
    async def run() -> None:
        file = source(SLOW)
        kernel = await Kernel().open()
        old = await kernel.create(file.get("Slow"), "slow")
        spare = await kernel.create(file.get("Slow"), "spare")
        context = await kernel.start(PeriodicContext(rate=100.0), old, activate=True)
        await kernel.sleep(0.1)
        file.replace(*NEW)
        reload = asyncio.ensure_future(kernel.reload("Slow", cycles=20))
        await kernel.sleep(after)
        here: Any = kernel.components["slow"]
        outcome: Any = None
        if what == "close":
            await kernel.aclose()
            assert not kernel.registry.renewing
        elif what == "remove":
            await kernel.remove(here)
        elif what == "stop":
            await context.stop()
        elif what == "deactivate":
            await context.deactivate()
        else:
            reload.cancel()
        try:
            outcome = await reload
        except (AiortsError, asyncio.CancelledError) as error:
            outcome = error
        for _ in range(3):
            await asyncio.sleep(0)
        if what == "close":
            assert isinstance(outcome, ClosedError | StateError | AiortsError)
        else:
            await kernel.sleep(2.0)
            versions = {name: one.version for name, one in kernel.components.items()}  # type: ignore[attr-defined]
            assert len(set(versions.values())) == 1, versions
            if what == "remove":
                assert list(kernel.components) == ["spare"]
            else:
                assert list(kernel.components) == ["slow", "spare"]
            if what == "cancel":
                assert isinstance(outcome, asyncio.CancelledError)
                assert versions["slow"] == 2
            if what == "deactivate":
                assert kernel.components["slow"].state is LifecycleState.INACTIVE
            if not isinstance(outcome, Exception | asyncio.CancelledError):
                assert versions["spare"] == 2
        assert not kernel.registry.renewing
        assert not kernel.registry.tasks
        await kernel.aclose()
        assert (old.ends, spare.ends) == (1, 1)

    run()


@pytest.mark.slow
@simulated
async def test_a_component_in_two_contexts_changes_in_both_at_once(source: Make) -> None:
    file = source(SLOW)
    async with Kernel() as kernel:
        old = await kernel.create(file.get("Slow"), "slow", pause=0.007)
        one = await kernel.start(PeriodicContext(rate=100.0), old, activate=True)
        two = await kernel.start(PeriodicContext(rate=70.0), old, activate=True)
        await kernel.sleep(0.1)
        file.replace(*NEW)
        for good in (True, False, True):
            before: Any = kernel.components["slow"]
            text = file.path.read_text(encoding="utf-8")
            if good:
                await kernel.reload("Slow")
            else:
                file.replace("# execute", "1 / 0")
                with pytest.raises(ComponentError, match="ZeroDivisionError"):
                    await kernel.reload("Slow")
                file.path.write_text(text, encoding="utf-8")
            now: Any = kernel.components["slow"]
            assert (now is before) is not good
            assert "AssertionError" not in repr(now.last_error)
            assert one.members == two.members == (now,)
            assert (one.state(now), two.state(now)) == (ACTIVE, ACTIVE)
            count, ran = len(now.ran), len(old.ran)
            await kernel.sleep(1.0)
            assert len(now.ran) > count + 60
            assert len(old.ran) == ran
            assert not cell(before).members or before is now


@simulated
async def test_hooks_that_wait_at_the_gate_run_the_code_of_the_day(source: Make) -> None:
    file = source(SLOW)
    async with Kernel() as kernel:
        old = await kernel.create(file.get("Slow"), "slow", pause=0.2)
        contexts = [await kernel.start(PeriodicContext(rate=10.0), old, activate=True) for _ in range(3)]
        await kernel.sleep(0.05)
        await kernel.reload("Slow")
        assert len(old.ran) == kernel.components["slow"].ran_before  # type: ignore[attr-defined]
        assert len({context.members for context in contexts}) == 1


@simulated
async def test_in_a_real_time_context_it_is_refused_with_the_reason(source: Make) -> None:
    file = source("class Plain(Component):\n    def on_execute(self): pass\n")
    async with Kernel() as kernel:
        plain = await kernel.create(file.get("Plain"), "plain")
        await kernel.start(RealtimeContext(rate=100.0), plain, activate=True)
        with pytest.raises(StateError, match="plain: cannot be reloaded: is in a real-time context"):
            await kernel.reload("Plain")
        assert kernel.components["plain"] is plain


@simulated
async def test_a_hook_cannot_reload_what_would_have_to_wait_for_it(source: Make) -> None:
    file = source("""
    class Selfish(Component):
        error = None
        async def on_execute(self):
            try:
                await self.kernel.reload("Selfish")
            except aiorts.AiortsError as error:
                self.error = error
            self.finish()
    """)
    async with Kernel() as kernel:
        selfish = await kernel.create(file.get("Selfish"), "selfish")
        await kernel.start(PeriodicContext(rate=100.0), selfish, activate=True)
        await kernel.sleep(0.1)
        assert isinstance(selfish.error, StateError)
        assert "call it from" in str(selfish.error)


STUBBORN = """while True:
            try:
                await asyncio.Event().wait()
            except asyncio.CancelledError:
                pass"""


@pytest.mark.parametrize("runs", [True, False])
@pytest.mark.parametrize("body", ["await asyncio.Event().wait()", STUBBORN])
def test_a_hand_over_that_never_ends_is_cancelled_and_taken_back(body: str, runs: bool, source: Make) -> None:
    @simulated
    async def run() -> None:
        file = source(SLOW)
        async with Kernel() as kernel:
            old = await kernel.create(file.get("Slow"), "slow")
            context = PeriodicContext(rate=100.0)
            if runs:
                await kernel.start(context, old, activate=True)
            await kernel.sleep(0.1)
            file.replace("self.ran_before = len(old.ran)", body)
            with pytest.raises(ComponentError, match="on_reload") as raised:
                await kernel.reload("Slow", timeout=1.0)
            assert isinstance(raised.value.__cause__, HookTimeout)
            if not runs:
                await kernel.start(context, old, activate=True)
            ran = len(old.ran)
            await kernel.sleep(1.0)
            assert context.members == (old,)
            assert len(old.ran) >= ran + 99

    run()


@pytest.mark.parametrize("ignores", [False, True])
@simulated
async def test_an_on_initialize_that_never_returns_keeps_nobody_from_reloading(ignores: bool, source: Make) -> None:
    file, other = source(SLOW), source(SLOW.replace("Slow", "Other"))
    async with Kernel() as kernel:
        old = await kernel.create(file.get("Slow"), "slow")
        one = await kernel.create(other.get("Other"), "other")
        await kernel.start(PeriodicContext(rate=10.0), old, one, activate=True)
        hangs = "await self.sleep(1e6)"
        if ignores:
            hangs = "while True:\n            try:\n                await self.sleep(1e6)\n"
            hangs += "            except BaseException:\n                pass"
        file.replace("await self.sleep(0.05)\n\n    async def on_execute", hangs + "\n\n    async def on_execute")
        began = kernel.clock.monotonic_ns()
        with pytest.raises(PluginError, match="slow: on_initialize of the new code raised Hook"):
            await kernel.reload("Slow", timeout=2.0)
        assert 2e9 <= kernel.clock.monotonic_ns() - began < 5e9
        assert kernel.components["slow"] is old
        other.replace(*NEW)
        await kernel.reload("Other")
        assert kernel.components["other"].version == 2  # type: ignore[attr-defined]
        file.write(SLOW.replace(*NEW))
        await kernel.reload("Slow")
        assert kernel.components["slow"].version == 2  # type: ignore[attr-defined]


@pytest.mark.slow
@simulated
async def test_a_file_that_never_ends_is_left_behind(source: Make) -> None:
    file = source(SLOW)
    async with Kernel() as kernel:
        old: Any = await kernel.create(file.get("Slow"), "slow")
        file.path.write_text("import sys, time\nwhile not hasattr(sys, '_stop_that_file'): time.sleep(0.01)\n")
        import sys

        try:
            with pytest.raises(PluginError, match=r"reloaded_.*\.py: still being run after 0.2 s; it was abandoned"):
                await kernel.reload("Slow", import_timeout=0.2)
            assert kernel.components["slow"] is old
        finally:
            sys._stop_that_file = True  # type: ignore[attr-defined]
            import threading

            for thread in threading.enumerate():
                if thread.name.startswith("aiorts reload"):
                    thread.join()
            del sys._stop_that_file  # type: ignore[attr-defined]
        assert [name for name in sys.modules if name.startswith(f"{file.name}__")] == []


@simulated
async def test_two_types_of_one_file_are_reloaded_one_by_one(source: Make) -> None:
    file = source("""
    class One(Component):
        version = 1

    class Two(One):
        pass
    """)
    async with Kernel() as kernel:
        one = await kernel.create(file.get("One"), "one")
        two = await kernel.create(file.get("Two"), "two")
        file.replace(*NEW)
        await kernel.reload(f"{file.name}.py:One")
        assert kernel.components["one"].version == 2  # type: ignore[attr-defined]
        assert kernel.components["two"] is two
        assert (await kernel.create(file.get("Two"), "three")).version == 2
        with pytest.raises(PluginError, match=r"may be each of .*:One, .*:Two"):
            await kernel.reload(f"{file.name}.py")
        await kernel.reload(type(one))
        await kernel.reload(type(two))
        assert {each.version for each in kernel.components.values()} == {2}  # type: ignore[attr-defined]


@simulated
async def test_a_supervised_component_stays_supervised(source: Make) -> None:
    file = source(SLOW)
    async with Kernel() as kernel:
        old = await kernel.create(file.get("Slow"), "slow")
        watched = kernel.supervise(old, Supervision(restart="restart", deadlines={"on_execute": 0.5}))
        context = await kernel.start(PeriodicContext(rate=100.0), old, activate=True)
        await kernel.sleep(0.1)
        file.replace(*NEW)
        await kernel.reload("Slow")
        new: Any = kernel.components["slow"]
        assert watched.component is new
        await new.configure(pause=1.0)
        await kernel.sleep(3.0)
        again: Any = kernel.components["slow"]
        assert again is not new
        assert again.version == 2
        assert context.members == (again,)


@pytest.mark.parametrize("good", [True, False])
@simulated
async def test_a_supervised_restart_makes_the_code_of_the_day_whatever_sets_it_up(good: bool, source: Make) -> None:
    file = source(SLOW)

    def set_up(name: str, *, kind: type[Component], pause: float) -> Component:
        made = kind(name)
        put_parameters(made, {"pause": pause})
        return made

    async with Kernel() as kernel:
        cls = file.get("Slow")
        factories: dict[str, Any] = {
            "class": cls,
            "arguments": partial(Setting({"pause": 0.5}).make, cls),
            "nested": partial(partial(set_up, pause=0.5), kind=cls),
            "itself": partial(cls),
        }
        for name, factory in factories.items():
            component = await kernel.create(cls, name)
            kernel.supervise(component, Supervision("restart", backoff=0.1), factory=factory)
        context = await kernel.start(PeriodicContext(rate=10.0), *kernel.components.values(), activate=True)
        for number in (2, 3):
            file.write(SLOW.replace("version = 1", f"version = {number}"))
            if good:
                await kernel.reload("Slow")
            else:
                file.replace("# execute", "1 / 0")
                with pytest.raises(ComponentError):
                    await kernel.reload("Slow")
        for member in tuple(context.runner.members):
            context.runner.life.task_failed(member, ValueError("failed"))
        await kernel.sleep(5.0)
        versions = {name: one.version for name, one in kernel.components.items()}  # type: ignore[attr-defined]
        assert versions == dict.fromkeys(factories, 3 if good else 1)
        assert {one.state for one in kernel.components.values()} == {ACTIVE}
        assert kernel.components["arguments"].pause == 0.0  # type: ignore[attr-defined]


@simulated
async def test_a_record_type_of_the_file_itself_is_refused_where_it_is_connected(source: Make) -> None:
    file = source("""
    from dataclasses import dataclass

    @dataclass(frozen=True)
    class Pose:
        x: float

    class Mover(Component):
        out = OutPort(Pose)
        inp = InPort(Pose)
    """)
    async with Kernel() as kernel:
        mover = await kernel.create(file.get("Mover"), "mover")
        connector = await kernel.connect(mover.out, mover.inp)
        with pytest.raises(PluginError, match="Pose is a record type of the reloaded file itself"):
            await kernel.reload("Mover")
        assert not connector.closed
        await kernel.disconnect(connector)
        await kernel.reload("Mover")


@simulated
async def test_what_is_meant_is_said_clearly(source: Make) -> None:
    class Local(Component):
        pass

    file = source(SLOW)
    async with Kernel() as kernel:
        for kind in ("Nobody", "no.py:Slow", file.get("Slow")):
            with pytest.raises(AbsentError, match="no component of that type; there are no components"):
                await kernel.reload(kind)
        await kernel.create(file.get("Slow"), "slow")
        with pytest.raises(AbsentError, match="there are Slow"):
            await kernel.reload("Fast")
        await kernel.create(Local, "local")
        with pytest.raises(PluginError, match="is made by a function"):
            await kernel.reload(Local)
        with pytest.raises(PluginError, match="expected a component class"):
            await kernel.reload(3)  # type: ignore[arg-type]
        with pytest.raises(AiortsError, match="cycles = -1"):
            await kernel.reload("Slow", cycles=-1)
    with pytest.raises(ClosedError):
        await kernel.reload("Slow")


@simulated
async def test_what_follows_from_a_failure_ends_when_the_code_that_failed_is_taken_back(source: Make) -> None:
    file = source("""
    class Shared(Component):
        def __init__(self, name=""):
            super().__init__(name)
            self.told = []
            self.notes = []

        def on_reload(self, old):
            self.notes = old.notes

        async def on_execute(self):
            pass  # execute

        async def on_deactivated(self):
            self.notes.append("begun")
            await self.sleep(0.05)
            self.notes.append("ended")

        def on_aborting(self, error):
            self.told.append(error)
    """)
    async with Kernel() as kernel:
        old = await kernel.create(file.get("Shared"), "shared")
        first = await kernel.start(PeriodicContext(rate=100.0), old, activate=True)
        second = await kernel.start(PeriodicContext(rate=100.0), old, activate=True)
        await kernel.sleep(0.1)
        file.replace("pass  # execute", f"if self.context.name == {second.name!r}: 1 / 0")
        with pytest.raises(ComponentError, match="ZeroDivisionError"):
            await kernel.reload("Shared")
        assert old.notes == ["begun", "ended"]
        await kernel.sleep(1.0)
        assert old.told == []
        assert (first.state(old), second.state(old)) == (ACTIVE, ACTIVE)
        ticks = second.ticks
        await kernel.sleep(0.1)
        assert second.ticks >= ticks + 9


SINGLE = """
class Single(Component):
    version = 1
    runs = 0

    def __init__(self, name=""):
        super().__init__(name)
        self.ends = 0

    def on_activated(self):
        self.task = asyncio.get_running_loop().create_task(self.sleep(1e6))

    async def on_execute(self):
        self.runs += 1
        assert not self.ends
        # execute

    def on_finalize(self):
        self.ends += 1
"""


@pytest.mark.parametrize("then", ["returns", "removed", "closed", "stopped"])
def test_where_a_hook_of_the_new_code_runs_on_each_instance_is_ended_once_and_only_after_it(
    then: str, source: Make
) -> None:
    file, made = source(SINGLE), []

    @simulated
    async def run() -> None:
        async with Kernel() as kernel:
            olds = [await kernel.create(file.get("Single"), name) for name in ("a", "b")]
            contexts = [await kernel.start(PeriodicContext(rate=50.0), old, activate=True) for old in olds]
            made.extend(olds)
            await kernel.sleep(0.1)
            file.replace(*NEW)
            file.replace("# execute", "await self.sleep(30.0 if self.name == 'a' else 0.1); assert self.name == 'a'")
            with pytest.raises(ComponentError, match=r"b.on_execute .*but a still runs the new code") as raised:
                await kernel.reload("Single", seconds=5.0)
            assert "b still" not in str(raised.value)
            late: Any = kernel.components["a"]
            made.append(late)
            assert (late.version, kernel.components["b"]) == (2, olds[1])
            assert [one.ends for one in made] == [0, 0, 0]
            with pytest.raises(StateError, match="a: cannot be reloaded: its code was taken back"):
                await kernel.reload(file.get("Single"))
            if then == "removed":
                with suppress(AiortsError):
                    await kernel.remove(late)
            elif then == "stopped":
                await contexts[0].stop()
            elif then == "returns":
                await kernel.sleep(40.0)
                assert kernel.components["a"] is olds[0]
                assert [old.task.done() for old in olds] == [False, False]
                runs = olds[0].runs
                await kernel.sleep(1.0)
                assert olds[0].runs >= runs + 45
                assert [one.ends for one in made] == [0, 0, 1]
                file.write(SINGLE.replace(*NEW))
                await kernel.reload("Single")
                assert [one.ends for one in made] == [1, 1, 1]
                made.extend(kernel.components.values())

    run()
    assert [one.ends for one in made] == [1] * len(made)


@simulated
async def test_who_holds_an_old_instance_is_told_where_the_new_one_is(source: Make) -> None:
    file = source(SINGLE)
    async with Kernel() as kernel:
        old = await kernel.create(file.get("Single"), "a")
        context = await kernel.start(PeriodicContext(rate=50.0), old, activate=True)
        await kernel.reload("Single")
        other = await kernel.start(PeriodicContext(rate=50.0))
        for refused in (kernel.remove(old), other.add(old)):
            with pytest.raises(StateError, match=r"a: another instance has its place; take kernel.components\['a'\]"):
                await refused
        assert context.members == (kernel.components["a"],)
