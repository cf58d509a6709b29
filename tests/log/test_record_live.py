"""`aiorts record`: what runs in another process, in a file like that of a recorder beside the run."""

from __future__ import annotations

import asyncio
import json
import random
import signal
import subprocess
import sys
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path

import msgpack
import pytest

from aiorts import Component, InPort, Kernel, OutPort, Param, PeriodicContext
from aiorts.types import TimedDouble, TimedLong
from aiorts_log import RecordingReader
from campaign import cases, time_limit
from control_parts import WAIT, controlled, running, until
from run_parts import here, limited
from runtime_parts import runtime as runtime

COMPONENTS = '''\
from dataclasses import dataclass
from aiorts import Component, OutPort
from aiorts.types import TimedDouble, TimedDoubleSeq, record

@dataclass
class Mine:
    """Of this file alone."""
    name: str = ""
    x: float = 0.0

@record
class Base:
    tm: int = 0
    x: float = 0.0

@record
class Derived(Base):
    y: float = 0.0

class Source(Component):
    out = OutPort(TimedDouble, unit="m")
    mine = OutPort(Mine)
    more = OutPort(TimedDoubleSeq)
    kinds = OutPort(Base)
    n = 0

    def on_execute(self):
        self.n += 1
        n = self.n
        self.out.write_nowait(TimedDouble(n, n))
        self.mine.write_nowait(Mine("a" * (n % 7), n / 2))
        self.more.write_nowait(TimedDoubleSeq(n, [n] * (n % 5)))
        self.kinds.write_nowait(Base(n, n) if n % 3 else Derived(n, n, -n))
'''
SYSTEM = """\
schema = 1
[components.one]
type = "parts.py:Source"
[components.other]
type = "parts.py:Source"
[contexts.loop]
kind = "periodic"
rate = 200.0
members = ["one", "other"]
"""
PORTS = [f"{name}.{port}" for name in ("one", "other") for port in ("out", "mine", "more", "kinds")]


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "parts.py").write_text(COMPONENTS)
    (tmp_path / "system.toml").write_text(SYSTEM)
    return tmp_path


def recorded(*words: object) -> tuple[int, str, str]:
    """`aiorts record WORDS` in this process: exit status, standard output, standard error."""
    done = here("record", *map(str, words), "--min-free", "0", "--timeout", str(WAIT))
    return done.returncode, done.stdout, done.stderr


@contextmanager
def recording(*words: object) -> Iterator[subprocess.Popen[str]]:
    """The same in a process of its own, from when it records."""
    process = subprocess.Popen(
        [sys.executable, "-m", "aiorts", "record", *map(str, words), "--min-free", "0", "--timeout", str(WAIT)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stderr is not None
    with limited(process):
        assert "; Ctrl-C ends it" in process.stderr.readline()
        try:
            yield process
        finally:
            process.kill()
            process.communicate(timeout=WAIT)


@asynccontextmanager
async def recording_meanwhile(*words: object) -> AsyncIterator[subprocess.Popen[str]]:
    """The same beside a kernel of this process."""
    made = recording(*words)
    process = await asyncio.to_thread(made.__enter__)
    try:
        yield process
    finally:
        await asyncio.to_thread(made.__exit__, None, None, None)


async def seen(kernel: Kernel, taps: int) -> None:
    """Wait until so many ports are recorded."""
    async with asyncio.timeout(WAIT):
        while len(kernel.profile().services.get("tool", {}).get("connectors", ())) != taps:
            await asyncio.sleep(0.01)


def messages(path: Path) -> dict[str, list[tuple[str, bytes]]]:
    """Of each port, its samples to the byte, with the type of each."""
    with RecordingReader(path) as reader:
        assert (reader.clean, reader.damage, reader.check()) == (True, (), ())
        # A derived type has a channel of its own, whose number is behind the port's name.
        found: dict[str, list[tuple[str, bytes]]] = {name.partition("#")[0]: [] for name in reader.ports}
        for sample in reader.samples():
            found[sample.port.name.partition("#")[0]].append((sample.port.type_name, bytes(sample.data)))
    return found


def stamps(path: Path, port: str) -> list[int]:
    """The publish times of a port."""
    with RecordingReader(path) as reader:
        return [sample.publish_time for sample in reader.samples(ports=[port])]


def numbers(path: Path, port: str = "source0.out") -> list[int]:
    """The data of a port that writes 1, 2, 3 ..."""
    with RecordingReader(path) as reader:
        return [int(one.data) for _, _, one in reader.records(ports=[port])]


# -- the same as beside the run ----------------------------------------------------------------------------------------


@pytest.mark.slow(kept_by="test_it_ends_after_so_many_samples_and_continues_a_file")
def test_a_recording_has_what_one_beside_the_run_has(folder: Path) -> None:
    live, beside, system = folder / "live.mcap", folder / "beside.mcap", folder / "system.toml"
    system.write_text(f'{SYSTEM}[record]\nfile = "{beside}"\nmin_free = 0\n')
    with running("both", str(system)) as process:
        status, out, _ = recorded("-o", live, "--for", "0.7")
        assert (status, out) == (0, "")
        assert here("stop", "both/").returncode == 0
        process.wait(WAIT)
    ours, theirs = messages(live), messages(beside)
    assert sorted(ours) == sorted(theirs) == sorted(PORTS)
    for port in PORTS:
        assert len(ours[port]) > 20
        assert any(theirs[port][at : at + len(ours[port])] == ours[port] for at in range(len(theirs[port])))
    assert stamps(live, "one.out") == [int(one) for one in numbers(live, "one.out")]
    assert {name for name, _ in ours["one.kinds"]} == {name for name, _ in theirs["one.kinds"]}
    with RecordingReader(live) as one, RecordingReader(beside) as other:
        assert _described(one) == _described(other)
        assert _file(one) == _file(other) == system.read_bytes()
        (first,), (second,) = one.metadata, other.metadata
        assert {**first, "begun_ns": 0, "recorder": ""} == {**second, "begun_ns": 0, "recorder": ""}


def _file(reader: RecordingReader) -> bytes:
    return next(bytes(one.data) for one in reader.attachments() if one.name == "system.toml")


def _described(reader: RecordingReader) -> set[tuple[object, ...]]:
    return {
        (name.partition("#")[0], port.encoding, str(port.metadata), port.schema and port.schema[1:])
        for name, port in reader.ports.items()
    }


class Source(Component):
    """Writes so many numbers in a cycle, once it is let."""

    out = OutPort(TimedLong)
    burst = Param(1)
    most = Param(0)
    goes = False
    n = 0

    def on_execute(self) -> None:
        for _ in range(self.burst if self.goes else 0):
            if self.most and self.n >= self.most:
                self.goes = False
                return
            self.n += 1
            self.out.write_nowait(TimedLong(self.n, self.n))


@pytest.mark.slow(kept_by="test_it_ends_after_so_many_samples_and_continues_a_file")
@pytest.mark.fault("B17")
@pytest.mark.parametrize("burst", [1, 40, 2000])
@pytest.mark.anyio
async def test_of_a_port_all_that_was_written_is_recorded_or_counted(burst: int, tmp_path: Path) -> None:
    path, most = tmp_path / "flood.mcap", 100 * burst
    async with Kernel(services={"control": {"name": "flood"}}) as kernel:
        source = await kernel.create(Source, "source0", burst=burst, most=most)
        await kernel.start(PeriodicContext(rate=200.0), source, activate=True)
        async with recording_meanwhile("-o", path, "--json") as process:
            source.goes = True
            while source.n < most:
                await kernel.sleep(0.01)
            await kernel.remove(source)
            await kernel.sleep(0.2)
            process.send_signal(signal.SIGINT)
            out, said = await asyncio.to_thread(process.communicate, timeout=WAIT)
    assert process.returncode == 130
    found = json.loads(out)["ports"]["source0.out"]
    got = numbers(path)
    assert found["recorded"] == len(got) > 0
    assert found["recorded"] + found["dropped"] == most
    assert got == sorted(set(got))
    assert bool(found["dropped"]) == ("W-DROPPED: source0.out: " in said)
    assert found["dropped"] or burst < 2000
    with RecordingReader(path) as reader:
        (ending,) = reader.endings
        assert ending["dropped"].get("source0.out", 0) == found["dropped"]


SIMULATED = """\
from pathlib import Path
from aiorts import Component, OutPort
from aiorts.types import TimedLong

class Late(Component):
    \"\"\"Sends 200 numbers as soon as a file is there.\"\"\"
    out = OutPort(TimedLong)
    n = 0
    def on_execute(self):
        if self.n or Path(__file__).with_name("go").exists():
            self.n += 1
            self.out.write_nowait(TimedLong(self.n, self.n))
            if self.n == 200:
                self.finish()
"""


@pytest.mark.slow(kept_by="test_it_ends_after_so_many_samples_and_continues_a_file")
def test_in_simulated_time_nothing_is_lost_and_times_are_the_kernels(tmp_path: Path) -> None:
    live, beside, system = tmp_path / "live.mcap", tmp_path / "beside.mcap", tmp_path / "system.toml"
    (tmp_path / "late.py").write_text(SIMULATED)
    system.write_text(
        f'schema = 1\n[components.late]\ntype = "late.py:Late"\n[contexts.loop]\nkind = "periodic"\nrate = 100.0\n'
        f'members = ["late"]\n[record]\nfile = "{beside}"\nmin_free = 0\n'
    )
    with running("virtual", str(system), "--simulate") as process, recording("-o", live) as recorder:
        (tmp_path / "go").touch()
        _, said = recorder.communicate(timeout=WAIT)
        assert process.wait(WAIT) == 0
    assert (recorder.returncode, "W-DROPPED" in said) == (0, False)
    with RecordingReader(live) as ours, RecordingReader(beside) as theirs:
        # A frame may be packed in more than one way: what it says is the same.
        here, there = ([(*one[1:-1], msgpack.unpackb(one[-1])) for one in each.samples()] for each in (ours, theirs))
        assert here == there
        assert ours.count == 200


# -- what ends it ------------------------------------------------------------------------------------------------------


@pytest.mark.slow(kept_by="test_it_ends_after_so_many_samples_and_continues_a_file")
@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_a_signal_ends_it_in_order(number: int, status: int, folder: Path) -> None:
    path = folder / "run.mcap"
    with running("signals", str(folder / "system.toml")), recording("one.out", "-o", path) as process:
        until(lambda: path.stat().st_size > 2000)
        process.send_signal(number)
        _, said = process.communicate(timeout=WAIT)
        assert process.returncode == status
        assert f"{path}: {len(numbers(path, 'one.out'))} samples of 1 port" in said
        assert "Traceback" not in said
    assert set(messages(path)) == {"one.out"}


@pytest.mark.slow(kept_by="test_it_ends_after_so_many_samples_and_continues_a_file")
@pytest.mark.parametrize("how", ["stop", "kill"])
def test_the_end_of_the_kernel_ends_it_with_a_whole_file(how: str, folder: Path) -> None:
    path = folder / "run.mcap"
    with running("ends", str(folder / "system.toml")) as run, recording("-o", path) as process:
        until(lambda: path.stat().st_size > 2000)
        if how == "kill":
            run.kill()
        else:
            assert here("stop", "ends/").returncode == 0
        _, said = process.communicate(timeout=WAIT)
    assert process.returncode == 0
    assert "aiorts: ends: " in said
    assert (" without an end of its ports; " in said) == (how == "kill")
    got = numbers(path, "one.out")
    assert got == list(range(got[0], got[-1] + 1))
    messages(path)


@pytest.mark.slow(kept_by="test_it_ends_after_so_many_samples_and_continues_a_file")
@pytest.mark.anyio
async def test_one_that_is_killed_leaves_a_file_that_can_be_read_and_nothing_in_the_kernel(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    async with controlled("lasts") as kernel, recording_meanwhile("-o", path) as process:
        await asyncio.to_thread(until, lambda: path.stat().st_size > 2000)
        await seen(kernel, 1)
        process.kill()
        await asyncio.to_thread(process.communicate, timeout=WAIT)
        await seen(kernel, 0)
    got = numbers(path, "counter0.out")
    assert len(got) > 3
    assert got == list(range(got[0], got[-1] + 1))


@pytest.mark.slow(kept_by="test_it_ends_after_so_many_samples_and_continues_a_file")
@pytest.mark.fault("D01")
@pytest.mark.timeout(time_limit(1200))
@pytest.mark.anyio
async def test_killed_at_any_moment_what_can_be_read_has_no_gap(tmp_path: Path) -> None:
    chosen = random.Random(16)
    async with controlled("victim", rate=500.0) as kernel:
        for number in range(cases(200)):
            path = tmp_path / f"{number}.mcap"
            async with recording_meanwhile("-o", path) as process:
                await asyncio.sleep(chosen.random() * 0.5)
                process.kill()
            with RecordingReader(path) as reader:
                assert reader.check() == ()
                got = [int(one.data) for _, _, one in reader.records()]
            assert not got or got == list(range(got[0], got[-1] + 1))
            await seen(kernel, 0)


@pytest.mark.slow(kept_by="test_it_ends_after_so_many_samples_and_continues_a_file")
@pytest.mark.fault("D03")
def test_a_disk_that_is_full_ends_it_with_what_is_whole(folder: Path) -> None:
    path = folder / "run.mcap"
    words = [
        sys.executable,
        "-m",
        "aiorts",
        "record",
        "one.out",
        "other.out",
        "-o",
        str(path),
        "--min-free",
        "0",
        "--timeout",
        str(WAIT),
    ]
    with running("full", str(folder / "system.toml")):
        done = subprocess.run(
            ["/bin/sh", "-c", 'ulimit -f 16; exec "$@"', "sh", *words], capture_output=True, text=True, timeout=WAIT
        )
    assert done.returncode == 1
    with RecordingReader(path) as reader:
        assert (reader.damage, reader.check()) == ((), ())
        held = f"recording ended: File too large; the {reader.count} samples up to there are whole"
    assert f"aiorts: E-RECORDING: {path}: {held}" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.slow(kept_by="test_it_ends_after_so_many_samples_and_continues_a_file")
@pytest.mark.anyio
async def test_a_file_that_is_deleted_meanwhile_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    async with controlled("deleted"), recording_meanwhile("-o", path) as process:
        path.unlink()
        assert process.stderr is not None
        line = await asyncio.to_thread(process.stderr.readline)
    assert line.startswith(f"aiorts: E-RECORDING: {path}: was deleted or renamed while it is recorded")


@pytest.mark.anyio
async def test_it_ends_after_so_many_samples_and_continues_a_file(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    async with controlled("enough"):
        status, out, _ = await asyncio.to_thread(recorded, "counter0.out", "-o", path, "--count", "7", "--json")
        assert (status, len(numbers(path, "counter0.out"))) == (0, 7)
        found = json.loads(out)
        assert (found["samples"], found["ports"]) == (7, {"counter0.out": {"recorded": 7, "dropped": 0}})
        assert found["bytes"] == path.stat().st_size
        assert (await asyncio.to_thread(recorded, "-o", path, "--count", "3", "--append"))[0] == 0
    assert len(numbers(path, "counter0.out")) == 10


# -- which ports -------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "ports"),
    [
        ((), {"one.out", "one.aside", "other.out", "other.aside"}),
        (("--all", "-x", "other"), {"one.out", "one.aside"}),
        (("one",), {"one.out", "one.aside"}),
        (("which/one.out",), {"one.out"}),
        (("*.out",), {"one.out", "other.out"}),
        (("o*.as*", "--exclude", "oth*"), {"one.aside"}),
        (("which/", "--exclude", "*.aside"), {"one.out", "other.out"}),
        (("which/", "one.out", "-x", "*.aside"), {"one.out", "other.out"}),
    ],
)
@pytest.mark.anyio
async def test_words_mean_ports(words: tuple[str, ...], ports: set[str], tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    async with two_components("which"):
        assert (await asyncio.to_thread(recorded, *words, "-o", path, "--for", "0.05"))[0] == 0
    assert set(messages(path)) == ports


@pytest.mark.parametrize(
    ("words", "status", "said"),
    [
        (("one.ouut",), 6, "E-ABSENT: one.ouut: no such port; did you mean one.out?"),
        (("one.inn",), 6, "E-ABSENT: one.inn: is an in-port; out-ports are recorded, such as one."),
        (("nothing",), 6, "E-ABSENT: nothing: nothing that runs has this name; "),
        (("one.x*",), 6, "E-ABSENT: one.x*: has no out-port; there are one."),
        (("--all", "one"), 2, "--all goes not with names"),
        (("--append", "--overwrite"), 2, "--append goes not with --overwrite"),
        (("-o", "-"), 2, "E-RECORDING: -o -: a recording has its index at its end and needs a file"),
        (("-o", "run.csv"), 2, "E-RECORDING: run.csv: a recording is MCAP; record run.mcap, and `aiorts log convert"),
        (("-o", "nowhere/run.mcap"), 2, "E-RECORDING: nowhere/run.mcap: there is no folder "),
        (("-o", "/dev/full"), 2, "E-RECORDING: /dev/full: is no regular file; a recording needs one"),
    ],
)
@pytest.mark.anyio
async def test_what_cannot_be_recorded_is_refused_and_leaves_no_file(
    words: tuple[str, ...], status: int, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    async with two_components("refuses"):
        found = await asyncio.to_thread(recorded, *words)
    assert (found[0], found[1]) == (status, "")
    assert said in found[2]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.anyio
async def test_a_file_that_is_there_is_kept_unless_it_is_to_be_replaced(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(b"mine")
    async with controlled("kept"):
        status, _, said = await asyncio.to_thread(recorded, "-o", path)
        assert (status, path.read_bytes()) == (2, b"mine")
        assert f"{path}: exists already; --append continues it, --overwrite replaces it" in said
        assert (await asyncio.to_thread(recorded, "-o", path, "--overwrite", "--count", "1"))[0] == 0
    assert len(numbers(path, "counter0.out")) == 1


@pytest.mark.anyio
async def test_the_file_is_named_after_the_kernel_and_the_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    async with controlled("dated"):
        assert (await asyncio.to_thread(recorded, "--count", "1"))[0] == 0
    (path,) = tmp_path.iterdir()
    assert path.match("dated-????????T??????Z.mcap")


@pytest.mark.slow(kept_by="test_it_ends_after_so_many_samples_and_continues_a_file")
@pytest.mark.anyio
async def test_more_ports_than_one_session_may_tap_are_recorded(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    async with controlled("many") as kernel:
        many = await kernel.create(Ported, "many")
        outs = [many.add_port(f"out{number}", OutPort(TimedLong)) for number in range(450)]
        async with recording_meanwhile("many", "-o", path) as process:
            await seen(kernel, 452)
            for number, out in enumerate(outs):
                out.write_nowait(TimedLong(number, number))
            process.send_signal(signal.SIGINT)
            _, said = await asyncio.to_thread(process.communicate, timeout=WAIT)
    assert f"{path}: 450 samples of 452 ports" in said
    assert {name: len(found) for name, found in messages(path).items() if found} == {
        f"many.out{number}": 1 for number in range(450)
    }


class Ported(Component):
    """Two out-ports and an in-port."""

    out = OutPort(TimedDouble)
    aside = OutPort(TimedDouble)
    inn = InPort(TimedDouble)


@asynccontextmanager
async def two_components(name: str) -> AsyncIterator[Kernel]:
    async with Kernel(services={"control": {"name": name}}) as kernel:
        one, other = await kernel.create(Ported, "one"), await kernel.create(Ported, "other")
        await kernel.start(PeriodicContext(rate=100.0), one, other, activate=True)
        yield kernel


@pytest.mark.slow(kept_by="test_it_ends_after_so_many_samples_and_continues_a_file")
@pytest.mark.anyio
async def test_ports_that_come_later_are_recorded_from_then_on(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    async with controlled("grows") as kernel, recording_meanwhile("*.out", "-x", "no*", "-o", path) as process:
        late = [await kernel.create(Source, name) for name in ("late", "nobody", "late2")]
        for one in late:
            one.goes = True
        await kernel.start(PeriodicContext(rate=100.0, name="second"), *late, activate=True)
        await seen(kernel, 3)
        await kernel.sleep(0.2)
        await kernel.remove(late[2])
        again = await kernel.create(Source, "late2")
        again.n, again.goes = 1000, True
        await kernel.start(PeriodicContext(rate=100.0, name="third"), again, activate=True)
        await seen(kernel, 3)
        await kernel.sleep(0.2)
        process.send_signal(signal.SIGINT)
        _, said = await asyncio.to_thread(process.communicate, timeout=WAIT)
    assert set(messages(path)) == {"counter0.out", "late.out", "late2.out"}
    assert len(numbers(path, "late.out")) > 0
    assert {one > 1000 for one in numbers(path, "late2.out")} == {False, True}
    assert "late2.out: its component was removed; it is recorded on when it is there again" in said
