"""What a component keeps when its code is replaced, and what it loses: ports, samples, parameters, states, tasks."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

import pytest

from aiorts import (
    Component,
    EventContext,
    InPort,
    Kernel,
    LifecycleState,
    OutPort,
    Param,
    PeriodicContext,
    ThreadContext,
)
from aiorts.errors import ComponentError
from aiorts.events import ComponentReloaded, PortAdded, PortRemoved, StateChanged, WriterBack, WriterSilent
from aiorts.kernel.ports.connector import unread_of
from aiorts.kernel.ports.in_port import receiver_of
from aiorts.testing import simulated
from aiorts.types import Time, TimedDouble

if TYPE_CHECKING:
    from collections.abc import Callable

    from reload_files import Source

    Make = Callable[[str], Source]

pytestmark = pytest.mark.row(23)
ACTIVE, ERROR, INACTIVE = LifecycleState.ACTIVE, LifecycleState.ERROR, LifecycleState.INACTIVE

SINK = """
class Sink(Component):
    data = InPort(TimedDouble)
    more = InPort(TimedDouble)
    out = OutPort(TimedDouble)
    gain = Param(1.0)
    limit = Param(10)
    name_of = Param("a")
    configurations = {"stiff": {"gain": 5.0}}

    def __init__(self, name=""):
        super().__init__(name)
        self.runs = 0

    def on_execute(self):
        self.runs += 1
"""


class Writer(Component):
    out = OutPort(TimedDouble)


class Reader(Component):
    inp = InPort(TimedDouble)


def sample(number: int) -> TimedDouble:
    return TimedDouble(Time(0, 0), float(number))


@simulated
async def test_unread_samples_and_their_order_stay(source: Make) -> None:
    file = source(SINK)
    async with Kernel() as kernel:
        one, two = await kernel.create(Writer, "one"), await kernel.create(Writer, "two")
        sink = await kernel.create(file.get("Sink"), "sink")
        first = await kernel.connect(one.out, sink.data, length=10)
        second = await kernel.connect(two.out, sink.data, length=10)
        for number in range(6):
            (one, two)[number % 2].out.write_nowait(sample(number))
        await kernel.reload("Sink")
        new: Any = kernel.components["sink"]
        assert new is not sink
        assert new.data.connectors == (first, second)
        one.out.write_nowait(sample(6))
        assert [each.data for each in new.data.drain()] == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
        assert first.statistics.delivered + second.statistics.delivered == 7
        assert first.statistics.dropped == second.statistics.dropped == {}


@simulated
async def test_lifespans_and_gaps_go_on(source: Make) -> None:
    file = source(SINK)
    events: list[str] = []
    async with Kernel() as kernel:
        writer, reader = await kernel.create(Writer, "writer"), await kernel.create(Reader, "reader")
        sink = await kernel.create(file.get("Sink"), "sink")
        into = await kernel.connect(writer.out, sink.data, lifespan=1.0)
        leaving = await kernel.connect(sink.out, reader.inp, max_gap=1.0)
        for kind in (WriterSilent, WriterBack):
            kernel.bus.subscribe(kind, lambda event: events.append(type(event).__name__))
        await kernel.start(EventContext(), sink, activate=True)
        writer.out.write_nowait(sample(0))
        await asyncio.sleep(0.9)
        writer.out.write_nowait(sample(1))
        file.replace("self.runs += 1", "self.runs += 2")
        await kernel.reload("Sink", seconds=0.0)
        new: Any = kernel.components["sink"]
        await asyncio.sleep(0.2)
        assert [each.data for each in new.data.drain()] == [1.0]
        assert into.statistics.dropped == {"expired": 1}
        await asyncio.sleep(2)
        assert (events, leaving.statistics.silent) == (["WriterSilent"], True)
        await kernel.reload("Sink", seconds=0.0)
        kernel.components["sink"].out.write_nowait(sample(2))
        await asyncio.sleep(0.5)
        assert events == ["WriterSilent", "WriterBack"]
        await asyncio.sleep(5)
        assert (events[2:], leaving.statistics.missed_gaps) == (["WriterSilent"], 2)


@simulated
async def test_a_port_that_is_gone_is_disconnected_with_counts_and_a_new_one_announced(source: Make) -> None:
    file = source(SINK)
    events: list[Any] = []
    async with Kernel() as kernel:
        writer, reader = await kernel.create(Writer, "writer"), await kernel.create(Reader, "reader")
        sink = await kernel.create(file.get("Sink"), "sink")
        kept = await kernel.connect(writer.out, sink.data, length=10)
        gone = await kernel.connect(writer.out, sink.more, length=10)
        leaving = await kernel.connect(sink.out, reader.inp, length=10)
        for number in range(3):
            writer.out.write_nowait(sample(number))
            sink.out.write_nowait(sample(number))
        context = await kernel.start(PeriodicContext(rate=100.0), sink, activate=True)
        for number in range(3):
            writer.out.write_nowait(sample(number))
        file.replace(
            "    more = InPort(TimedDouble)\n    out = OutPort(TimedDouble)\n", "    extra = InPort(TimedLong)\n"
        )
        kernel.bus.subscribe(PortAdded, events.append)
        kernel.bus.subscribe(PortRemoved, events.append)
        done = await kernel.reload("Sink")
        new: Any = kernel.components["sink"]
        assert list(new.ports) == ["data", "extra"]
        assert (kept.closed, gone.closed, leaving.closed) == (False, True, True)
        assert unread_of(kept) == 3
        dropped = {one.name: one for one in done.components[0].dropped}
        assert dropped.keys() == {"more", "out"}
        assert (dropped["more"].connectors, dropped["more"].unread) == ((gone.name,), 3)
        assert gone.statistics.dropped["disconnected"] == 3
        assert done.components[0].added == ("extra",)
        assert [(type(one).__name__, one.port.name) for one in events] == [
            ("PortRemoved", "more"),
            ("PortRemoved", "out"),
            ("PortAdded", "extra"),
        ]
        assert context.members == (new,)
        assert receiver_of(new.extra).open


@simulated
async def test_a_port_of_another_type_or_direction_is_another_port(source: Make) -> None:
    file = source(SINK)
    async with Kernel() as kernel:
        writer = await kernel.create(Writer, "writer")
        sink = await kernel.create(file.get("Sink"), "sink")
        connector = await kernel.connect(writer.out, sink.data)
        file.replace("data = InPort(TimedDouble)", "data = InPort(TimedLong)")
        file.replace("out = OutPort(TimedDouble)", "out = InPort(TimedDouble)")
        done = await kernel.reload("Sink")
        new: Any = kernel.components["sink"]
        assert connector.closed
        assert (new.data.type.__name__, new.out.direction) == ("TimedLong", "in")
        assert {one.name for one in done.components[0].dropped} == {"data", "out"}
        assert set(done.components[0].added) == {"data", "out"}


@simulated
async def test_unit_shape_and_text_of_a_port_may_change_where_its_connectors_still_fit(source: Make) -> None:
    file = source(SINK)
    async with Kernel() as kernel:
        writer = await kernel.create(Writer, "writer")
        sink = await kernel.create(file.get("Sink"), "sink")
        await kernel.connect(writer.out, sink.data)
        file.replace("data = InPort(TimedDouble)", "data = InPort(TimedDouble, unit='m', doc='far', max_connectors=1)")
        await kernel.reload("Sink")
        new: Any = kernel.components["sink"]
        assert new.data is sink.data
        assert (new.data.unit, new.data.doc, new.data.max_connectors) == ("m", "far", 1)
        file.replace("self.runs += 1", "raise OSError")
        file.replace("unit='m'", "unit='cm'")
        await kernel.start(PeriodicContext(rate=10.0), new, activate=True)
        with pytest.raises(Exception, match="OSError"):
            await kernel.reload("Sink")
        assert new.data.unit == "m"


@simulated
async def test_parameters_sets_and_the_active_set_stay_where_they_still_exist(source: Make) -> None:
    file = source(SINK)
    async with Kernel() as kernel:
        sink = await kernel.create(file.get("Sink"), "sink", gain=2.0, limit=7, name_of="b")
        await sink.configuration.add("soft", {"gain": 0.5, "limit": 3})
        await sink.add_param("extra", Param(1.5))
        await sink.configuration.change("default", {"extra": 2.5})
        await sink.configuration.activate("stiff")
        file.replace("limit = Param(10)", "limit = Param(2, le=5)")
        file.replace('    name_of = Param("a")\n', "    fresh = Param(True)\n")
        done = await kernel.reload("Sink")
        new: Any = kernel.components["sink"]
        assert new.configuration.active == "stiff"
        assert dict(new.configuration.values) == {"gain": 5.0, "limit": 2, "fresh": True, "extra": 2.5}
        assert dict(new.configuration.sets["soft"]) == {"gain": 0.5, "limit": 3}
        assert (new.gain, new.limit, new.fresh, new.extra) == (5.0, 2, True, 2.5)
        lost = {one.name: one.why for one in done.components[0].dropped}
        assert lost.keys() == {"limit", "name_of"}
        assert "7" in lost["limit"]
        assert {"gain", "extra"} <= set(done.components[0].kept)


@simulated
async def test_what_is_configured_while_new_code_is_made_ready_or_proves_itself_stays(source: Make) -> None:
    file = source(SINK)
    async with Kernel() as kernel:
        sink = await kernel.create(file.get("Sink"), "sink")
        await kernel.start(PeriodicContext(rate=100.0), sink, activate=True)
        file.replace(
            "    def on_execute",
            "    async def on_initialize(self):\n        await self.sleep(1)\n\n    def on_execute",
        )
        file.replace("self.runs += 1", "self.runs += 1\n        if self.runs > 50: 1 / 0")
        reload = asyncio.ensure_future(kernel.reload("Sink", cycles=100, seconds=10))
        await kernel.sleep(0.5)
        await sink.configure(limit=4)
        await kernel.sleep(0.7)
        new: Any = kernel.components["sink"]
        assert (new is sink, new.limit) == (False, 4)
        await new.configure(limit=5)
        with pytest.raises(Exception, match="ZeroDivision"):
            await reload
        assert kernel.components["sink"] is sink
        assert sink.limit == 5


@simulated
async def test_life_cycle_state_stays_and_no_transition_hook_runs(source: Make) -> None:
    file = source("""
    class Part(Component):
        def __init__(self, name=""):
            super().__init__(name)
            self.ran = []
            self.bad = False

        async def on_initialize(self): self.ran.append("initialize")
        async def on_startup(self): self.ran.append("startup")
        async def on_shutdown(self): self.ran.append("shutdown")
        async def on_activated(self): self.ran.append("activated")
        async def on_deactivated(self): self.ran.append("deactivated")
        async def on_aborting(self, error): self.ran.append("aborting")
        async def on_reset(self): self.ran.append("reset")
        async def on_finalize(self): self.ran.append("finalize")
        async def on_reload(self, old):
            await self.sleep(0.001)
            self.ran.append(f"reload {old.name}")

        async def on_execute(self):
            if self.bad: raise ValueError
    """)
    async with Kernel() as kernel:
        kind = file.get("Part")
        parts = [await kernel.create(kind, name) for name in ("a", "b", "c", "d")]
        context = await kernel.start(PeriodicContext(rate=100.0), *parts[:3])
        await context.activate(parts[0], parts[1])
        parts[1].bad = True
        await kernel.sleep(0.1)
        failure = parts[1].last_error
        await kernel.reload(kind)
        new: list[Any] = list(kernel.components.values())
        assert [one.state for one in new] == [ACTIVE, ERROR, INACTIVE, None]
        assert [one.ran for one in new] == [["initialize", f"reload {name}"] for name in "abcd"]
        assert [one.ran[-1] for one in parts] == ["finalize"] * 4
        assert [one.ran.count("deactivated") for one in parts] == [0, 1, 0, 0]
        assert new[1].last_error is failure
        assert context.members == tuple(new[:3])
        await context.reset(new[1])
        assert new[1].ran[-1] == "reset"


@pytest.mark.parametrize("waits", [False, True])
def test_tasks_of_the_old_code_are_ended_and_reported(waits: bool, source: Make) -> None:
    @simulated
    async def run() -> None:
        file = source("""
        class Tasked(Component):
            data = InPort(TimedDouble)

            def __init__(self, name=""):
                super().__init__(name)
                self.got = []

            def on_activated(self):
                self.begin()

            def begin(self):
                self.task = asyncio.get_running_loop().create_task(self.work(), name="work")

            def on_reload(self, old):
                self.got = old.got
                self.begin()
                # reload

            async def work(self):
                async for sample in self.data:
                    self.got.append(sample.data)
        """)
        async with Kernel() as kernel:
            if waits:
                file.replace("def on_reload", "async def on_reload")
                file.replace("# reload", "await self.sleep(0.05)")
            writer = await kernel.create(Writer, "writer")
            old = await kernel.create(file.get("Tasked"), "tasked")
            connector = await kernel.connect(writer.out, old.data, length=1000)
            await kernel.start(PeriodicContext(rate=100.0), old, activate=True)
            reload = None
            for number in range(100):
                writer.out.write_nowait(sample(number))
                await kernel.sleep(0.003)
                if number == 30:
                    reload = asyncio.ensure_future(kernel.reload("Tasked"))
            assert reload is not None
            done = await reload
            new: Any = kernel.components["tasked"]
            assert [(one.what, one.name) for one in done.components[0].dropped] == [("task", "work")]
            assert old.task.cancelled()
            assert not new.task.done()
            assert new.got == [float(number) for number in range(100)]
            assert connector.statistics.dropped == {}

    run()


@simulated
async def test_what_was_added_at_run_time_stays(source: Make) -> None:
    file = source(SINK)
    async with Kernel() as kernel:
        writer = await kernel.create(Writer, "writer")
        sink = await kernel.create(file.get("Sink"), "sink")
        added = sink.add_port("added", InPort(TimedDouble))
        connector = await kernel.connect(writer.out, added)
        await kernel.reload("Sink")
        assert kernel.components["sink"].ports["added"] is added
        assert not connector.closed


@simulated
async def test_ports_asked_for_by_parameters_stay(source: Make) -> None:
    file = source("""
    class Group(Component):
        count = Param(2)

        def ports_for(self, values):
            return {f"in{n}": InPort(TimedDouble) for n in range(values["count"])}
    """)
    async with Kernel() as kernel:
        writer = await kernel.create(Writer, "writer")
        group = await kernel.create(file.get("Group"), "group", count=3)
        connector = await kernel.connect(writer.out, group.ports["in2"])
        file.replace('values["count"])', 'values["count"] + 1)')
        await kernel.reload("Group")
        new = kernel.components["group"]
        assert list(new.ports) == ["in0", "in1", "in2", "in3"]
        assert new.ports["in2"].connectors == (connector,)
        await new.configure(count=0)
        assert connector.closed


@simulated
async def test_a_writer_that_waits_for_room_goes_on_waiting_and_gets_it(source: Make) -> None:
    file = source(SINK)
    async with Kernel() as kernel:
        writer = await kernel.create(Writer, "writer")
        sink = await kernel.create(file.get("Sink"), "sink")
        connector = await kernel.connect(writer.out, sink.data, length=1, full="block")
        writer.out.write_nowait(sample(0))
        waiting = asyncio.ensure_future(writer.out.write(sample(1)))
        await kernel.sleep(0.1)
        await kernel.reload("Sink")
        assert not waiting.done()
        assert (await kernel.components["sink"].data.read()).data == 0.0  # type: ignore[attr-defined]
        await waiting
        assert unread_of(connector) == 1


@pytest.mark.slow(kept_by="reload/test_whole.py::test_all_of_a_context_change_in_the_same_moment")
@pytest.mark.anyio
async def test_in_a_thread_the_code_changes_at_the_border_of_a_cycle(source: Make) -> None:
    file = source("""
    import threading, time

    class Threaded(Component):
        out = OutPort(TimedDouble)

        def __init__(self, name=""):
            super().__init__(name)
            self.runs = 0
            self.inside = False
            self.seen = None

        def on_execute(self):
            self.inside = True
            self.runs += 1
            time.sleep(0.002)
            self.out.write_blocking(TimedDouble(Time(0, 0), float(self.runs)))
            self.inside = False

        def on_reload(self, old):
            self.seen = old.inside, threading.get_ident()
            self.runs = old.runs
    """)
    async with Kernel() as kernel:
        reader = await kernel.create(Reader, "reader")
        old = await kernel.create(file.get("Threaded"), "threaded")
        connector = await kernel.connect(old.out, reader.inp, length=100_000)
        context = await kernel.start(ThreadContext(rate=200.0), old, activate=True)
        thread = context.runner.driver.thread.ident  # type: ignore[union-attr]
        for _ in range(3):
            await asyncio.sleep(0.05)
            before: Any = kernel.components["threaded"]
            done = await kernel.reload("Threaded", cycles=3)
            new: Any = kernel.components["threaded"]
            assert isinstance(done.components[0], ComponentReloaded)
            assert new.seen == (False, thread)
            assert new.runs > before.runs
        await context.stop()
        counts = connector.statistics
        assert [each.data for each in reader.inp.drain()] == [float(n) for n in range(1, counts.written + 1)]
        assert counts.dropped == {}
        file.replace("self.runs += 1", "raise ValueError('bad')")
        await kernel.start(context, new, activate=True)
        with pytest.raises(Exception, match="ValueError: bad"):
            await kernel.reload("Threaded", cycles=3)
        await asyncio.sleep(0.1)
        assert kernel.components["threaded"] is new
        assert context.state(new) is ACTIVE
        assert new.runs > counts.written


@simulated
async def test_in_an_event_context_unread_data_is_still_a_cause_to_run(source: Make) -> None:
    file = source("""
    class Sink(Component):
        data = InPort(TimedDouble)
        other = InPort(TimedDouble)
        def on_execute(self):
            self.data.read_nowait()
            self.log.debug("old")
    """)
    async with Kernel() as kernel:
        writer = await kernel.create(Writer, "writer")
        sink = await kernel.create(file.get("Sink"), "sink")
        connector = await kernel.connect(writer.out, sink.data, length=100)
        context = await kernel.start(EventContext(), sink, activate=True)
        for number in range(40):
            writer.out.write_nowait(sample(number))
            if number == 10:
                task = asyncio.ensure_future(kernel.reload("Sink"))
            await asyncio.sleep(0)
        await task
        await kernel.sleep(0.1)
        assert unread_of(connector) == 0
        assert context.ticks == 40


@simulated
async def test_data_that_came_while_its_port_was_gone_wakes_the_old_code_that_is_back(source: Make) -> None:
    file = source("""
    class Sink(Component):
        data = InPort(TimedDouble)
        other = InPort(TimedDouble)

        def __init__(self, name=""):
            super().__init__(name)
            self.got = []

        def on_execute(self):
            self.got += [sample.data for sample in self.data.drain()]
    """)
    async with Kernel() as kernel:
        one, two = await kernel.create(Writer, "one"), await kernel.create(Writer, "two")
        sink = await kernel.create(file.get("Sink"), "sink")
        connector = await kernel.connect(one.out, sink.data, length=10)
        await kernel.connect(two.out, sink.other)
        await kernel.start(EventContext(), sink, activate=True)
        file.replace("    data = InPort(TimedDouble)\n", "")
        reload = asyncio.ensure_future(kernel.reload("Sink", seconds=10.0))
        await kernel.sleep(1.0)
        assert kernel.components["sink"] is not sink
        one.out.write_nowait(sample(7))
        await kernel.sleep(1.0)
        two.out.write_nowait(sample(8))
        with pytest.raises(Exception, match="has no attribute 'data'"):
            await reload
        await kernel.sleep(0.1)
        assert sink.got == [7.0]
        assert connector.statistics.dropped == {}


class Metres(Component):
    out = OutPort(TimedDouble, unit="m")


@simulated
async def test_connectors_that_fit_no_more_end_with_counts(source: Make) -> None:
    file = source(SINK)
    async with Kernel() as kernel:
        metres = await kernel.create(Metres, "metres")
        sink = await kernel.create(file.get("Sink"), "sink")
        connector = await kernel.connect(metres.out, sink.data, length=10)
        metres.out.write_nowait(sample(1))
        file.replace("data = InPort(TimedDouble)", "data = InPort(TimedDouble, unit='mm')")
        done = await kernel.reload("Sink")
        (dropped,) = done.components[0].dropped
        assert (dropped.name, dropped.connectors, dropped.unread) == ("data", (connector.name,), 1)
        assert connector.statistics.dropped == {"disconnected": 1}
        assert kernel.components["sink"].ports["data"].unit == "mm"


@pytest.mark.parametrize("hook", ["on_initialize(self)", "on_reload(self, old)"])
def test_tasks_of_new_code_that_is_taken_back_are_ended(hook: str, source: Make) -> None:
    @simulated
    async def run() -> None:
        file = source(SINK)
        async with Kernel() as kernel:
            sink = await kernel.create(file.get("Sink"), "sink")
            await kernel.start(PeriodicContext(rate=100.0), sink, activate=True)
            begin = "asyncio.get_running_loop().create_task(asyncio.Event().wait(), name='endless')"
            file.replace("    def on_execute", f"    def {hook}:\n        {begin}\n\n    def on_execute")
            file.replace("self.runs += 1", "1 / 0")
            with pytest.raises(Exception, match="ZeroDivisionError"):
                await kernel.reload("Sink")
            assert not kernel.registry.tasks
            assert [task for task in asyncio.all_tasks() if task.get_name() == "endless"] == []

    run()


@simulated
async def test_a_task_of_the_old_code_that_fails_when_it_is_ended_is_not_the_new_ones_fault(source: Make) -> None:
    file = source("""
    class Tasked(Component):
        def on_activated(self):
            self.task = asyncio.get_running_loop().create_task(self.work())

        async def work(self):
            try:
                await asyncio.Event().wait()
            finally:
                raise OSError
    """)
    async with Kernel() as kernel:
        old = await kernel.create(file.get("Tasked"), "tasked")
        await kernel.start(PeriodicContext(rate=100.0), old, activate=True)
        await kernel.sleep(0.1)
        await kernel.reload("Tasked", cycles=200, seconds=5.0)
        assert kernel.components["tasked"] is not old
        assert kernel.components["tasked"].state is ACTIVE


TASKED = """
class Tasked(Component):
    data = InPort(TimedDouble)

    def __init__(self, name=""):
        super().__init__(name)
        self.got = []
        self.told = []
        self.task = None

    def on_activated(self):
        self.told.append("activated")
        # activated
        self.task = asyncio.get_running_loop().create_task(self.work(), name="work")

    async def on_deactivated(self):
        self.told.append("deactivated")
        self.task.cancel()
        await asyncio.wait([self.task])

    async def work(self):
        async for sample in self.data:
            self.got.append(sample.data)

    async def on_reload(self, old):
        await self.sleep(0.05)
        # reload

    def on_execute(self):
        pass  # execute
"""


@pytest.mark.parametrize("fault", ["# reload", "# execute"])
def test_tasks_of_old_code_that_comes_back_are_started_anew_and_no_sample_is_lost(fault: str, source: Make) -> None:
    @simulated
    async def run() -> None:
        file = source(TASKED)
        states: list[StateChanged] = []
        async with Kernel() as kernel:
            writer = await kernel.create(Writer, "writer")
            old = await kernel.create(file.get("Tasked"), "tasked")
            idle = await kernel.create(file.get("Tasked"), "idle")
            connector = await kernel.connect(writer.out, old.data, length=1000)
            context = await kernel.start(PeriodicContext(rate=100.0), old, activate=True)
            kernel.bus.subscribe(StateChanged, states.append)
            file.replace(fault, "\n        1 / 0")
            file.replace('self.told.append("deactivated")', "raise ValueError(3)")
            reload = asyncio.ensure_future(kernel.reload("Tasked"))
            for number in range(300):
                writer.out.write_nowait(sample(number))
                await kernel.sleep(0.01)
            with pytest.raises(ComponentError, match="these tasks of tasked had been ended: work; on_deact") as told:
                await reload
            assert "idle" not in str(told.value)
            assert kernel.components["tasked"] is old
            assert old.told == ["activated", "deactivated", "activated"]
            assert idle.told == []
            assert not old.task.done()
            assert old.got == [float(number) for number in range(300)]
            assert connector.statistics.dropped == {}
            assert context.state(old) is ACTIVE
            assert states == []

    run()


@simulated
async def test_old_code_that_cannot_start_anew_is_in_error(source: Make) -> None:
    file = source(TASKED.replace("# activated", "assert self.told == ['activated']"))
    async with Kernel() as kernel:
        old = await kernel.create(file.get("Tasked"), "tasked")
        context = await kernel.start(PeriodicContext(rate=100.0), old, activate=True)
        file.replace("# reload", "1 / 0")
        with pytest.raises(ComponentError, match="had been ended: work"):
            await kernel.reload("Tasked")
        await kernel.sleep(0.1)
        assert context.state(old) is ERROR
        assert isinstance(old.last_error, AssertionError)


@pytest.mark.slow(kept_by="test_tasks_of_old_code_that_comes_back_are_started_anew_and_no_sample_is_lost")
@pytest.mark.anyio
async def test_in_a_thread_no_sample_is_refused_between_a_failure_and_the_return_of_the_old_code(source: Make) -> None:
    file = source("""
    import time

    class Threaded(Component):
        data = InPort(TimedDouble)
        fails = Param(False)

        def __init__(self, name=""):
            super().__init__(name)
            self.got = []

        def on_execute(self):
            if self.fails:
                raise ValueError("asked for")
            # execute
            self.got += [sample.data for sample in self.data.drain()]

        def on_aborting(self, error):
            time.sleep(0.1)
    """)
    async with Kernel() as kernel:
        writer = await kernel.create(Writer, "writer")
        old = await kernel.create(file.get("Threaded"), "threaded")
        connector = await kernel.connect(writer.out, old.data, length=100_000)
        context = await kernel.start(ThreadContext(rate=200.0), old, activate=True)
        file.replace("# execute", "raise ValueError('bad')")
        reload = asyncio.ensure_future(kernel.reload("Threaded"))
        number = 0
        while not reload.done():
            writer.out.write_nowait(sample(number))
            number += 1
            await asyncio.sleep(0.001)
        with pytest.raises(ComponentError, match="ValueError: bad"):
            await reload
        for _ in range(500):
            if len(old.got) == number:
                break
            await asyncio.sleep(0.01)
        assert old.got == [float(each) for each in range(number)]
        assert connector.statistics.dropped == {}
        file.replace("raise ValueError('bad')", "pass")
        for _ in range(2):  # later failures have it refuse as ever, of the old code and of new code that has stayed
            component: Any = kernel.components["threaded"]
            await component.configure(fails=True)
            for _ in range(500):
                if context.state(component) is ERROR:
                    break
                await asyncio.sleep(0.01)
            await asyncio.sleep(0.02)
            refused = connector.statistics.dropped.get("inactive", 0)
            writer.out.write_nowait(sample(number))
            assert connector.statistics.dropped["inactive"] == refused + 1
            await component.configure(fails=False)
            await context.reset(component)
            await context.activate(component)
            await kernel.reload("Threaded")
