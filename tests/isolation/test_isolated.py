"""A component in a process of its own: made, connected, configured, failing, killed, started anew, gone."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from anyio import fail_after, sleep

from aiorts import Component, EventContext, Kernel, LifecycleState, OutPort, PeriodicContext
from aiorts.errors import ComponentError, ConfigurationError, DeclarationError, ProcessError, StateError
from aiorts.isolation import Limits
from aiorts.links import Links
from aiorts.supervision import Supervision
from aiorts.system import build, check, load
from aiorts.testing import simulate
from aiorts.types import TimedDoubleSeq, TimedLong
from control_parts import commanded
from isolation.isolated_parts import Echo, Held, Lingers, Scale, Sink, Source, Spinner, Ticker, Unmakeable

pytestmark = pytest.mark.anyio
ACTIVE, INACTIVE, ERROR = LifecycleState.ACTIVE, LifecycleState.INACTIVE, LifecycleState.ERROR


async def until(holds: Callable[[], object], seconds: float = 15.0) -> None:
    with fail_after(seconds):
        while not holds():
            await sleep(0.01)


def runs(pid: int | None) -> bool:
    """Whether this process is there, and no zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


async def chain(
    kernel: Kernel, *, limits: Limits | None = None, deadline: float | None = None, **params: object
) -> tuple[Source, Any, Sink, Any]:
    """source -> scale, in a process -> sink, active."""
    source, sink = await kernel.add(Source("source")), await kernel.add(Sink("sink"))
    scale = await kernel.create_isolated(Scale, "scale", limits=limits, **params)
    await kernel.connect(source.out, "scale.inp", length=10_000)
    await kernel.connect("scale.out", sink.inp, length=10_000)
    context = await kernel.start(EventContext(name="apart", deadline=deadline), scale, activate=True)
    return source, scale, sink, context


async def answer(source: Source, sink: Sink, value: int) -> int:
    source.out.write_nowait(TimedLong(0, value))
    return int((await sink.inp.read(timeout=10)).data)


@pytest.mark.slow(kept_by="first")
@pytest.mark.row(51)
async def test_it_looks_like_any_other_and_runs_in_a_process_of_its_own() -> None:
    async with Kernel() as kernel:
        source, scale, sink, context = await chain(kernel, factor=3)
        assert await answer(source, sink, 5) == 15
        assert (scale.pid != os.getpid(), runs(scale.pid)) == (True, True)
        assert (scale.state, dict(scale.states)) == (ACTIVE, {"apart": ACTIVE})
        assert (context.kind, context.name, context.members) == ("event", "apart", (scale,))
        assert (scale.profile.type, dict(scale.configuration.values)) == ("Scale", {"factor": 3})
        assert [port.connectors for port in scale.ports.values()] == [source.out.connectors, sink.inp.connectors]
        assert [one.profile.ports for one in kernel.connectors.values()] == [
            ("source.out", "scale.inp"),
            ("scale.out", "sink.inp"),
        ]
        ledgers = [await kernel.service(Links).ledger(one) for one in kernel.connectors.values()]
        assert [(one.written, one.delivered, one.unexplained) for one in ledgers] == [(1, 1, 0), (1, 1, 0)]
        with pytest.raises(AttributeError, match=r"scale.secret: Scale runs in a process of its own"):
            _ = scale.secret
        with pytest.raises(AttributeError, match=r"scale.secret: Scale runs in a process of its own"):
            scale.secret = "here"
        with pytest.raises(StateError, match=r"scale.out: its component runs in a process of its own"):
            scale.out.write_nowait(TimedLong(0, 1))
        pid = scale.pid
        await context.deactivate()
        assert scale.state is INACTIVE
        await context.stop()
        await kernel.remove(scale)
        assert (dict(kernel.connectors), runs(pid)) == ({}, False)


@pytest.mark.slow(kept_by="test_it_looks_like_any_other_and_runs_in_a_process_of_its_own")
@pytest.mark.row(30)
async def test_two_that_need_a_processor_run_side_by_side() -> None:
    async with Kernel() as kernel:
        ends = []
        for number in range(2):
            source, sink = await kernel.add(Source(f"source{number}")), await kernel.add(Sink(f"sink{number}"))
            spinner = await kernel.create_isolated(Spinner, f"spinner{number}")
            await kernel.connect(source.out, f"spinner{number}.inp")
            await kernel.connect(f"spinner{number}.out", sink.large)
            await kernel.start(EventContext(name=f"apart{number}"), spinner, activate=True)
            ends.append((source, sink))
        for source, _ in ends:
            source.out.write_nowait(TimedLong(0, 1))
        (began, ended), (other_began, other_ended) = [(await sink.large.read(timeout=10)).data for _, sink in ends]
        assert max(began, other_began) < min(ended, other_ended)


@pytest.mark.slow(kept_by="test_it_looks_like_any_other_and_runs_in_a_process_of_its_own")
async def test_parameters_and_sets_are_in_force_there_or_refused() -> None:
    async with Kernel() as kernel:
        source, scale, sink, _ = await chain(kernel)
        await scale.configure(factor=7)
        assert (scale.factor, await answer(source, sink, 1)) == (7, 7)
        await scale.configuration.activate("large")
        assert (scale.factor, await answer(source, sink, 1)) == (1000, 1000)
        with pytest.raises(ConfigurationError, match="factor"):
            await scale.configure(factor=-1)
        with pytest.raises(ConfigurationError, match="13 is no factor"):
            await scale.configure(factor=13)
        assert (scale.factor, await answer(source, sink, 2)) == (1000, 2000)


@pytest.mark.slow
async def test_a_configuration_file_is_in_force_there(tmp_path: Path) -> None:
    async with Kernel() as kernel:
        source, scale, sink, _ = await chain(kernel)
        file = tmp_path / "values.toml"
        await kernel.save_configuration(file)
        file.write_text(file.read_text().replace("factor = 2\n", "factor = 7\n"))
        await kernel.load_configuration(file)
        assert (scale.factor, await answer(source, sink, 1)) == (7, 7)


@pytest.mark.slow(kept_by="test_it_looks_like_any_other_and_runs_in_a_process_of_its_own")
@pytest.mark.parametrize(
    ("value", "said"),
    [(-1, "ValueError: negative"), (-11, "KeyboardInterrupt"), (-12, "... (3,000,012 letters)")],
)
async def test_what_it_raises_is_its_error_here_and_a_reset_helps(value: int, said: str) -> None:
    async with Kernel() as kernel:
        source, scale, sink, context = await chain(kernel)
        pid = scale.pid
        source.out.write_nowait(TimedLong(0, value))
        await until(lambda: scale.state is ERROR)
        assert said in str(scale.last_error)
        assert isinstance(scale.last_error, ComponentError)
        await context.reset()
        await context.activate()
        assert (await answer(source, sink, 4), scale.pid) == (8, pid)


@pytest.mark.slow
@pytest.mark.fault("A13")
@pytest.mark.parametrize(
    ("value", "said"),
    [
        (-2, "killed by SIGSEGV (signal 11)"),
        (-3, "exit status 3"),
        (-10, "killed: it has closed its connection with this kernel and goes on"),
    ],
    ids=["segfault", "exit", "another program"],
)
async def test_the_end_of_its_process_is_its_failure_and_a_reset_starts_another(value: int, said: str) -> None:
    async with Kernel() as kernel:
        source, scale, sink, context = await chain(kernel, factor=5)
        pid = scale.pid
        began = time.monotonic()
        source.out.write_nowait(TimedLong(0, value))
        await until(lambda: scale.state is ERROR)
        assert time.monotonic() - began < 5.0
        assert isinstance(scale.last_error, ProcessError)
        assert f"scale: its process has ended: {said}" in str(scale.last_error)
        await context.reset()
        await context.activate()
        assert await answer(source, sink, 4) == 20
        assert (scale.pid != pid, runs(pid)) == (True, False)
        for connector in kernel.connectors.values():
            ledger = await kernel.service(Links).ledger(connector)
            assert ledger.unexplained == 0, str(ledger)
        dropped = kernel.connectors["source.out-scale.inp"].statistics.dropped
        assert {reason: count for reason, count in dropped.items() if count} in ({"unknown_fate": 1}, {})


@pytest.mark.slow
@pytest.mark.fault("A10")
async def test_a_hook_that_holds_its_process_is_seen_and_killed_after_its_deadline() -> None:
    async with Kernel() as kernel:
        source, scale, _sink, _ = await chain(kernel, deadline=0.3)
        source.out.write_nowait(TimedLong(0, -4))
        await until(lambda: scale.busy > 0.6)
        late = [0.0]
        while scale.state is not ERROR:
            before = time.monotonic()
            await asyncio.sleep(0.01)
            late.append(time.monotonic() - before)
            assert len(late) < 1_000
        assert "its process has ended: killed: a hook has held it for" in str(scale.last_error)
        assert max(late) < 1.0, "this loop was held, too"


@pytest.mark.slow
@pytest.mark.parametrize("restart", ["reset", "restart"])
async def test_one_that_is_supervised_comes_back_by_itself_from_a_kill(
    restart: str, caplog: pytest.LogCaptureFixture
) -> None:
    """It was said first that there was no such component, and then that it was being started."""
    async with Kernel() as kernel:
        source, scale, sink, _ = await chain(kernel, factor=3)
        kernel.supervise(scale, Supervision(restart=restart, backoff=0.05))
        for _ in range(2):
            pid = scale.pid
            os.kill(pid, signal.SIGKILL)

            def is_back(pid: int = pid) -> bool:
                there: Any = kernel.components.get("scale")
                return there is not None and there.state is ACTIVE and there.pid not in (pid, None)

            await until(is_back)
            scale = kernel.components["scale"]
            assert await answer(source, sink, 4) == 12
    assert [line for line in caplog.messages if "no component" in line] == []


@pytest.mark.slow
async def test_started_anew_it_gets_what_is_written_before_it_is_active() -> None:
    async with Kernel() as kernel:
        source, scale, sink, context = await chain(kernel)
        os.kill(scale.pid, signal.SIGKILL)
        await until(lambda: scale.state is ERROR)
        await context.reset()
        source.out.write_nowait(TimedLong(0, 1))
        await sleep(0.3)
        await context.activate()
        assert await answer(source, sink, 2) == 2
        assert (await sink.inp.read(timeout=10)).data == 4
        assert not any(kernel.connectors["source.out-scale.inp"].statistics.dropped.values())


@pytest.mark.slow(kept_by="test_it_looks_like_any_other_and_runs_in_a_process_of_its_own")
async def test_a_periodic_context_runs_there_at_its_rate_until_the_source_has_finished() -> None:
    async with Kernel() as kernel:
        sink = await kernel.add(Sink("sink"))
        ticker = await kernel.create_isolated(Ticker, "ticker")
        connector = await kernel.connect("ticker.out", sink.inp)
        context = await kernel.start(PeriodicContext(rate=100.0), ticker)
        await context.activate()
        assert (context.kind, context.rate) == ("periodic", 100.0)
        with fail_after(10):
            seen = [(await sink.inp.read()).data for _ in range(20)]
        assert seen == list(range(1, 21))
        await until(lambda: ticker.has_finished)
        assert connector.statistics.written == 20


@pytest.mark.slow(kept_by="test_it_looks_like_any_other_and_runs_in_a_process_of_its_own")
async def test_what_its_context_counts_there_is_counted_here_and_by_the_commands(
    capsys: pytest.CaptureFixture[str],
) -> None:
    async with Kernel("unit", services={"control": {}}) as kernel:
        held = await kernel.create_isolated(Held, "held")
        context = await kernel.start(PeriodicContext(name="apart", rate=100.0, timing=True), held, activate=True)
        await until(lambda: context.statistics.overruns)
        found, counts = context.statistics, context.counts
        assert (found.policy, found.cycles >= 2, found.lateness_max_ns > 30_000_000) == ("skip", True, True)
        assert (found.skipped >= 3, sum(found.lateness_histogram.values())) == (True, found.cycles)
        assert (found.hooks["held.on_execute"].max_ns >= 50_000_000, dict(counts.hooks)) == (True, {})
        status, text = await commanded(capsys, "cat", "apart")
        assert (status, "overruns" in text) == (0, True), text
        await until(lambda: context.counts.cycles > 200)
        os.kill(held.pid, signal.SIGKILL)
        await until(lambda: held.state is ERROR)
        assert context.counts.cycles > 200
        await context.reset()  # the new process begins anew
        await until(lambda: context.counts.cycles < 200)


@pytest.mark.slow(kept_by="test_it_looks_like_any_other_and_runs_in_a_process_of_its_own")
async def test_arrays_go_there_and_back() -> None:
    async with Kernel() as kernel:
        source, sink = await kernel.add(Source("source")), await kernel.add(Sink("sink"))
        echo = await kernel.create_isolated(Echo, "echo")
        await kernel.connect(source.large, "echo.inp")
        await kernel.connect("echo.out", sink.large)
        await kernel.start(EventContext(), echo, activate=True)
        for number in range(5):
            source.large.write_nowait(TimedDoubleSeq(0, np.full(200_000, float(number))))
            assert (await sink.large.read(timeout=10)).data[[0, -1]].tolist() == [number, number]
        if hasattr(os, "memfd_create"):
            await until(lambda: Path("/proc/self/maps").read_text().count("memfd:") >= 2)


@pytest.mark.slow(kept_by="test_it_looks_like_any_other_and_runs_in_a_process_of_its_own")
async def test_a_component_that_refuses_to_come_in_leaves_no_process() -> None:
    async with Kernel() as kernel:
        with pytest.raises(ComponentError, match="no camera there"):
            await kernel.create_isolated(Unmakeable, "camera")
        assert dict(kernel.components) == {}


def processes_below(pid: int) -> list[int]:
    """All processes that descend from one, but zombies."""
    found = []
    for task in Path(f"/proc/{pid}/task").iterdir():
        for child in map(int, (task / "children").read_text().split()):
            found += [*([child] if runs(child) else []), *processes_below(child)]
    return found


@pytest.mark.slow(kept_by="test_it_looks_like_any_other_and_runs_in_a_process_of_its_own")
@pytest.mark.fault("G05")
@pytest.mark.parametrize("seconds", [0.0, 0.05, 0.2, 0.5])
async def test_a_creation_that_is_cancelled_leaves_no_process(seconds: float) -> None:
    before = processes_below(os.getpid())
    async with Kernel() as kernel:
        task = asyncio.ensure_future(kernel.create_isolated(Scale, "scale"))
        await sleep(seconds)
        task.cancel()
        await asyncio.wait([task], timeout=10)
        assert task.done()
        assert set(kernel.components) == (set() if task.cancelled() else {"scale"})
        if task.cancelled():
            await until(lambda: set(processes_below(os.getpid())) <= set(before))
            again: Any = await kernel.create_isolated(Scale, "scale")
            assert runs(again.pid)


@pytest.mark.slow(kept_by="test_it_looks_like_any_other_and_runs_in_a_process_of_its_own")
async def test_a_process_that_ends_while_it_comes_up_says_how_and_what_it_wrote(tmp_path: Path) -> None:
    file = tmp_path / "fragile.py"
    text = "import os, sys\nfrom aiorts import Component\n"
    text += "if 'kernel' in sys.argv:\n    print('no licence', file=sys.stderr, flush=True)\n    os._exit(5)\n"
    file.write_text(f"{text}class Fragile(Component):\n    pass\n")
    async with Kernel() as kernel:
        with pytest.raises(ProcessError, match=r"(?s)fragile0: its process ended: exit status 5.*no licence"):
            await kernel.create_isolated(f"{file}:Fragile")
        assert dict(kernel.components) == {}


@pytest.mark.slow(kept_by="test_it_looks_like_any_other_and_runs_in_a_process_of_its_own")
async def test_members_of_one_context_run_in_one_process() -> None:
    async with Kernel() as kernel:
        source = await kernel.add(Source("source"))
        scale = await kernel.create_isolated(Scale, "scale")
        with pytest.raises(StateError, match="scale runs in a process of its own, and source in that of its kernel"):
            await kernel.start(EventContext(), source, scale)
        assert (dict(source.states), dict(scale.states)) == ({}, {})


@pytest.mark.slow
async def test_a_class_that_a_process_cannot_import_is_refused_with_what_to_do() -> None:
    class Local(Component):
        out = OutPort(TimedLong)

    async with Kernel() as kernel:
        with pytest.raises(DeclarationError, match="write it into a module or a file of its own"):
            await kernel.create_isolated(Local, "local")
        limits: Any = {"memory": 1 << 30}
        with pytest.raises(DeclarationError, match=r"limits: expected Limits\(memory=..., cpu=...\), got dict"):
            await kernel.create_isolated(Scale, "scale", limits=limits)
        with pytest.raises(ProcessError, match=r"limits.memory = \d+: the system refuses"):
            await kernel.create_isolated(Scale, "scale", limits=Limits(memory=1 << 70))
        assert dict(kernel.components) == {}


@pytest.mark.slow(kept_by="test_it_looks_like_any_other_and_runs_in_a_process_of_its_own")
async def test_a_memory_limit_is_the_components_own_error() -> None:
    async with Kernel() as kernel:
        source, scale, _sink, _ = await chain(kernel, limits=Limits(memory=200 << 20))
        source.out.write_nowait(TimedLong(0, -6))
        await until(lambda: scale.state is ERROR)
        assert "Unable to allocate" in str(scale.last_error)


def test_on_a_simulated_clock_it_runs_in_this_process_which_is_said_once(caplog: pytest.LogCaptureFixture) -> None:
    async def run() -> None:
        async with Kernel() as kernel:
            one = await kernel.create_isolated(Scale, "one")
            two = await kernel.create_isolated(Scale, "two")
            assert (type(one), type(two)) == (Scale, Scale)

    simulate(run())
    assert sum("W-ISOLATION" in one.getMessage() for one in caplog.records) == 1


@pytest.mark.slow(kept_by="test_it_looks_like_any_other_and_runs_in_a_process_of_its_own")
async def test_the_end_of_the_kernel_leaves_no_process() -> None:
    async with Kernel() as kernel:
        source, scale, _sink, _ = await chain(kernel)
        pid = scale.pid
        source.out.write_nowait(TimedLong(0, -7))
        below = Path(f"/proc/{pid}/task/{pid}/children")
        await until(below.read_text)
        children = [int(one) for one in below.read_text().split()]
    assert [one for one in (pid, *children) if runs(one)] == []


FILE = """
schema = 1

[components.source]
type = "isolated_parts.py:Source"

[components.scale]
type = "isolated_parts.py:Scale"
isolation = "process"
limits = {memory = 300_000_000}
params.factor = 4
supervision = {restart = "reset"}

[[connections]]
from = "source.out"
to = "scale.inp"

[contexts.a]
kind = "event"
members = ["source"]

[contexts.b]
kind = "event"
members = ["scale"]
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    (tmp_path / "isolated_parts.py").write_text(Path(__file__).with_name("isolated_parts.py").read_text())
    (tmp_path / "system.toml").write_text(FILE)
    return tmp_path / "system.toml"


@pytest.mark.slow(kept_by="test_it_looks_like_any_other_and_runs_in_a_process_of_its_own")
async def test_a_system_file_gives_a_component_a_process_and_is_saved_with_it(file: Path) -> None:
    system = load(file)
    assert [one for one in check(file) if one.severity != "note"] == []
    async with Kernel() as kernel:
        await build(kernel, system)
        scale: Any = kernel.components["scale"]
        assert (scale.state, runs(scale.pid), scale.factor) == (ACTIVE, True, 4)
        await kernel.save(file.with_name("saved.toml"))
        text = file.with_name("saved.toml").read_text()
        assert 'isolation = "process"' in text
        assert "limits = { memory = 300000000 }" in text
        assert 'kind = "event"' in text.partition("[contexts.b]")[2]


@pytest.mark.slow(kept_by="first")
@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('"process"', '"thread"', "expected 'process', or no such line, got 'thread'"),
        ('isolation = "process"\n', "", "limits are those of a process"),
        ("memory = 300_000_000", "memory = -1", "-1: expected a whole number from 1"),
        ("memory = 300_000_000", "cores = 1", "unknown key 'cores'"),
        ('members = ["scale"]', 'members = ["scale", "other"]', "scale has a process of its own, and other has none"),
    ],
)
def test_what_a_file_says_wrongly_of_isolation_is_found_before_anything_runs(
    file: Path, old: str, new: str, said: str
) -> None:
    other = '[components.other]\ntype = "isolated_parts.py:Source"\n\n[[connections]]'
    file.write_text(FILE.replace(old, new).replace("[[connections]]", other))
    assert any(said in f"{one.cause}; {one.remedy}" for one in check(file) if one.severity == "error"), check(file)


@pytest.mark.slow(kept_by="test_it_looks_like_any_other_and_runs_in_a_process_of_its_own")
def test_its_process_imports_the_operations_that_it_is_asked_for_alone() -> None:
    text = "import sys, aiorts.cli.runtime.component_process\nprint(*sorted(sys.modules))"
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, timeout=60, check=True)
    found = {name.rpartition(".")[2] for name in done.stdout.split() if name.startswith("aiorts.control.operations.")}
    assert {"components", "lifecycle"} <= found <= {"components", "configuration", "contexts", "lifecycle", "known"}


@pytest.mark.slow
async def test_a_process_that_does_not_end_is_killed_and_the_log_says_so(caplog: pytest.LogCaptureFixture) -> None:
    async with Kernel() as kernel:
        await kernel.create_isolated(Lingers, "lingers")
    (said,) = [one.getMessage() for one in caplog.records if "killed" in one.getMessage()]
    assert "had not ended 1.2 s after it was asked to; its on_finalize may not have run" in said
