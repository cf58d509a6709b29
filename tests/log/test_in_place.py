"""`aiorts run --replay` and `aiorts replay`: what was recorded, in the place of who sent it."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from aiorts.model.lifecycle import HOOKS
from aiorts.testing import check_service
from aiorts.types import TimedDouble, TimedLong
from aiorts_log import RecordingWriter
from aiorts_log.playing import in_place
from aiorts_log.playing.in_place import InPlace
from log_parts import BEGIN, MS, read
from run_parts import here

PARTS = '''\
from aiorts import Component, InPort, OutPort
from aiorts.types import TimedLong

class Camera(Component):
    """Needs a device that is not there."""
    out = OutPort(TimedLong)
    wanted = InPort(TimedLong)
    def on_initialize(self):
        raise RuntimeError("no camera")
    async def on_activated(self):
        raise RuntimeError("no camera")
    async def on_execute(self):
        raise RuntimeError("no camera")

class Both(Component):
    """Sends of itself."""
    left = OutPort(TimedLong)
    right = OutPort(TimedLong)
    def on_execute(self):
        self.left.write_nowait(TimedLong(0, -1))
        self.right.write_nowait(TimedLong(0, -2))
        self.finish()

class Double(Component):
    into = InPort(TimedLong)
    out = OutPort(TimedLong)
    def on_execute(self):
        for sample in self.into.drain():
            self.out.write_nowait(TimedLong(0, 2 * sample.data))
'''
SYSTEM = """\
schema = 1
[components.camera]
type = "parts.py:Camera"
[components.double]
type = "parts.py:Double"
[components.both]
type = "parts.py:Both"
[[connections]]
from = "camera.out"
to = "double.into"
length = 100
[[connections]]
from = "double.out"
to = "camera.wanted"
full = "block"
timeout = 100.0
[contexts.sources]
kind = "periodic"
rate = 100.0
members = ["camera", "both"]
[contexts.readers]
kind = "event"
members = ["double"]
"""
COUNT = 30


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "parts.py").write_text(PARTS)
    (tmp_path / "system.toml").write_text(SYSTEM)
    with RecordingWriter(tmp_path / "run.mcap") as writer:
        ports = [writer.add_port(name, TimedLong) for name in ("camera.out", "both.left")]
        for i in range(COUNT):
            for port in ports:
                assert writer.write(port, TimedLong(BEGIN + i * MS, i), BEGIN + i * MS)
    return tmp_path


def answers(folder: Path) -> dict[str, list[int]]:
    found: dict[str, list[int]] = {}
    for port, _, sample in read(folder / "answer.mcap"):
        found.setdefault(port, []).append(sample.data)
    return found


@pytest.mark.parametrize("kind", ["periodic", "thread"])
def test_the_recording_stands_for_a_component_that_is_not_started_and_the_others_answer(
    folder: Path, kind: str
) -> None:
    (folder / "system.toml").write_text(SYSTEM.replace('"periodic"', f'"{kind}"'))
    done = here(
        folder, "run", "system.toml", "--replay", "run.mcap", "--replay-speed", "100", "--record", "answer.mcap"
    )
    assert done.returncode == 0, done.stderr
    assert answers(folder) == {
        "camera.out": [*range(COUNT)],
        "double.out": [*range(0, 2 * COUNT, 2)],
        "both.left": [-1],
        "both.right": [-2],
    }
    assert done.stderr.splitlines() == [
        "aiorts: warning: both: runs, and its recorded ports are not replayed: both.right was not recorded; "
        "--replay-port both.left replays what was"
    ]


SLOW = """

import asyncio

class Slow(Component):
    into = InPort(TimedLong)
    async def on_execute(self):
        self.into.read_nowait()
        await asyncio.sleep(0.25)
"""
SLOWLY = """\
schema = 1
[components.camera]
type = "parts.py:Camera"
[components.slow]
type = "parts.py:Slow"
[[connections]]
from = "camera.out"
to = "slow.into"
length = 12
full = "overwrite"
[contexts.sources]
kind = "periodic"
rate = 100.0
members = ["camera"]
[contexts.readers]
kind = "event"
members = ["slow"]
"""


@pytest.mark.slow
@pytest.mark.parametrize(("patience", "status"), [(60, 0), (1, 1)])
def test_a_replay_says_for_which_unread_samples_it_goes_on_and_for_how_long(
    folder: Path, monkeypatch: pytest.MonkeyPatch, patience: int, status: int
) -> None:
    monkeypatch.setattr(in_place, "_PATIENCE", float(patience))
    (folder / "parts.py").write_text(PARTS + SLOW)
    (folder / "system.toml").write_text(SLOWLY)
    done = here(folder, "replay", "run.mcap", "system.toml", "--speed", "1000")
    assert done.returncode == status, done.stderr
    (said,) = [line for line in done.stderr.splitlines() if "W-UNREAD" in line]
    assert re.fullmatch(
        r"aiorts: W-UNREAD: every source has ended, and the run waits until the last samples are read, for "
        rf"{patience} s more at the most: camera.out-slow.into \d+; Ctrl-C ends it now",
        said,
    ), said
    assert ("E-UNREAD" in done.stderr) is bool(status)


def test_named_ports_alone_are_replayed_and_the_other_ports_of_their_component_are_silent(folder: Path) -> None:
    words = ("--port", "*.out", "--port", "both.*", "--end", "+0.01", "--loop", "2", "--absolute", "--simulate")
    (folder / "system.toml").write_text(SYSTEM + '[record]\nfile = "answer.mcap"\n')
    done = here(folder, "replay", "run.mcap", "system.toml", *words)
    assert (done.returncode, done.stderr) == (
        0,
        "aiorts: warning: both: is replayed, and sends nothing from both.right\n",
    )
    twice = [*range(10)] * 2
    assert answers(folder) == {"camera.out": twice, "both.left": twice, "double.out": [2 * n for n in twice]}
    stamps = {sample.tm for port, _, sample in read(folder / "answer.mcap") if port == "camera.out"}
    assert min(stamps) == BEGIN


MACHINES = """\
from aiorts import InPort, OutPort
from aiorts import MultiModeComponent, StateMachineComponent
from aiorts.statechart import Chart, On, State
from aiorts.types import TimedLong

class Door(StateMachineComponent):
    chart = Chart(State("closed", On("into", to="open"), initial=True, entry="note"), State("open", entry="note"))
    into = InPort(TimedLong)
    out = OutPort(TimedLong)
    def note(self, data=None):
        self.out.write_nowait(TimedLong(0, -5))

class Lamp(MultiModeComponent):
    modes = ("dark", "bright")
    out = OutPort(TimedLong)
    def on_execute_dark(self):
        self.out.write_nowait(TimedLong(0, -6))
"""


@pytest.mark.parametrize("kind", ["Door", "Lamp"])
def test_a_state_machine_and_modes_are_replayed_and_do_nothing_of_themselves(folder: Path, kind: str) -> None:
    (folder / "machines.py").write_text(MACHINES)
    system = SYSTEM.replace("parts.py:Camera", f"machines.py:{kind}").partition('[[connections]]\nfrom = "double.out"')[
        0
    ]
    system += '[contexts.all]\nkind = "periodic"\nrate = 100.0\nmembers = ["camera", "double", "both"]\n'
    (folder / "system.toml").write_text(system)
    words = ("--simulate", "--record", "answer.mcap", "--record-port", "camera.out")
    done = here(folder, "run", "system.toml", "--replay", "run.mcap", *words)
    assert done.returncode == 0, done.stderr
    assert "ChartWarning" not in done.stderr
    assert answers(folder) == {"camera.out": [*range(COUNT)]}


SERVED = """\
from typing import Protocol

from aiorts import Component, OutPort, Provided, Required
from aiorts.errors import ServiceUnavailable
from aiorts.types import TimedLong

class Zoom(Protocol):
    async def zoom(self, to: float) -> float: ...
    def now(self) -> float: ...

class Camera(Component):
    out = OutPort(TimedLong)
    lens = Provided[Zoom]("optics")
    own = Provided[Zoom](always=True, failure="error")
    def on_initialize(self):
        self.optics = self
    async def zoom(self, to: float) -> float:
        raise RuntimeError("the camera's code ran")
    def now(self) -> float:
        raise RuntimeError("the camera's code ran")

class Asks(Component):
    lens = Required[Zoom]()
    own = Required[Zoom]()
    async def on_execute(self):
        for end in (self.lens, self.own):
            try:
                await end.proxy.zoom(2.0)
            except ServiceUnavailable as error:
                print(error)
            try:
                end.proxy.now()
            except ServiceUnavailable as error:
                print(error)
        self.finish()
"""
SERVING = """\
schema = 1
[components.camera]
type = "served.py:Camera"
[components.asks]
type = "served.py:Asks"
[[connections]]
from = "asks.lens"
to = "camera.lens"
[[connections]]
from = "asks.own"
to = "camera.own"
[contexts.all]
kind = "periodic"
rate = 100.0
members = ["camera", "asks"]
"""


def test_a_call_of_one_that_is_replayed_is_refused_and_says_why(folder: Path) -> None:
    (folder / "served.py").write_text(SERVED)
    (folder / "served.toml").write_text(SERVING)
    done = here(folder, "run", "served.toml", "--replay", "run.mcap", "--simulate")
    assert done.returncode == 0, done.stderr
    calls = [f"{end}.{method}" for end in ("lens", "own") for method in ("zoom", "now")]
    refused = "it is replayed, and none of its code runs"
    assert done.stdout.splitlines() == [f"asks.{name.partition('.')[0]} -> camera.{name}: {refused}" for name in calls]


CHECKED = """\
from aiorts import Component, OutPort
from aiorts.types import record

@record
class Level:
    tm: int = 0
    data: float = 0.0
    def __post_init__(self):
        assert self.data >= CHECKS

class Source(Component):
    out = OutPort(Level)
    count = 0
    def on_execute(self):
        self.count += 1
        self.out.write_nowait(Level(self.clock.time_ns(), -1.0 if self.count in (3, 5) else float(self.count)))
        if self.count == 8:
            self.finish()
"""


def test_samples_that_their_own_class_refuses_are_left_out_and_the_run_ends(folder: Path) -> None:
    """It never ended, without a word: the error of the class had ended the replay alone."""
    (folder / "levels.py").write_text(CHECKED.replace("CHECKS", "-9.0"))
    system = 'schema = 1\ncomponents.source.type = "levels.py:Source"\n'
    system += 'contexts.all = { kind = "periodic", rate = 100.0, members = ["source"] }\n'
    (folder / "levels.toml").write_text(system)
    assert here(folder, "run", "levels.toml", "--simulate", "--record", "levels.mcap").returncode == 0
    (folder / "levels.py").write_text(CHECKED.replace("CHECKS", "0.0"))
    done = here(folder, "run", "levels.toml", "--replay", "levels.mcap", "--simulate", "--print", "*")
    assert done.returncode == 1, done.stderr
    assert "2 samples are none of their type" in done.stderr
    assert [json.loads(line)["data"] for line in done.stdout.splitlines()] == [1.0, 2.0, 4.0, 6.0, 7.0, 8.0]


def test_replay_prints_what_the_run_with_the_same_recording_prints(folder: Path) -> None:
    given = ("--simulate", "--print", "double.out")
    done = here(folder, "replay", "run.mcap", "system.toml", "--absolute", *given)
    same = here(folder, "run", "system.toml", "--replay", "run.mcap", "--replay-absolute", *given)
    assert (done.returncode, done.stdout) == (same.returncode, same.stdout)
    assert done.stdout.count("double.out") == COUNT


def test_no_hook_of_a_component_that_is_replayed_is_left_out() -> None:
    assert {*in_place._HOOKS} == {*HOOKS}


def test_alone_it_prints_the_samples(folder: Path) -> None:
    done = here("replay", folder / "run.mcap", "--speed", "max", "--port", "both.left", "--absolute")
    assert (done.returncode, done.stderr) == (0, "")
    said = [json.loads(line) for line in done.stdout.splitlines()]
    assert [(one["port"], one["tm"], one["data"]) for one in said] == [
        ("both_left", BEGIN + i * MS, i) for i in range(COUNT)
    ]


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("--replay", "none.mcap"), "none.mcap"),
        (
            ("--replay", "run.mcap", "--replay-port", "camera.ouf"),
            "has no port 'camera.ouf'; did you mean 'camera.out'?",
        ),
        (("--replay", "run.mcap", "--replay-start", "+3", "--replay-end", "+2"), "start is not before end"),
        (("--replay", "run.mcap", "--replay-start", "soon"), "replay: start: expected +SECONDS or seconds since 1970"),
        (("--replay", "other.mcap"), "camera.out was recorded as TimedDouble, and sends TimedLong here"),
        (("--replay", "else.mcap"), "no component here has its out-ports among those recorded: arm.angle"),
        (("--replay-speed", "2"), "nothing says what to replay"),
        (("--replay", "run.mcap", "--replay-loop", "-1"), "loop: expected a whole number from 0"),
    ],
)
def test_what_cannot_be_replayed_is_said_before_anything_runs(folder: Path, words: tuple[str, ...], why: str) -> None:
    for name, port in (("other", "camera.out"), ("else", "arm.angle")):
        with RecordingWriter(folder / f"{name}.mcap") as writer:
            writer.write(writer.add_port(port, TimedDouble), TimedDouble(0, 1.0), BEGIN)
    (folder / "system.toml").write_text(SYSTEM.replace('"parts.py:Camera"', '"good.py:Camera"'))
    (folder / "good.py").write_text(PARTS.replace("raise", "return\n        raise"))
    done = here(folder, "run", "system.toml", *words)
    assert done.returncode == 2
    assert why in done.stderr
    assert "Traceback" not in done.stderr


def test_it_is_a_service() -> None:
    check_service(InPlace)
