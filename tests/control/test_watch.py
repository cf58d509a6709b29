"""`aiorts run --watch`: what is changed in the files of a system that runs is applied, or nothing is."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from aiorts import Kernel
from aiorts.cli.app import run_command
from aiorts.sessions import entries
from aiorts.system import build, load
from aiorts.types import TimedDouble
from aiorts_log import RecordingWriter
from control_parts import WAIT, until

PARTS = """
from aiorts import Component, InPort, OutPort, Param
from aiorts.types import TimedDouble


class Ramp(Component):
    out = OutPort(TimedDouble)
    step: float = Param(1.0)

    async def on_execute(self) -> None:
        self.out.write_nowait(TimedDouble(data=self.step))


class Meter(Component):
    inp = InPort(TimedDouble)

    async def on_execute(self) -> None:
        self.inp.drain()
"""
SYSTEM = """schema = 1
[components.ramp]
type = "parts.py:Ramp"
[components.meter]
type = "parts.py:Meter"
[[connections]]
from = "ramp.out"
to = "meter.inp"
length = 100
[contexts.work]
kind = "periodic"
rate = 100.0
members = ["ramp", "meter"]
"""


class Watched:
    """`aiorts run system.toml --watch` in a process of its own, and what it says."""

    def __init__(self, folder: Path, process: subprocess.Popen[bytes]) -> None:
        self.folder = folder
        self.process = process

    def write(self, old: str, new: str, name: str = "system.toml") -> None:
        """Put one text in the place of another, as an editor does: the file is never half written."""
        file = self.folder / name
        text = file.read_text()
        assert old in text
        (self.folder / "new").write_text(text.replace(old, new))
        (self.folder / "new").replace(file)

    @property
    def said(self) -> str:
        """All that it has said."""
        return (self.folder / "log").read_text()

    def says(self, *lines: str) -> None:
        """Wait until these have been said, in this order."""

        def found() -> bool:
            rest = self.said
            for line in lines:
                _, there, rest = rest.partition(line)
                if not there:
                    return False
            return True

        try:
            until(found)
        except AssertionError:
            raise AssertionError(self.said) from None


@contextmanager
def watched(folder: Path, window: str, *more: str, parts: str = PARTS, system: str = SYSTEM) -> Iterator[Watched]:
    (folder / "parts.py").write_text(parts)
    (folder / "system.toml").write_text(system)
    words = ("run", "system.toml", "--watch", "--window", window, "--name", "watched", *more)
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen([sys.executable, "-m", "aiorts", *words], cwd=folder, stdout=log, stderr=log)
    try:
        until(lambda: process.poll() is not None or any(one.name == "watched" for one in entries()))
        until(lambda: process.poll() is not None or is_there("meter"))
        yield Watched(folder, process)
    finally:
        process.kill()
        process.wait(WAIT)


def is_there(component: str) -> bool:
    return run_command(["cat", f"watched/{component}"]) == 0


@pytest.mark.slow(kept_by="test_where_nothing_can_be_watched")
def test_what_is_changed_is_applied_and_a_bad_file_changes_nothing(tmp_path: Path) -> None:
    with watched(tmp_path, "0.3") as one:
        one.write("length = 100", "length = 50")
        one.says("~ change ramp.out -> meter.inp: length 100 -> 50\n", "kept\n")
        one.write("length = 50", "length = fifty")
        one.says("E-SYSTEM: system.toml:9:", "length = fifty", "^")
        assert is_there("meter")
        one.write("length = fifty", "length = 60")
        one.says("length = fifty", "length 50 -> 60\n", "kept\n")
        one.write("step: float = Param(1.0)", "step: float = Param(1.0)\n    more: int = Param(7)", "parts.py")
        one.says("~ reload parts.py:Ramp: ramp\n", "~ reload parts.py:Meter: meter\n")
        one.write("schema = 1\n", 'schema = 1\ninclude = ["second.toml"]\n')
        one.says("second.toml: cannot be read")
        second = 'schema = 1\n[components.second]\ntype = "parts.py:Ramp"\nparams.more = 8\n'
        (tmp_path / "second.toml").write_text(second)
        one.says("+ create second (parts.py:Ramp)\n", "kept\n")
        one.write("more = 8", "more = 9", "second.toml")
        one.says("~ configure second: params.more 8 -> 9\n", "kept\n")
        one.write("class Ramp", "class Ramp(", "parts.py")
        one.says("E-PLUGIN: ", "parts.py")
        assert run_command(["plan", str(tmp_path / "system.toml"), "--live", "watched"]) == 2  # the file cannot be read
        assert one.process.poll() is None
        one.process.send_signal(signal.SIGINT)
        assert one.process.wait(WAIT) == 130


@pytest.mark.slow(kept_by="test_where_nothing_can_be_watched")
def test_a_change_that_makes_it_worse_is_taken_back(tmp_path: Path) -> None:
    bad = "class Bad(Ramp):\n    async def on_execute(self) -> None:\n        raise ValueError('no such device')\n"
    (tmp_path / "bad.py").write_text(f"{PARTS}\n{bad}")
    with watched(tmp_path, "0.5") as one:
        one.write("[contexts", '[components.bad]\ntype = "bad.py:Bad"\n[contexts')
        one.says("+ create bad (bad.py:Bad)\n", "kept\n")  # it is in no context
        one.write('"meter"]', '"meter", "bad"]')
        one.says("~ move work: +bad\n", "E-APPLY: taken back: bad", "no such device")
        system = tmp_path / "before.toml"
        system.write_text((tmp_path / "system.toml").read_text().replace(', "bad"', ""))
        assert run_command(["plan", str(system), "--live", "watched"]) == 0


@pytest.mark.slow(kept_by="test_where_nothing_can_be_watched")
def test_code_that_was_changed_while_no_component_was_of_it_is_the_new_one(tmp_path: Path) -> None:
    (tmp_path / "other.py").write_text(PARTS)
    with watched(tmp_path, "0") as one:
        one.write("[contexts", '[components.other]\ntype = "other.py:Ramp"\n[contexts')
        one.says("+ create other (other.py:Ramp)\n", "done\n")
        one.write('[components.other]\ntype = "other.py:Ramp"\n', "")
        one.says("- remove other", "done\n")
        one.write("step: float", "steps: float = Param(1.0)\n    step: float", "other.py")
        time.sleep(1.0)
        one.write("[contexts", '[components.other]\ntype = "other.py:Ramp"\nparams.steps = 3\n[contexts')
        one.says("- remove other", "+ create other (other.py:Ramp)\n", "done\n")


@pytest.mark.slow(kept_by="cli/test_plan.py::test_what_cannot_run_at_all_is_no_plan")
def test_what_cannot_run_is_told_with_its_place_and_the_code_that_runs_is_not_read_again(tmp_path: Path) -> None:
    with watched(tmp_path, "0") as run:
        run.write('"meter.inp"', '"meter.inq"')
        run.says("system.toml:8:6: connections[1].to: ", "inq")
        run.write("class Ramp", "clas Ramp", "parts.py")
        run.says("parts.py")
        run.write("clas Ramp", "class Ramp", "parts.py")
        run.write('"meter.inq"', '"meter.inp"')
        run.write("step: float = Param(1.0)", "step: float = Param(1.0)  # a comment", "parts.py")
        run.says("~ reload parts.py:Ramp: ramp", "done", "~ reload parts.py:Meter: meter", "done")
        assert run.said.count("~ reload parts.py:Ramp") == 1


@pytest.mark.slow(kept_by="test_where_nothing_can_be_watched")
def test_of_what_changes_during_a_window_the_newest_is_applied(tmp_path: Path) -> None:
    with watched(tmp_path, "3") as one:
        one.write("length = 100", "length = 1")
        one.says("length 100 -> 1\n")
        one.write("length = 1", "length = 2")
        time.sleep(0.6)
        one.write("length = 2", "length = 3")
        one.says("length 100 -> 1\n", "kept\n", "length 1 -> 3\n")
        assert "-> 2" not in one.said


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("system.toml", "--watch", "--simulate"), "--watch: no file can change while virtual time passes"),
        (("parts.py:Ramp", "--watch"), "--watch is for a system file"),
        (("system.toml", "--window", "1"), "--window is for --watch"),
    ],
)
def test_where_nothing_can_be_watched(
    words: tuple[str, ...],
    why: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "parts.py").write_text(PARTS)
    (tmp_path / "system.toml").write_text(SYSTEM)
    assert run_command(["run", *words]) == 2
    assert why in capsys.readouterr().err


@pytest.mark.slow(kept_by="test_where_nothing_can_be_watched")
@pytest.mark.anyio
async def test_a_type_whose_file_was_read_anew_for_another_one_is_named_as_before(tmp_path: Path) -> None:
    (tmp_path / "parts.py").write_text(PARTS)
    (tmp_path / "system.toml").write_text(SYSTEM)
    async with Kernel() as kernel:
        await build(kernel, load(tmp_path / "system.toml"))
        await kernel.save(tmp_path / "before.toml")
        (tmp_path / "parts.py").write_text(f"{PARTS}\n")
        await kernel.reload(type(kernel.components["ramp"]))
        await kernel.save(tmp_path / "after.toml")
    assert (tmp_path / "after.toml").read_text() == (tmp_path / "before.toml").read_text()


ECHO = """

class Echo(Component):
    back = InPort(TimedDouble)
    out = OutPort(TimedDouble)

    def on_initialize(self) -> None:
        self.log.warning("the echo runs")
"""
REPLAYED = """
[[connections]]
from = "ramp.out"
to = "echo.back"
full = "block"
timeout = inf
[[connections]]
from = "echo.out"
to = "meter.inp"
[contexts.echoes]
kind = "event"
members = ["echo"]
[components.echo]
type = "parts.py:Echo"
"""


@pytest.mark.slow
def test_who_is_replayed_stays_so_whatever_is_changed(tmp_path: Path) -> None:
    """A change connected its in-ports, which no code reads, and began the replay again beside the one that ran; after a
    change of its file its code ran."""
    with RecordingWriter(tmp_path / "run.mcap") as writer:
        port = writer.add_port("echo.out", TimedDouble)
        for number in range(6000):
            assert writer.write(port, TimedDouble(data=float(number)), number * 10**7)
    words = ("--replay", "run.mcap", "--print", "echo.out")
    with watched(tmp_path, "0", *words, parts=PARTS + ECHO, system=SYSTEM + REPLAYED) as system:
        system.write("[components.meter]", "params.step = 2.0\n[components.meter]")
        system.says("~ configure ramp: params.step default -> 2.0", "info: done")
        system.write(':Echo"', ':Echo"\nisolation = "process"\nsupervision.restart = "restart"')
        system.write("params.step = 2.0", "params.step = 3.0")
        system.says("~ configure ramp: params.step 2.0 -> 3.0", "info: done")
        assert [line for line in system.said.splitlines() if line[:1] != "{" and "echo" in line] == []
        system.write("Param(1.0)", "Param(4.0)", "parts.py")
        system.says("~ reload parts.py:Ramp: ramp")
        system.says("echo: cannot be reloaded: it is replayed, and none of its code runs")
        assert "the echo runs" not in system.said
        printed = [json.loads(line)["data"] for line in system.said.splitlines()[:-1] if line[:1] == "{"]
        assert printed == [float(number) for number in range(len(printed))]  # once, in order
