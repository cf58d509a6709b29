"""`aiorts run --record`: everything that a system sends, in a file, and nothing else is as it was without."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import signal
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from aiorts import (
    Catalogue,
    Component,
    Composite,
    EventContext,
    InPort,
    Kernel,
    OutPort,
    Param,
    PeriodicContext,
    RealtimeContext,
    Supervision,
    ThreadContext,
)
from aiorts.errors import ConfigurationError
from aiorts.kernel.loop.deadlines import StopBudget
from aiorts.system import build, load, wait_finished
from aiorts.testing import check_service, simulated
from aiorts.types import TimedDouble, TimedLong, TimedOctetSeq, TimedString
from aiorts_log import RecordingReader
from aiorts_log.mcap.locked_file import LockedFile
from aiorts_log.recorder import beside
from aiorts_log.recorder.beside import Beside
from log_parts import read
from run_parts import begun, here, limited

SYSTEM = """\
schema = 1
[components.one]
type = "counter.py:Counter"
[components.other]
type = "counter.py:Counter"
[contexts.loop]
kind = "periodic"
rate = 1000.0
members = ["one", "other"]
"""
COUNTER = '''\
from aiorts import Component, OutPort
from aiorts.types import TimedLong

class Counter(Component):
    """Sends 50 numbers, and one more on its way out."""
    out = OutPort(TimedLong)
    aside = OutPort(TimedLong)
    n = 0
    def on_execute(self):
        self.out.write_nowait(TimedLong(self.n, self.n))
        self.n += 1
        if self.n == 50:
            self.finish()
    def on_deactivated(self):
        self.out.write_nowait(TimedLong(self.n, -1))
'''
ALL = [*range(50), -1]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "counter.py").write_text(COUNTER)
    (tmp_path / "system.toml").write_text(SYSTEM)
    return tmp_path


def data(path: Path) -> dict[str, list[Any]]:
    """What was recorded of each port."""
    found: dict[str, list[Any]] = {}
    for name, _, record in read(path):
        found.setdefault(name, []).append(record.data)
    return found


def in_process(*words: str) -> tuple[int, str, str]:
    """A command, run in this process: exit status, standard output, standard error."""
    done = here(*words)
    return done.returncode, done.stdout, done.stderr


def settings(path: Path, **more: Any) -> dict[str, dict[str, Any]]:
    return {"record": {"file": str(path), "min_free": 0, **more}}


# -- the command -------------------------------------------------------------------------------------------------------


@pytest.mark.slow(kept_by="test_the_table_of_a_system_file_says_the_same_and_counts_from_its_folder")
@pytest.mark.row(115)
def test_a_run_records_every_out_port_to_the_last_sample(folder: Path) -> None:
    path = folder / "run.mcap"
    assert in_process("run", str(folder / "system.toml"), "--record", str(path)) == (0, "", "")
    assert data(path) == {"one.out": ALL, "other.out": ALL}
    with RecordingReader(path) as reader:
        assert reader.clean


@pytest.mark.slow
def test_a_port_that_sent_nothing_is_listed_without_samples(folder: Path) -> None:
    path, system = folder / "run.mcap", str(folder / "system.toml")
    for more in ([], ["--append"]):
        assert in_process("run", system, "--record", str(path), *more) == (0, "", "")
        with RecordingReader(path) as reader:
            counts = {name: port.count for name, port in reader.ports.items()}
            assert (reader.clean, reader.check()) == (True, ())
        sent = 51 if not more else 102
        assert counts == {"one.out": sent, "other.out": sent, "one.aside": 0, "other.aside": 0}
    shown = in_process("log", "info", str(path))[1]
    assert "  one.aside    TimedLong    0\n" in shown
    for name in ("all.jsonl", "all.csv"):
        assert in_process("log", "convert", str(path), str(folder / name))[0] == 0
        if name != "all.csv":
            assert in_process("log", "diff", str(path), str(folder / name))[:2] == (
                0,
                "equal: 204 samples of 2 ports\n",
            )
    assert in_process("log", "salvage", str(path), str(folder / "new.mcap"))[0] == 0


@pytest.mark.slow(kept_by="test_the_table_of_a_system_file_says_the_same_and_counts_from_its_folder")
def test_globs_choose_ports_and_one_that_names_none_is_refused_before_the_start(folder: Path) -> None:
    path, system = folder / "run.mcap", str(folder / "system.toml")
    for glob, hint in (("oen.out", "did you mean 'one.out'?"), ("x*", "there are one.aside, one.out, other.aside, ")):
        status, out, said = in_process("run", system, "--record", str(path), "--record-port", glob)
        assert (status, out) == (2, "")
        assert f"record: no out-port is called {glob!r}; {hint}" in said
        assert not path.exists()
    words = ["--record-port", "o?e.*", "--record-port", "*.aside"]
    assert in_process("run", system, "--record", str(path), *words)[0] == 0
    assert data(path) == {"one.out": ALL}


@pytest.mark.slow(kept_by="test_what_cannot_be_recorded_is_refused_before_the_start")
def test_a_file_that_is_there_is_kept_unless_it_is_said_what_becomes_of_it(folder: Path) -> None:
    path, system = folder / "run.mcap", str(folder / "system.toml")
    assert in_process("run", system, "--record", str(path), "--record-port", "one.*")[0] == 0
    before = path.read_bytes()
    status, out, said = in_process("run", system, "--record", str(path))
    assert (status, out, path.read_bytes() == before) == (2, "", True)
    assert "run.mcap: exists already; --append continues it, --overwrite replaces it" in said
    assert in_process("run", system, "--record", str(path), "--append")[0] == 0
    assert data(path) == {"one.out": [*ALL, *ALL], "other.out": ALL}
    assert in_process("run", system, "--record", str(path), "--overwrite")[0] == 0
    assert data(path) == {"one.out": ALL, "other.out": ALL}


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--record-port", "*"], "--record-port: file: nothing says where to record"),
        (["--record", "{tim}.mcap"], "--record: {tim} in '{tim}.mcap': only {time} is replaced"),
        (["--record", "run.csv"], "run.csv: a recording is MCAP; record run.mcap, and `aiorts log convert run.mcap"),
        (["--record", "no/run.mcap"], "no/run.mcap: there is no folder"),
        (["--record", "/"], "expected the name of a file, such as run.mcap"),
        (["--record", "/dev"], "/dev: is no regular file; a recording needs one"),
        (["--record", "r.mcap", "--append", "--overwrite"], "choose one of the two"),
    ],
)
def test_what_cannot_be_recorded_is_refused_before_the_start(folder: Path, words: list[str], said: str) -> None:
    status, out, errors = in_process("run", str(folder / "system.toml"), *words)
    assert (status, out) == (2, "")
    assert said in " ".join(errors.split())


@pytest.mark.parametrize("what", ["system.toml", "counter.py:Counter", "early.py:Early"])
def test_a_file_that_is_found_bad_when_it_is_opened_is_refused_before_the_start(folder: Path, what: str) -> None:
    (folder / "early.py").write_text(
        COUNTER.replace("Counter", "Early").replace(
            "    n = 0\n", "    n = 0\n    def on_initialize(self):\n        self.out.write_nowait(TimedLong(0, 7))\n"
        )
    )
    (folder / "r.mcap").write_text("no recording")
    status, out, errors = in_process("run", str(folder / what), "--record", str(folder / "r.mcap"), "--append")
    assert (status, out) == (2, "")
    assert "r.mcap: no recording" in errors
    assert "is not complete" not in errors


@pytest.mark.row(128)
def test_two_runs_in_virtual_time_are_the_same_to_the_byte(folder: Path) -> None:
    paths = [folder / "a.mcap", folder / "b.mcap"]
    for path in paths:
        words = ["--simulate", "--record", str(path)]
        assert in_process("run", str(folder / "system.toml"), *words) == (0, "", "")
    first, second = (path.read_bytes() for path in paths)
    assert first == second
    assert data(paths[0]) == {"one.out": ALL, "other.out": ALL}


def test_the_table_of_a_system_file_says_the_same_and_counts_from_its_folder(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir("/")
    table = '[record]\nfile = "run-{time}.mcap"\nports = ["one.*"]\n'
    (folder / "system.toml").write_text(SYSTEM + table)
    assert in_process("run", str(folder / "system.toml")) == (0, "", "")
    (path,) = folder.glob("run-*.mcap")
    assert path.name[4:-5].replace("T", "").rstrip("Z").isdigit()
    assert data(path) == {"one.out": ALL}


# -- the service -------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_it_keeps_what_a_kernel_relies_on(tmp_path: Path) -> None:
    check_service(Beside)
    check_service(Beside, {"file": str(tmp_path / "run.mcap"), "overwrite": True, "min_free": 0.0})


class Source(Component):
    """Sends what it is told to."""

    out = OutPort(TimedLong, unit="m")

    def send(self, *numbers: int) -> None:
        for number in numbers:
            self.out.write_nowait(TimedLong(0, number))


class Sink(Component):
    """Takes it."""

    inp = InPort(TimedLong)

    def on_execute(self) -> None:
        self.inp.drain()


class Ports(Component):
    """Has the ports that its parameter names."""

    names: tuple[str, ...] = Param((), type=tuple[str, ...])

    def ports_for(self, values: Any) -> Any:
        return {name: OutPort(TimedDouble) for name in values["names"]}


@simulated
async def test_components_and_ports_that_come_later_are_recorded_and_those_that_go_to_their_last(
    tmp_path: Path,
) -> None:
    path = tmp_path / "run.mcap"
    async with Kernel(services=settings(path)) as kernel:
        first = await kernel.add(Source("first"))
        first.send(1)  # before anything runs
        context = await kernel.start(EventContext(), first, activate=True)
        first.send(2)
        second = await kernel.add(Source("second"))
        await context.add(second)
        second.send(10)
        ports = await kernel.create(Ports, "ports", names=("a",))
        ports.ports["a"].write_nowait(TimedDouble(0, 0.5))  # type: ignore[attr-defined]
        await ports.configure(names=("a", "b"))
        ports.ports["b"].write_nowait(TimedDouble(0, 1.5))  # type: ignore[attr-defined]
        await ports.configure(names=("b",))
        ports.ports["b"].write_nowait(TimedDouble(0, 2.5))  # type: ignore[attr-defined]
        second.send(11)
        await kernel.remove(second)
        second = await kernel.add(Source("second"))
        second.send(12)
        first.send(3)
    assert data(path) == {
        "first.out": [1, 2, 3],
        "second.out": [10, 11, 12],
        "ports.a": [0.5],
        "ports.b": [1.5, 2.5],
    }
    assert kernel.exit_status == 0


@simulated
async def test_members_of_composites_are_recorded_once_under_their_own_names(tmp_path: Path) -> None:
    path, chosen = tmp_path / "run.mcap", tmp_path / "chosen.mcap"
    for file, more in ((path, {}), (chosen, {"ports": ["arm.*"]})):
        async with Kernel(services=settings(file, **more)) as kernel:
            inner, other = await kernel.add(Source("inner")), await kernel.add(Source("other"))
            arm = await kernel.add(Composite("arm", inner, exported={"inner.out": "force"}))
            await kernel.start(EventContext(), arm, other, activate=True)
            inner.send(1)
            other.send(2)
    assert data(path) == {"inner.out": [1], "other.out": [2]}
    assert data(chosen) == {"inner.out": [1]}


@simulated
async def test_it_may_come_to_a_system_that_runs(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    async with Kernel() as kernel:
        source = await kernel.add(Source("source"))
        await kernel.start(EventContext(), source, activate=True)
        source.send(1)
        kernel.service(Beside).configure(Beside.settings(file=path, min_free=0.0))
        source.send(2)
        assert kernel.profile().services["record"]["ports"] == 1
    assert data(path) == {"source.out": [2]}


class Loud(Component):
    """Sends five in each cycle, 100 times."""

    out = OutPort(TimedLong)
    n = 0

    def on_execute(self) -> None:
        for _ in range(5):
            self.out.write_nowait(TimedLong(0, self.n))
            self.n += 1
        if self.n == 500:
            self.finish()


@pytest.mark.slow(kept_by="test_components_and_ports_that_come_later_are_recorded_and_those_that_go_to_their_last")
@pytest.mark.parametrize("kind", [PeriodicContext, ThreadContext, RealtimeContext])
@pytest.mark.anyio
async def test_it_records_from_any_context(kind: Any, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    async with Kernel(services=settings(path)) as kernel:
        loud, sink = await kernel.add(Loud("loud")), await kernel.add(Sink("sink"))
        await kernel.connect(loud.out, sink.inp, length=1000)
        await kernel.start(EventContext(), sink, activate=True)
        await kernel.start(kind(rate=1000.0), loud, activate=True)
        await wait_finished(kernel)
    assert data(path) == {"loud.out": list(range(500))}
    assert kernel.exit_status == 0


@simulated
async def test_new_code_and_new_instances_are_recorded_on(tmp_path: Path) -> None:
    file, path = tmp_path / "counter.py", tmp_path / "run.mcap"
    file.write_text(COUNTER)
    async with Kernel(plugins=Catalogue([tmp_path, *Catalogue.default().folders]), services=settings(path)) as kernel:
        one: Any = await kernel.create("Counter", "one")
        context = await kernel.start(EventContext(), one, activate=True)
        one.out.write_nowait(TimedLong(0, 1))
        file.write_text(COUNTER.replace("Sends 50", "Sends  50").replace("-1", "-2"))
        await kernel.reload("Counter")
        newer: Any = kernel.components["one"]
        assert newer is not one
        newer.out.write_nowait(TimedLong(0, 2))
        newer.aside.write_nowait(TimedLong(0, 3))
        await context.deactivate(newer)
    assert data(path) == {"one.out": [1, 2, -2], "one.aside": [3]}
    assert kernel.exit_status == 0


class Failing(Component):
    """Fails at every third cycle."""

    out = OutPort(TimedLong)
    n = 0

    def on_execute(self) -> None:
        self.n += 1
        self.out.write_nowait(TimedLong(0, self.n))
        if self.n == 3:
            raise ValueError("three")


@simulated
async def test_a_component_that_is_made_anew_is_recorded_on(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    async with Kernel(services=settings(path)) as kernel:
        one = await kernel.add(Failing("one"))
        kernel.supervise(one, Supervision(restart="restart", backoff=0.1), factory=Failing)
        await kernel.start(PeriodicContext(100.0), one, activate=True)
        while not (newer := kernel.components.get("one")) or newer is one or getattr(newer, "n", 0) < 2:
            await kernel.sleep(0.005)
    assert data(path) == {"one.out": [1, 2, 3, 1, 2]}


@pytest.mark.slow(kept_by="test_what_cannot_be_recorded_is_refused_before_the_start")
@pytest.mark.skipif(sys.platform == "win32", reason="no POSIX signals")
@pytest.mark.parametrize(("name", "status"), [("SIGINT", 130), ("SIGTERM", 143), ("SIGKILL", -9)])
def test_a_signal_closes_the_file_and_after_a_kill_it_opens_as_it_is(name: str, status: int, folder: Path) -> None:
    (folder / "counter.py").write_text(COUNTER.replace("== 50", "== 1_000_000"))
    path = folder / "run.mcap"
    process = begun(folder, "system.toml", "--record", "run.mcap")
    with limited(process):
        while not path.exists() or path.stat().st_size < 10_000:
            assert process.poll() is None
            time.sleep(0.01)
        process.send_signal(getattr(signal, name))
        _, errors = process.communicate(timeout=20)
    assert (process.returncode, errors) == (status, "")
    with RecordingReader(path) as reader:
        assert (reader.fault, reader.clean) == ("", status > 0)
    for numbers in data(path).values():
        there = numbers[:-1] if status > 0 else numbers
        assert there == list(range(len(there)))
        assert status < 0 or numbers[-1] == -1


class Bursts(Component):
    """Sends 3,000 texts at once, from a thread."""

    out = OutPort(TimedString)
    n = 0

    def on_execute(self) -> None:
        self.n += 1
        for number in range(3000):
            self.out.write_nowait(TimedString(number, f"{self.n}"))
        if self.n == 3:
            self.finish()


@pytest.mark.slow(kept_by="test_what_may_wait_of_a_port_is_bounded_in_bytes_as_well")
@pytest.mark.fault("B17")
@pytest.mark.anyio
async def test_a_burst_of_a_thread_that_cannot_wait_is_recorded_whole(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    async with Kernel(services=settings(path)) as kernel:
        bursts = await kernel.add(Bursts("bursts"))
        await kernel.start(ThreadContext(rate=100.0), bursts, activate=True)
        await wait_finished(kernel)
        assert bursts.last_error is None
    assert [record.tm for _, _, record in read(path)] == [*range(3000)] * 3


@simulated
async def test_what_may_wait_of_a_port_is_bounded_in_bytes_as_well(tmp_path: Path) -> None:
    async with Kernel(services=settings(tmp_path / "run.mcap")) as kernel:
        heavy, one = await kernel.add(Heavy("heavy")), await kernel.add(Source("one"))
        context = await kernel.start(EventContext(), heavy, one, activate=True)
        one.send(1)
        context.trigger(heavy)
        await kernel.sleep(0.1)
        lengths = {out.path: tap.connector.profile.length for out, tap in kernel.service(Beside)._taps.items()}
        assert lengths == {"heavy.out": 67, "one.out": 100_000}


# -- trouble -----------------------------------------------------------------------------------------------------------


class Heavy(Component):
    """Sends 1 MB at a time."""

    out = OutPort(TimedOctetSeq)
    n = 0

    async def on_execute(self) -> None:
        await self.out.write(TimedOctetSeq(self.n, bytes(10**6)))
        self.n += 1


@pytest.mark.slow(kept_by="log/test_writer.py::test_a_disk_that_fails_ends_the_recording_and_leaves_it_valid")
@pytest.mark.fault("D03")
@pytest.mark.anyio
async def test_a_disk_that_fills_up_is_told_at_once_and_the_system_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    put, path = LockedFile.put, tmp_path / "run.mcap"

    def full(self: LockedFile, parts: list[memoryview]) -> int:
        if self.size > 2000:
            raise OSError(28, os.strerror(28))
        return put(self, parts)

    monkeypatch.setattr(LockedFile, "put", full)
    async with Kernel(services=settings(path)) as kernel:
        source = await kernel.add(Source("source"))
        await kernel.start(EventContext(), source, activate=True)
        sent = 0
        while "recording ended" not in caplog.text:
            source.send(*range(100))
            sent += 100
            await kernel.sleep(0.01)
        source.send(1, 2, 3)
        sent += 3
    stored = len(read(path))
    first, last = (record.getMessage() for record in caplog.records if record.levelno == logging.ERROR)
    assert f"recording ended: No space left on device; the {stored} samples up to there are whole" in first
    assert f"is not complete: {sent - stored} samples that were sent are not in it" in last
    assert kernel.exit_status == 1


@pytest.mark.slow(kept_by="test_in_virtual_time_a_slow_disk_is_waited_for")
@pytest.mark.fault("B17")
@pytest.mark.anyio
@pytest.mark.parametrize("full", ["block", "overwrite"])
async def test_a_disk_that_is_behind_makes_writers_wait_or_what_is_lost_is_counted(
    full: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    put, path = LockedFile.put, tmp_path / "run.mcap"
    monkeypatch.setattr(beside, "_LENGTHS", (4, 4))
    monkeypatch.setattr(beside, "_FULL", 0.05)  # 3 MB

    def slow(self: LockedFile, parts: list[memoryview]) -> int:
        time.sleep(0.01)
        return put(self, parts)

    monkeypatch.setattr(LockedFile, "put", slow)
    async with Kernel(services=settings(path, full=full)) as kernel:
        heavy = await kernel.add(Heavy("heavy"))
        await kernel.start(PeriodicContext(1000.0), heavy, activate=True)
        while heavy.n < 20:
            await kernel.sleep(0.01)
    stored = [record.tm for _, _, record in read(path)]
    if full == "block":
        assert (stored, kernel.exit_status, caplog.text) == (list(range(heavy.n)), 0, "")
    else:
        assert (stored == sorted(stored), kernel.exit_status) == (True, 1)
        assert f"is not complete: {heavy.n - len(stored)} samples that were sent are not in it" in caplog.text


@simulated
async def test_in_virtual_time_a_slow_disk_is_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    put, path = LockedFile.put, tmp_path / "run.mcap"
    monkeypatch.setattr(beside, "_FULL", 0.05)

    def slow(self: LockedFile, parts: list[memoryview]) -> int:
        time.sleep(0.005)
        return put(self, parts)

    monkeypatch.setattr(LockedFile, "put", slow)
    async with Kernel(services=settings(path)) as kernel:
        heavy = await kernel.add(Heavy("heavy"))
        await kernel.start(PeriodicContext(10.0), heavy, activate=True)
        await kernel.sleep(1.0)
    assert [record.tm for _, _, record in read(path)] == list(range(heavy.n))
    assert kernel.exit_status == 0


class Clinging(Component):
    """Lets its kernel wait for it as long as that waits."""

    def on_execute(self) -> None:
        pass

    async def on_deactivated(self) -> None:
        while True:
            with contextlib.suppress(asyncio.CancelledError):
                await asyncio.sleep(100.0)
            if self.clock.time() > 60.0:
                break


@simulated
async def test_a_kernel_whose_time_is_over_closes_the_file_all_the_same(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    async with Kernel(services=settings(path)) as kernel:
        source, clinging = await kernel.add(Source("source")), await kernel.add(Clinging("clinging"))
        await kernel.start(PeriodicContext(10.0), source, clinging, activate=True)
        source.send(1, 2, 3)
    assert data(path) == {"source.out": [1, 2, 3]}
    with RecordingReader(path) as reader:
        assert reader.clean


@pytest.mark.slow(kept_by="test_a_kernel_whose_time_is_over_closes_the_file_all_the_same")
@pytest.mark.fault("B17")
@pytest.mark.anyio
async def test_a_file_that_is_not_closed_in_time_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    closing = threading.Event()

    def stuck(self: LockedFile, parts: list[memoryview]) -> int:
        closing.wait(10.0)
        raise OSError(5, "no more")

    path = tmp_path / "run.mcap"
    async with Kernel(services=settings(path)) as kernel:
        source = await kernel.add(Source("source"))
        await kernel.start(EventContext(), source, activate=True)
        monkeypatch.setattr(LockedFile, "put", stuck)
        source.send(1)
        monkeypatch.setattr(StopBudget, "left", 0.05)
    assert "run.mcap: was not closed in time; what is in it is whole, what still waited is lost" in caplog.text
    assert kernel.exit_status == 1
    closing.set()
    session: Any = kernel.attached(Beside)._session  # type: ignore[union-attr]
    assert session.wait_closed(10.0)


@simulated
async def test_a_port_whose_type_is_another_is_told_and_not_recorded(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    class Other(Component):
        out = OutPort(TimedDouble)

    path = tmp_path / "run.mcap"
    async with Kernel(services=settings(path)) as kernel:
        one = await kernel.add(Source("one"))
        await kernel.start(EventContext(), one, activate=True)
        one.send(1)
        await kernel.remove(one)
        other = await kernel.add(Other("one"))
        other.out.write_nowait(TimedDouble(0, 1.5))
    assert data(path) == {"one.out": [1]}
    assert "one.out: is recorded as TimedLong, and sends TimedDouble now, which is not recorded" in caplog.text
    assert kernel.exit_status == 1


@simulated
async def test_it_records_into_one_file_alone(tmp_path: Path) -> None:
    async with Kernel(services=settings(tmp_path / "a.mcap")) as kernel:
        with pytest.raises(ConfigurationError, match=r"records into .*a\.mcap already"):
            kernel.service(Beside).configure(Beside.settings(file=tmp_path / "b.mcap"))


@simulated
async def test_a_system_that_is_built_in_a_program_records_too(folder: Path) -> None:
    (folder / "system.toml").write_text(SYSTEM + '[record]\nfile = "run.mcap"\nmin_free = 0.0\n')
    async with Kernel() as kernel:
        await build(kernel, load(folder / "system.toml"))
        await wait_finished(kernel)
    assert data(folder / "run.mcap") == {"one.out": ALL, "other.out": ALL}
