"""Real-time contexts: cycles in a thread that waits for deadlines only, its hooks, its privileges, its end."""

from __future__ import annotations

import asyncio
import gc
import logging
import os
import subprocess
import sys
import textwrap
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from aiorts import Component, InPort, Kernel, LifecycleState, OutPort, Param, RealtimeContext, SimulatedClock
from aiorts.contexts.schedule import Schedule
from aiorts.errors import ConfigurationError, HookAbandoned, StateError
from aiorts.kernel.loop.handed_log import HandedLogger
from aiorts.realtime.process import ProcessSettings
from aiorts.testing import check_context, simulate
from aiorts.types import TimedLong
from contexts.parts import MS, Idle, S

pytestmark = pytest.mark.anyio


class Worker(Component):
    """Does what it is told in every execution; notes when and in which thread it ran."""

    def __init__(self, name: str = "", execute: Callable[[], None] | None = None) -> None:
        super().__init__(name)
        self.execute = execute
        self.begun: list[int] = []
        self.threads: set[int] = set()

    async def on_execute(self) -> None:
        self.begun.append(self.clock.monotonic_ns())
        self.threads.add(threading.get_ident())
        if self.execute is not None:
            self.execute()


async def until(done: Callable[[], bool], seconds: float = 5.0) -> None:
    end = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < end, "it did not happen in time"
        await asyncio.sleep(0.002)


def void(_: object) -> None:
    """Forget a result: a hook returns nothing."""


def run_python(code: str, timeout: float = 30.0) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)], capture_output=True, text=True, timeout=timeout, check=False
    )


# -- cycles ------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.row(9)
def test_it_keeps_every_promise_of_an_execution_context() -> None:
    check_context(lambda: RealtimeContext(100.0))


def test_in_virtual_time_it_ticks_at_exact_moments_and_asks_for_nothing() -> None:
    async def main(clock: SimulatedClock) -> tuple[list[int], RealtimeContext]:
        async with Kernel() as kernel:
            worker = await kernel.add(Worker("worker"))
            context = await kernel.start(RealtimeContext(100.0, priority=99, cpus=[0]), worker, activate=True)
            assert gc.isenabled()
            assert (context.granted.priority, context.granted.locked) == (None, False)
            assert dict(context.granted.denied) == {}
            await asyncio.sleep(0.995)
            assert len(worker.threads) == 1
            assert threading.get_ident() not in worker.threads
            return worker.begun, context

    begun, context = simulate(main)
    assert begun == [n * 10 * MS for n in range(100)]
    assert context.statistics.lateness_max_ns == 0


@pytest.mark.slow(kept_by="first")
@pytest.mark.row(9)
@pytest.mark.row(31)
async def test_it_runs_at_its_rate_in_one_thread_with_the_priority_and_processor_asked_for() -> None:
    seen: set[tuple[int, int, frozenset[int]]] = set()
    cpu = max(os.sched_getaffinity(0))

    def look() -> None:
        policy = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
        seen.add((policy, os.sched_getparam(0).sched_priority, frozenset(os.sched_getaffinity(0))))

    async with Kernel() as kernel:
        worker = await kernel.add(Worker("worker", look))
        context = await kernel.start(RealtimeContext(500.0, priority=7, cpus=[cpu]), worker, activate=True)
        await asyncio.sleep(0.5)
        granted, statistics = context.granted, context.statistics
    assert 200 <= statistics.cycles + statistics.skipped <= 300
    assert len(worker.threads) == 1
    assert granted.cpus == {cpu}
    if granted.priority is None:  # not allowed here: said so
        assert "ulimit -r" in granted.denied["priority"]
    else:
        assert seen == {(os.SCHED_FIFO, 7, frozenset({cpu}))}
    assert os.sched_getscheduler(0) == os.SCHED_OTHER  # nobody else's thread
    assert len(os.sched_getaffinity(0)) >= 1


@pytest.mark.slow
async def test_granted_names_the_processors_that_there_are_and_which_ones_are_missing() -> None:
    cpu = max(os.sched_getaffinity(0))
    async with Kernel() as kernel:
        context = await kernel.start(RealtimeContext(100.0, priority=None, lock_memory=False, cpus=[cpu, 4000]))
        granted = context.granted
    assert granted.cpus == {cpu}
    assert granted.denied == {"cpus": f"cpus [4000]: not there for this process; it keeps to [{cpu}]"}


@pytest.mark.slow(kept_by="test_it_runs_at_its_rate_in_one_thread_with_the_priority_and_processor_asked_for")
async def test_it_wakes_close_to_its_deadlines() -> None:
    async with Kernel() as kernel:
        worker = await kernel.add(Worker("worker"))
        context = await kernel.start(RealtimeContext(500.0, spin=True), worker, activate=True)
        await asyncio.sleep(1.0)
    statistics = context.statistics
    assert statistics.cycles > 300
    late = sorted(b - a for a, b in zip(worker.begun, worker.begun[1:], strict=False))
    assert abs(late[len(late) // 2] - 2 * MS) < 1 * MS


@pytest.mark.slow(kept_by="test_a_deadline_shorter_than_the_period_counts_and_skips_nothing")
async def test_a_cycle_over_its_deadline_is_an_overrun_though_it_is_done_within_the_period() -> None:
    async with Kernel() as kernel:
        worker = await kernel.add(Worker("worker", lambda: time.sleep(0.012)))
        context = await kernel.start(RealtimeContext(20.0, deadline=0.01), worker, activate=True)
        await until(lambda: context.statistics.cycles >= 5)
        statistics = context.statistics
    assert statistics.overruns >= 3


def test_a_deadline_shorter_than_the_period_counts_and_skips_nothing() -> None:
    plan = Schedule(10.0)
    plan.deadline_ns = 20 * MS
    plan.start(0)
    for tick, takes in enumerate((10 * MS, 20 * MS, 21 * MS, 10 * MS)):
        plan.begin(tick * 100 * MS)
        plan.end(tick * 100 * MS + takes)
    plan.begin(400 * MS)
    assert (plan.overruns, plan.skipped) == (1, 0)


@pytest.mark.slow(kept_by="execution/test_fairness.py::test_missing_most_deadlines_is_said_once")
async def test_one_that_is_always_late_lets_the_loop_and_others_run() -> None:
    def burn() -> None:
        end = time.monotonic() + 0.003
        while time.monotonic() < end:
            pass

    # On one processor with the loop, which has no priority.
    processors = os.sched_getaffinity(0)
    turns = 0
    try:
        os.sched_setaffinity(0, {min(processors)})
        async with Kernel() as kernel:
            worker = await kernel.add(Worker("worker", burn))
            wanted = RealtimeContext(1000.0, cpus=[min(processors)])
            context = await kernel.start(wanted, worker, activate=True)
            end = time.monotonic() + 0.5
            while time.monotonic() < end:
                await asyncio.sleep(0)
                turns += 1
            statistics = context.statistics
    finally:
        os.sched_setaffinity(0, processors)
    assert turns > 10
    assert statistics.overruns > 10
    assert statistics.skipped > statistics.cycles


@pytest.mark.slow(kept_by="first")
async def test_a_request_wakes_a_thread_that_sleeps_for_long() -> None:
    async with Kernel() as kernel:
        worker = await kernel.add(Worker("worker"))
        context = await kernel.start(RealtimeContext(0.01), worker, activate=True)
        await until(lambda: bool(worker.begun))
        began = time.monotonic()
        for _ in range(40):
            await context.deactivate(worker)
            await context.activate(worker)
        assert time.monotonic() - began < 2.0  # a slice of sleep for each would be 4 s


@pytest.mark.slow(kept_by="test_a_request_wakes_a_thread_that_sleeps_for_long")
@pytest.mark.parametrize("rate", [0.01, 10.0, 200.0])
async def test_requests_and_a_stop_reach_a_thread_that_sleeps(rate: float) -> None:
    async with Kernel() as kernel:
        worker = await kernel.add(Worker("worker"))
        context = await kernel.start(RealtimeContext(rate), worker)
        await asyncio.sleep(0.05)
        began = time.monotonic()
        await context.activate(worker)
        await context.set_rate(rate / 2)
        await context.deactivate(worker)
        await context.stop()
        assert time.monotonic() - began < 1.0


# -- hooks -------------------------------------------------------------------------------------------------------------


class Relay(Component):
    """Awaits its ports, as any component would."""

    inp = InPort(TimedLong)
    out = OutPort(TimedLong)
    gain = Param(1)

    async def on_execute(self) -> None:
        while self.inp.is_new:
            sample = await self.inp.read()
            await self.out.write(TimedLong(sample.tm, sample.data * self.gain))


@pytest.mark.slow(kept_by="ports/test_in_port.py::test_awaited_reads_and_writes_give_the_loop_a_turn_within_256_calls")
async def test_awaited_reads_and_writes_work_in_any_number_without_a_turn_of_the_loop() -> None:
    async with Kernel() as kernel:
        relay, idle = await kernel.add(Relay("relay")), await kernel.add(Ends("ends"))
        await kernel.connect(idle.out, relay.inp, length=2000)
        await kernel.connect(relay.out, idle.inp, length=2000)
        await kernel.start(RealtimeContext(100.0), relay, activate=True)
        for number in range(1000):
            idle.out.write_nowait(TimedLong(0, number))
        got = [(await asyncio.wait_for(idle.inp.read(), 5.0)).data for _ in range(1000)]
        assert got == list(range(1000))
        assert relay.last_error is None


class Ends(Component):
    """In no context: ports for the test itself."""

    inp = InPort(TimedLong)
    out = OutPort(TimedLong)


@pytest.mark.slow(kept_by="first")
async def test_a_hook_that_suspends_is_an_error_that_names_it_and_says_what_to_do() -> None:
    closed = threading.Event()

    class Sleeper(Component):
        async def on_execute(self) -> None:
            try:
                await asyncio.sleep(0)
            finally:
                closed.set()

    async with Kernel() as kernel:
        sleeper, worker = await kernel.add(Sleeper("sleeper")), await kernel.add(Worker("worker"))
        context = await kernel.start(RealtimeContext(200.0), sleeper, worker, activate=True)
        await until(lambda: context.state(sleeper) is LifecycleState.ERROR)
        assert isinstance(sleeper.last_error, StateError)
        text = str(sleeper.last_error)
        assert "sleeper.on_execute: suspended" in text
        assert f"{Path(__file__).name}:" in text
        assert "periodic context" in text
        assert closed.is_set()
        before = len(worker.begun)
        await until(lambda: len(worker.begun) > before)


@pytest.mark.slow(kept_by="kernel/test_declarations.py::test_returned_value_is_an_error_at_the_first_call")
async def test_a_plain_hook_that_returns_something_and_an_async_one_are_told_as_everywhere() -> None:
    class Returns(Component):
        async def on_execute(self) -> Any:
            return 1

    async with Kernel() as kernel:
        returns = await kernel.add(Returns("returns"))
        context = await kernel.start(RealtimeContext(200.0), returns, activate=True)
        await until(lambda: context.state(returns) is LifecycleState.ERROR)
        assert "returned int 1" in str(returns.last_error)


@pytest.mark.slow(kept_by="contexts/test_thread.py::test_members_rate_and_parameters_change_while_the_thread_runs")
async def test_members_come_and_go_parameters_change_and_a_source_finishes() -> None:
    class Source(Component):
        def on_execute(self) -> None:
            self.finish()

    async with Kernel() as kernel:
        one, two, source = (
            await kernel.add(Relay("one")),
            await kernel.add(Worker("two")),
            await kernel.add(Source("source")),
        )
        context = await kernel.start(RealtimeContext(200.0), one, activate=True)
        await one.configure(gain=3)
        assert one.gain == 3
        await context.add(two, source)
        await context.activate(two, source)
        await until(lambda: len(two.begun) > 2 and context.state(source) is LifecycleState.INACTIVE)
        await context.remove(two)
        assert context.members == (one, source)
        runs = len(two.begun)
        await asyncio.sleep(0.03)
        assert len(two.begun) == runs
        with pytest.raises(StateError, match="is in no other"):
            await kernel.start(RealtimeContext(10.0), one)


@pytest.mark.slow(kept_by="first")
async def test_a_failure_is_contained_and_logged_on_the_loop(caplog: pytest.LogCaptureFixture) -> None:
    threads: list[int] = []

    class Note(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            threads.append(threading.get_ident())

    def fail() -> None:
        worker.log.warning("about to fail %s", "now")
        raise ValueError("no")

    handler = Note()
    logging.getLogger("aiorts.component").addHandler(handler)
    try:
        async with Kernel() as kernel:
            worker, other = await kernel.add(Worker("worker", fail)), await kernel.add(Worker("other"))
            context = await kernel.start(RealtimeContext(200.0), worker, other, activate=True)
            await until(lambda: context.state(worker) is LifecycleState.ERROR and len(other.begun) > 3)
            await context.reset(worker)
            await asyncio.sleep(0.01)
    finally:
        logging.getLogger("aiorts.component").removeHandler(handler)
    texts = [record.getMessage() for record in caplog.records if record.name == "aiorts.component"]
    assert texts[0] == "about to fail now"
    assert texts[1].startswith("worker.on_execute failed: ValueError: no (")
    assert len(texts) == 2
    record = next(r for r in caplog.records if r.name == "aiorts.component")
    assert (record.funcName, record.__dict__["hook"]) == ("fail", "on_execute")
    assert set(threads) == {threading.get_ident()}  # no handler's I/O in the real-time thread


def test_a_line_is_rendered_when_it_is_logged_and_a_bad_template_is_left_to_the_handler() -> None:
    records: list[logging.LogRecord] = []
    later: list[Callable[[], object]] = []
    real = logging.Logger("real")
    handler = logging.Handler()
    handler.emit = records.append  # type: ignore[method-assign]
    real.addHandler(handler)
    log = HandedLogger(real, later.append)
    values = [1]
    log.warning("values %s", values)
    log.warning("%s %s", 1)
    values.append(2)
    assert records == []
    for callback in later:
        callback()
    assert [(record.msg, record.args) for record in records] == [("values [1]", None), ("%s %s", (1,))]


@pytest.mark.slow(
    kept_by="supervision/test_blocking_hooks.py::test_one_that_was_left_behind_and_returns_after_all_finds_its_context_gone_on"
)
def test_a_hook_that_never_returns_is_left_behind_and_settings_are_restored() -> None:
    release = threading.Event()

    async def main() -> None:
        async with Kernel() as kernel:
            stuck = await kernel.add(Worker("stuck", lambda: void(release.wait())))
            await kernel.start(RealtimeContext(100.0), stuck, activate=True)
            await until(lambda: bool(stuck.begun))
        assert isinstance(stuck.last_error, HookAbandoned)
        assert gc.isenabled()

    began = time.monotonic()
    try:
        asyncio.run(main())
        assert time.monotonic() - began <= 6.0
    finally:
        release.set()


# -- the process -------------------------------------------------------------------------------------------------------


@pytest.mark.slow(kept_by="test_what_the_user_changed_meanwhile_stays")
async def test_collector_and_switch_interval_are_restored_after_the_last_context() -> None:
    gc.unfreeze()  # CPython 3.12 has frozen a few hundred objects of its own
    before = (gc.isenabled(), gc.get_freeze_count(), sys.getswitchinterval())
    async with Kernel() as kernel:
        one = await kernel.start(RealtimeContext(100.0), await kernel.add(Idle("one")))
        assert (gc.isenabled(), one.granted.collector) == (False, True)
        assert gc.get_freeze_count() > 2000
        assert sys.getswitchinterval() == pytest.approx(100e-6)
        two = await kernel.start(RealtimeContext(100.0), await kernel.add(Idle("two")))
        await one.stop()
        assert not gc.isenabled()
        assert sys.getswitchinterval() == pytest.approx(100e-6)
        await two.stop()
        assert (gc.isenabled(), gc.get_freeze_count(), sys.getswitchinterval()) == before


@pytest.mark.slow(kept_by="test_what_the_user_changed_meanwhile_stays")
async def test_what_a_host_has_frozen_stays_frozen() -> None:
    gc.collect()
    gc.freeze()
    try:
        before = gc.get_freeze_count()
        assert before > 2000
        async with Kernel() as kernel:
            context = await kernel.start(RealtimeContext(100.0), await kernel.add(Idle("one")))
            await context.stop()
        assert before * 0.9 < gc.get_freeze_count() <= before
        assert gc.isenabled()
    finally:
        gc.unfreeze()


async def test_what_the_user_changed_meanwhile_stays() -> None:
    before = sys.getswitchinterval()
    try:
        async with Kernel() as kernel:
            gc.disable()
            context = await kernel.start(RealtimeContext(100.0), await kernel.add(Idle("one")))
            assert not context.granted.collector
            sys.setswitchinterval(0.002)
            await context.stop()
            assert sys.getswitchinterval() == pytest.approx(0.002)
            assert not gc.isenabled()
    finally:
        gc.enable()
        sys.setswitchinterval(before)


@pytest.mark.slow(kept_by="test_garbage_is_collected_when_there_is_slack_or_when_it_is_long_overdue")
async def test_memory_stays_flat_though_automatic_collection_is_off() -> None:
    alive = 0

    class Cycle:
        def __init__(self) -> None:
            nonlocal alive
            alive += 1
            self.me = self

        def __del__(self) -> None:
            nonlocal alive
            alive -= 1

    def litter() -> None:
        for _ in range(200):
            Cycle()

    highest = 0
    async with Kernel() as kernel:
        worker = await kernel.add(Worker("worker", litter))
        await kernel.start(RealtimeContext(500.0), worker, activate=True)
        while len(worker.begun) < 400:  # which make 80,000
            await asyncio.sleep(0.01)
            highest = max(highest, alive)
    # On a busy machine a collection may seem to cost more than there is slack: then it waits for 20 times the
    # threshold, which is 700, and 2,000 since 3.13.
    assert highest < 20 * gc.get_threshold()[0] + 2_000


def test_garbage_is_collected_when_there_is_slack_or_when_it_is_long_overdue(monkeypatch: Any) -> None:
    settings, ran = ProcessSettings(), list[int]()
    counts = [0, 0, 0]
    monkeypatch.setattr(gc, "get_count", lambda: tuple(counts))
    monkeypatch.setattr(gc, "get_threshold", lambda: (700, 10, 10))
    monkeypatch.setattr(gc, "collect", ran.append)
    for state, slack, expected in (
        ([700, 0, 0], S, []),
        ([701, 0, 0], S, [0]),
        ([701, 11, 0], S, [1]),
        ([701, 11, 11], S, [2]),
        ([701, 0, 0], 1000, []),
        ([14_021, 0, 0], 1000, [0]),
    ):
        ran.clear()
        counts[:] = state
        settings.collect(slack)
        assert ran == expected, (state, slack)


UNPRIVILEGED = """
    import asyncio, ctypes, logging, os, queue, resource, sys, anyio._backends._asyncio
    resource.setrlimit(resource.RLIMIT_MEMLOCK, (65536, 65536))
    resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
    from aiorts import *
    import aiorts.diagnostics.deadline_monitor  # the first start would, and who has no rights may not read it
    if os.getuid() == 0:
        os.setgid(65534); os.setuid(65534)
    logging.basicConfig(format="%(name)s %(levelname)s %(message)s")
    class C(Component):
        def on_execute(self): pass
    async def main():
        async with Kernel() as kernel:
            c = await kernel.create(C)
            context = await kernel.start(RealtimeContext(200.0, name="servo", cpus=[4000]), c, activate=True)
            await asyncio.sleep(0.3)
            print(context.granted.priority, context.granted.cpus, context.granted.locked,
                  context.granted.collector, context.statistics.cycles > 20, sorted(context.granted.denied))
    asyncio.run(main())
"""


@pytest.mark.slow(kept_by="test_it_runs_at_its_rate_in_one_thread_with_the_priority_and_processor_asked_for")
@pytest.mark.skipif(sys.platform != "linux", reason="privileges of Linux")
@pytest.mark.row(31)
def test_what_privileges_deny_is_said_once_with_what_to_do_and_it_runs_all_the_same() -> None:
    done = run_python(UNPRIVILEGED)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "None None False True True ['cpus', 'memory lock', 'priority']"
    lines = [line for line in done.stderr.splitlines() if "aiorts.kernel" in line]
    assert len(lines) == 1
    assert lines[0].startswith("aiorts.kernel WARNING servo: ")
    for words in ("ulimit -r", "CAP_SYS_NICE", "ulimit -l", "CAP_IPC_LOCK", "cpus [4000]"):
        assert words in lines[0]


@pytest.mark.slow
def test_a_process_that_forgets_its_context_ends() -> None:
    done = run_python(
        """
        import asyncio
        from aiorts import *
        class C(Component):
            def on_execute(self): pass
        async def main():
            kernel = await Kernel().open()
            c = await kernel.create(C)
            await kernel.start(RealtimeContext(1000.0), c, activate=True)
            await asyncio.sleep(0.1)
        asyncio.run(main())
        """
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.slow(
    kept_by="contexts/test_schedule.py::test_a_tick_that_begins_when_newer_ones_are_due_gives_way_to_the_newest"
)
@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_after_a_process_was_stopped_and_goes_on_there_is_no_burst_of_ticks() -> None:
    done = run_python(
        """
        import asyncio, os, signal, subprocess, time
        from aiorts import *
        begun = []
        class C(Component):
            def on_execute(self): begun.append(time.monotonic())
        async def main():
            async with Kernel() as kernel:
                c = await kernel.create(C)
                context = await kernel.start(RealtimeContext(20.0), c, activate=True)
                await asyncio.sleep(0.2)
                waker = subprocess.Popen(["sh", "-c", f"sleep 0.8; kill -CONT {os.getpid()}"])
                os.kill(os.getpid(), signal.SIGSTOP)
                await asyncio.sleep(0.3)
                waker.wait()
                gaps = [b - a for a, b in zip(begun, begun[1:])]
                resumed = begun[gaps.index(max(gaps)) + 1]
                first = sum(resumed <= moment < resumed + 0.049 for moment in begun)
                print(max(gaps) > 0.5, first <= 2, context.statistics.skipped >= 9)
        asyncio.run(main())
        """
    )
    assert done.stdout.split() == ["True", "True", "True"], done.stderr


@pytest.mark.slow(kept_by="test_arguments_out_of_range_are_refused_by_name")
def test_a_system_file_says_what_it_asks_for(tmp_path: Path) -> None:
    (tmp_path / "source.py").write_text(
        "from aiorts import Component, OutPort\n"
        "class Source(Component):\n"
        "    out = OutPort(float)\n"
        "    def on_execute(self):\n"
        "        if self.context.ticks == 100:\n"
        "            print(self.context.kind, self.context.rate, self.context.deadline)\n"
        "            self.finish()\n"
    )
    system = tmp_path / "system.toml"
    system.write_text(
        'schema = 1\n[components.source0]\ntype = "source.py:Source"\n[contexts.servo]\nkind = "realtime"\n'
        "rate = 500.0\npriority = 20\ncpus = [0]\nspin = true\ndeadline = 0.001\nlock_memory = false\n"
        'members = ["source0"]\n'
    )
    done = subprocess.run(
        [sys.executable, "-m", "aiorts", "run", str(system)], capture_output=True, text=True, timeout=30, check=False
    )
    assert (done.returncode, done.stdout.splitlines()[:1]) == (0, ["realtime 500.0 0.001"]), done.stderr


@pytest.mark.parametrize(
    "arguments",
    [{"priority": 0}, {"priority": 100}, {"priority": True}, {"cpus": []}, {"cpus": [-1]}, {"cpus": 1}, {"spin": 0.01}],
)
def test_arguments_out_of_range_are_refused_by_name(arguments: dict[str, Any]) -> None:
    with pytest.raises(ConfigurationError, match=next(iter(arguments))):
        RealtimeContext(100.0, **arguments)


@pytest.mark.slow(kept_by="contexts/test_thread.py::test_a_thread_context_can_be_started_again")
async def test_it_can_be_started_again() -> None:
    async with Kernel() as kernel:
        worker = await kernel.add(Worker("worker"))
        context = RealtimeContext(200.0)
        for _ in range(3):
            runs = len(worker.begun)
            await kernel.start(context, worker, activate=True)
            await until(lambda runs=runs: len(worker.begun) > runs)  # type: ignore[misc]
            await context.stop()
        assert worker.contexts == ()
