"""`aiorts run` with a file that uses every table, and what it does for whoever watches it from outside."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from run_parts import aiorts, here, limited

PARTS = """
import time
from aiorts import Component, InPort, OutPort, Param
from aiorts.types import TimedLong

class Source(Component):
    out = OutPort(TimedLong)
    count = Param(3)
    n = 0
    def on_initialize(self):
        print(f"{self.name} initialize: count {self.count}", flush=True)
    def on_activated(self):
        print(f"{self.name} active", flush=True)
    def on_execute(self):
        self.n += 1
        self.out.write_nowait(TimedLong(0, self.n))
        if self.n >= self.count:
            self.finish()

class Gain(Component):
    input = InPort(TimedLong)
    output = OutPort(TimedLong)
    gain = Param(1)
    fails = Param(0)
    configurations = {"soft": {"gain": 7}}
    seen = 0
    def on_activated(self):
        print(f"{self.name} active: gain {self.gain}", flush=True)
    def on_execute(self):
        for sample in self.input.drain():
            self.seen += 1
            if self.seen == self.fails:
                raise ValueError("too warm")
            self.output.write_nowait(TimedLong(0, sample.data * self.gain))

class Sink(Component):
    input = InPort(TimedLong)
    def on_execute(self):
        for sample in self.input.drain():
            print(f"{self.name}: {sample.data}", flush=True)

class Blocks(Component):
    def on_execute(self):
        time.sleep(1.0)
"""
SYSTEM = """\
schema = 1
[watch_loop]
limit = 20.0
[components.source]
type = "parts.py:Source"
[components.source.start]
after = ["arm active", "sink active"]
wait = 0.5
[components.one]
type = "parts.py:Gain"
active = "stiff"
[components.one.sets.stiff]
gain = 5
[components.two]
type = "parts.py:Gain"
params.gain = 2
params.fails = 2
active = "soft"
[components.two.supervision]
restart = "reset"
backoff = 0.01
[components.sink]
type = "parts.py:Sink"
[composites.arm]
members = ["hand", "two"]
exported = {"hand.*" = "{port}", "two.output" = "force"}
errors = "isolate"
[composites.hand]
members = ["one"]
exported = {"one.input" = "command", "one.output" = "inner"}
[[connections]]
from = "arm.inner"
to = "two.input"
[[connections]]
from = "source.out"
to = "arm.command"
[[connections]]
from = "arm.force"
to = "sink.input"
[contexts.loop]
kind = "periodic"
rate = 100.0
members = ["arm", "sink"]
[contexts.slow]
kind = "periodic"
rate = 10.0
members = ["source"]
"""
BLOCKED = """\
schema = 1
[watch_loop]
limit = 0.4
policy = "exit"
[components.it]
type = "parts.py:Blocks"
[contexts.c]
kind = "periodic"
rate = 1.0
members = ["it"]
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "parts.py").write_text(PARTS)
    (tmp_path / "system.toml").write_text(SYSTEM)
    (tmp_path / "blocked.toml").write_text(BLOCKED)
    return tmp_path


LINES = [
    "source initialize: count 3",
    "one active: gain 5",
    "two active: gain 7",
    "source active",
    "sink: 35",
    "two active: gain 7",  # it failed at the second sample, and was reset
    "sink: 105",
]


@pytest.mark.slow(kept_by="first")
@pytest.mark.parametrize("how", [("--simulate",), ("--speed", "5")])
def test_one_file_with_every_table_does_what_each_says(folder: Path, how: tuple[str, ...]) -> None:
    done = aiorts(folder, "run", "system.toml", *how)
    assert done.stdout.splitlines() == LINES
    assert done.returncode == 0
    assert done.stderr.count("ValueError: too warm") == 1


@pytest.mark.slow
def test_another_set_and_another_value_from_the_command_line(folder: Path) -> None:
    sets = ("--set", "one.active=soft", "--set", "two.gain=1", "--set", "two.fails=0")
    done = here(folder, "run", "system.toml", "--simulate", *sets)
    assert [line for line in done.stdout.splitlines() if "sink" in line] == ["sink: 7", "sink: 14", "sink: 21"]
    done = here(folder, "run", "system.toml", "--simulate", "--set", "one.active=sof")
    assert (done.returncode, done.stdout) == (2, "")
    assert "--set one.active=sof: one: no set 'sof'; did you mean soft?" in done.stderr


def test_a_source_that_waits_for_nobody_who_comes_says_for_whom(folder: Path) -> None:
    text = SYSTEM.replace('"sink active"]', '"sink error"]\ntimeout = 2.0')
    (folder / "system.toml").write_text(text)
    done = here(folder, "run", "system.toml", "--simulate")
    assert done.returncode == 1
    assert "source: not started: after 2.0 s still not sink error: it is active" in done.stderr


@pytest.mark.parametrize("action", ["reset", "restart"])
def test_a_composite_that_stops_as_a_whole_goes_on_when_its_member_was_helped(folder: Path, action: str) -> None:
    text = SYSTEM.replace('errors = "isolate"', 'errors = "stop"').replace("params.fails = 2\n", "")
    text = text.replace('active = "stiff"\n', 'active = "stiff"\nparams.fails = 2\n')
    text = text.replace("[components.two.supervision]", "[components.one.supervision]").replace("reset", action)
    (folder / "system.toml").write_text(text)
    done = here(folder, "run", "system.toml", "--simulate")
    assert done.stdout.splitlines()[-3:] == ["one active: gain 5", "two active: gain 7", "sink: 105"]
    assert done.returncode == 0
    assert done.stderr.count("ValueError: too warm") == 1


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="timerfd")
def test_what_blocks_the_loop_is_named_and_may_end_the_process(folder: Path) -> None:
    done = aiorts(folder, "run", "blocked.toml")
    assert done.returncode == 70
    assert "the event loop does not turn for 0." in done.stderr
    assert "it.on_execute (parts.py:" in done.stderr
    assert "the process ends with status 70" in done.stderr
    (folder / "blocked.toml").write_text(BLOCKED.replace("limit = 0.4", "").replace("exit", "warn"))
    done = aiorts(folder, "run", "blocked.toml", "--for", "1.5")
    assert done.returncode == 0
    assert "it.on_execute (parts.py:" in done.stderr


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="systemd")
def test_systemd_is_told_when_it_asks(folder: Path) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as ours:
        ours.bind(str(folder / "notify"))
        ours.settimeout(20.0)
        environment = {**os.environ, "NOTIFY_SOCKET": str(folder / "notify"), "WATCHDOG_USEC": "1000000"}
        command = [sys.executable, "-m", "aiorts", "run", "system.toml"]
        with (
            subprocess.Popen(command, cwd=folder, env=environment, stdout=subprocess.PIPE, text=True) as child,
            limited(child),
        ):
            told: list[str] = []
            while not told or not told[-1].startswith("STOPPING=1"):
                told.append(ours.recv(1000).decode())
            output, _ = child.communicate(timeout=20.0)
    ready = [number for number, text in enumerate(told) if text.startswith("READY=1")]
    assert len(ready) == 1
    assert "0 of 0" not in told[ready[0]]
    assert "WATCHDOG=1" in told
    assert output.splitlines() == LINES
    # The source waited for half a second: it was not ready before.
    assert any("starting" in text for text in told[: ready[0]])


@pytest.mark.slow(kept_by="test_one_file_with_every_table_does_what_each_says")
def test_nothing_of_it_in_simulated_time(folder: Path) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as ours:
        ours.bind(str(folder / "notify"))
        ours.setblocking(False)
        environment = {**os.environ, "NOTIFY_SOCKET": str(folder / "notify")}
        command = [sys.executable, "-m", "aiorts", "run", "system.toml", "--simulate"]
        subprocess.run(command, cwd=folder, env=environment, check=True, timeout=40, capture_output=True)
        with pytest.raises(BlockingIOError):
            ours.recv(1000)


def test_an_option_that_does_nothing_is_told_once(folder: Path) -> None:
    text = SYSTEM.replace('to = "two.input"\n', 'to = "two.input"\nbuffer.lenght = 5\n')
    (folder / "system.toml").write_text(text)
    done = here(folder, "run", "system.toml", "--simulate")
    line = text.split("\n").index("buffer.lenght = 5") + 1
    assert done.returncode == 0, done.stderr
    assert [one for one in done.stderr.splitlines() if "W-OPTION" in one] == [
        f"aiorts: W-OPTION: system.toml:{line}:8: connections[1] (arm.inner to two.input): "
        "buffer.lenght is no option that is known; did you mean 'buffer.length'?"
    ]


def test_what_is_about_openrtms_transports_is_told_once(folder: Path) -> None:
    text = SYSTEM.replace('to = "two.input"\n', 'to = "two.input"\ndataport.interface_type = "corba_cdr"\n')
    (folder / "system.toml").write_text(text)
    done = here(folder, "run", "system.toml", "--simulate")
    assert done.returncode == 0, done.stderr
    (line,) = (one for one in done.stderr.splitlines() if "W-" in one)
    assert "W-TRANSPORT: one.output-two.input: dataport.interface_type: " in line


@pytest.mark.parametrize(("seconds", "told"), [("0.25", True), ("0.75", False)])
def test_the_seconds_of_for_count_while_a_start_is_waited_for(folder: Path, seconds: str, told: bool) -> None:
    done = here(folder, "run", "system.toml", "--simulate", "--for", seconds)
    assert done.returncode == 0
    assert ("source active" in done.stdout) is not told  # its start waits for half a second
    line = f"aiorts: W-START: --for {seconds}: over before everything was started; not active: source"
    assert (line in done.stderr.splitlines()) is told
