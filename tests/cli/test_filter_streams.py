"""Filters whose standard streams are closed, full, slow or gone: no crash, no busy loop, the right exit status."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import pytest

from campaign import CAMPAIGN
from log_parts import make
from run_parts import limited

pytestmark = [
    pytest.mark.row(123),
    pytest.mark.skipif(not hasattr(os, "wait4"), reason="needs POSIX processes"),
]
COMMAND = f"{sys.executable} -m aiorts"
CONST = f"{COMMAND} flexiconst -p TimedLong -c 1 --continuous"
FILTER = f"{COMMAND} flexifilter -i TimedLong -o TimedLong"
DUMP = f"{COMMAND} flexidump -p TimedLong"


@dataclass
class Ended:
    """How a process ended."""

    status: int
    out: str
    err: str
    cpu: float
    """Seconds of processor time."""


def ended(command: str, keep: list[int] | None = None, **streams: int) -> Ended:
    """Run one command with bash's redirections; the shell becomes the command, so that its time is measured alone."""
    process = subprocess.Popen(
        ["bash", "-c", f"exec {command}"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        pass_fds=keep or [],
        **({"stdin": subprocess.DEVNULL} | streams),  # type: ignore[arg-type]
    )
    assert process.stdout is not None
    assert process.stderr is not None
    with limited(process), process.stdout as out, process.stderr as err:
        said, complained = out.read().decode(), err.read().decode()
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    return Ended(process.returncode, said, complained, used.ru_utime + used.ru_stime)


@pytest.mark.slow(kept_by="cli/test_demo.py::test_a_reader_that_has_seen_enough_ends_it_quietly")
@pytest.mark.fault("F11")
@pytest.mark.parametrize("command", [f"yes 1 | {DUMP}", f"yes 1 | {FILTER}", CONST], ids=["dump", "filter", "const"])
def test_a_reader_that_takes_one_line_ends_it_quietly_and_soon(command: str) -> None:
    for _ in range(100 if CAMPAIGN else 1):
        began = time.monotonic()
        done = subprocess.run(
            ["bash", "-c", f"{command} | head -1; echo ${{PIPESTATUS[-2]}}"], capture_output=True, text=True, timeout=40
        )
        took = time.monotonic() - began
        line, status = done.stdout.splitlines()
        assert line
        assert done.stderr == ""
        assert status in ("0", "141")
        assert took < 20.0  # 0.4 s of starting, on a machine that is free


@pytest.fixture(scope="module")
def starting() -> float:
    """Processor time of a filter that has nothing to do."""
    return min(ended(DUMP).cpu for _ in range(2))


@pytest.mark.slow
@pytest.mark.fault("F12")
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize(
    ("redirection", "status", "out", "err"),
    [
        ("<&-", 0, "", ""),
        ("</dev/null", 0, "", ""),
        ("<LINES", 0, "500", ""),
        ("<LINES >&-", 1, "", "E-OUTPUT"),
        ("<LINES 2>&-", 0, "500", ""),
        ("<LINES 2>/dev/full", 0, "500", ""),
        ("<LINES >/dev/full", 1, "", "E-OUTPUT"),
        ("<BAD >/dev/full 2>&-", 1, "", ""),
        ("<BAD 2>/dev/full", 1, "500", ""),
        ("<&- >&- 2>&-", 0, "", ""),
    ],
)
@pytest.mark.parametrize("command", [FILTER, DUMP] if CAMPAIGN else [DUMP], ids=lambda command: command.split()[3])
def test_whatever_its_streams_are_it_ends_with_the_right_status_and_no_busy_loop(
    command: str, redirection: str, status: int, out: str, err: str, tmp_path: Path, starting: float
) -> None:
    (tmp_path / "lines").write_text("".join(f"{number}\n" for number in range(500)))
    (tmp_path / "bad").write_text("x\n" + "".join(f"{number}\n" for number in range(500)))
    redirection = redirection.replace("LINES", str(tmp_path / "lines")).replace("BAD", str(tmp_path / "bad"))
    found = ended(f"{command} {redirection}")
    assert (found.status, len(found.out.splitlines())) == (status, int(out or 0))
    assert found.err == "" if not err else (err in found.err and len(found.err.splitlines()) == 1)
    assert found.cpu - starting < 1.0


@pytest.mark.slow(kept_by="cli/test_demo.py::test_a_reader_that_has_seen_enough_ends_it_quietly")
@pytest.mark.fault("F12")
def test_a_closed_output_ends_a_source_that_would_run_for_ever() -> None:
    found = ended(f"{COMMAND} flexiconst -p TimedLong -c 1 -r 50 --for 20 >&-")
    assert (found.status, found.out) == (1, "")
    assert "E-OUTPUT" in found.err
    assert len(found.err.splitlines()) == 1


@pytest.mark.fault("F12")
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize("options", ["--count 3", "--count 3 --simulate", "", "--simulate --for 600"])
def test_a_full_output_ends_the_run_of_a_component_at_once(options: str, tmp_path: Path) -> None:
    (tmp_path / "src.py").write_text(
        "from aiorts import Component, OutPort\nfrom aiorts.types import TimedDouble\n"
        "class Src(Component):\n    out = OutPort(TimedDouble)\n"
        "    async def on_execute(self):\n        await self.out.write(TimedDouble(self.clock.time_ns(), 1.0))\n"
    )
    found = ended(f"{COMMAND} run {tmp_path}/src.py:Src --rate 100 {options} --control=off >/dev/full")
    assert (found.status, found.out) == (1, "")
    assert "E-OUTPUT" in found.err
    assert len(found.err.splitlines()) == 1


ROBOT = "\u00e9\U0001f916"


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "utf-8"])
def test_lines_for_programs_are_utf_8_whatever_the_encoding_is(encoding: str, tmp_path: Path) -> None:
    """Of filters, of a recording, of a dump: the next program reads what the first one was given."""
    (tmp_path / "in").write_text(json.dumps({"tm": 0, "data": ROBOT}) + "\n")
    put = f"env PYTHONIOENCODING={encoding} {COMMAND}"
    kept = f"{put} flexilogger -p TimedString -l {tmp_path}/run.mcap"
    assert ended(f"{put} flexifilter -i TimedString -o TimedString <{tmp_path}/in | {kept}").err == ""
    printed = ended(f"{put} log cat {tmp_path}/run.mcap")
    assert (printed.status, printed.err) == (0, "")
    assert json.loads(printed.out)["data"] == ROBOT
    assert ROBOT in ended(f"{put} log cat {tmp_path}/run.mcap | {put} flexidump -p TimedString --format json").out


def test_a_recording_is_not_printed_to_a_closed_output(tmp_path: Path) -> None:
    make(tmp_path / "run.mcap", 1)
    found = ended(f"{COMMAND} log cat {tmp_path}/run.mcap >&-")
    assert found.status == 1
    assert found.err.startswith("aiorts: E-OUTPUT: standard output is closed")


@pytest.mark.slow(kept_by="system/test_pipes.py::test_input_of_every_kind_comes_to_its_end")
@pytest.mark.fault("F12")
def test_a_silent_input_costs_nothing_until_its_end_and_is_no_terminal(starting: float) -> None:
    reading, writing = os.pipe()
    process = subprocess.Popen(["sleep", "1.5"], stdout=writing)  # holds the pipe open, and says nothing
    os.close(writing)
    found = ended(DUMP, stdin=reading)
    os.close(reading)
    process.wait(10)
    assert (found.status, found.out, found.err) == (0, "", "")
    assert found.cpu - starting < 0.5


@pytest.mark.slow
@pytest.mark.fault("F12")
def test_a_terminal_that_is_hung_up_is_the_end_of_input() -> None:
    leader, follower = os.openpty()
    process = subprocess.Popen(
        [sys.executable, "-m", "aiorts", "flexidump", "-p", "TimedLong"],
        stdin=follower,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    os.close(follower)
    with limited(process):
        assert process.stderr is not None
        assert "reading JSON lines" in process.stderr.readline()
        os.close(leader)
        assert process.communicate(timeout=30) == ("", "")
    assert process.returncode == 0


LATE = """
import time
from pathlib import Path
from aiorts import Component, Param


class Late(Component):
    report = Param("")

    def on_activated(self):
        self.times = []

    def on_execute(self):
        self.times.append(time.monotonic())

    def on_deactivated(self):
        gaps = sorted(after - before for before, after in zip(self.times, self.times[1:]))
        Path(self.report).write_text(f"{len(self.times)} {gaps[len(gaps) * 99 // 100]}")
"""
SYSTEM = """
schema = 1
[components.late]
type = "late.py:Late"
params.report = "REPORT"
[components.const]
type = "FlexiConst"
params.outputs = ["TimedString"]
params.constants = ['"TEXT"']
params.rate = 2000.0
[components.dump]
type = "FlexiDump"
params.inputs = ["TimedString"]
[[connections]]
from = "const.output"
to = "dump.input0"
WAY
[contexts.neighbour]
kind = "periodic"
rate = 100.0
members = ["late"]
[contexts.source]
kind = "event"
members = ["const"]
[contexts.screen]
kind = "event"
members = ["dump"]
"""


@pytest.mark.slow
@pytest.mark.fault("F13")
@pytest.mark.parametrize(
    "way", ["", 'full = "block"\ntimeout = inf'] if CAMPAIGN else ['full = "block"\ntimeout = inf'], ids=len
)
def test_who_reads_a_dump_and_stalls_delays_no_other_component(way: str, tmp_path: Path) -> None:
    """The pipe is full after 0.2 s; the neighbour's lateness of the time after it is measured."""
    (tmp_path / "late.py").write_text(LATE)
    text = SYSTEM.replace("WAY", way).replace("TEXT", "x" * 200).replace("REPORT", str(tmp_path / "report"))
    (tmp_path / "system.toml").write_text(text)
    with (
        subprocess.Popen(
            [sys.executable, "-m", "aiorts", "run", str(tmp_path / "system.toml")],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        ) as process,
        limited(process),
    ):
        assert process.stdout is not None
        assert process.stderr is not None
        first = os.read(process.stdout.fileno(), 1)
        time.sleep(1.4)
        process.send_signal(signal.SIGINT)
        began = time.monotonic()
        process.wait(30)
        took = time.monotonic() - began
        shown, said = first + process.stdout.read(), process.stderr.read()
    assert process.returncode == 130
    assert b"E-STOP" not in said  # nothing is abandoned that has to be ended by force
    assert took < 10.0  # 2 s: a hook that waits is cancelled when its grace is over
    assert 30_000 < len(shown) < 200_000  # a pipe full, and not what 1.4 s bring
    count, late = (tmp_path / "report").read_text().split()
    assert int(count) > 100
    assert float(late) - 0.01 < 0.05  # 0.1 ms on a machine that is free


@pytest.mark.slow(kept_by="system/test_pipes.py::test_input_of_every_kind_comes_to_its_end")
@pytest.mark.fault("F11")
@pytest.mark.parametrize("unbuffered", ["", "1"])
@pytest.mark.parametrize("codec", [(), ("--codec", "msgpack")], ids=["lines", "frames"])
def test_a_slow_reader_of_a_pipe_that_does_not_block_gets_every_byte(codec: tuple[str, ...], unbuffered: str) -> None:
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    const = ["flexiconst", "-p", "TimedString", "-c", f'"{"x" * 9000}"', "-r", "5000", "--count", "30", *codec]
    process = subprocess.Popen(
        [sys.executable, "-m", "aiorts", *const],
        stdout=writing,
        stderr=subprocess.PIPE,
        env=os.environ | {"PYTHONUNBUFFERED": unbuffered},
    )
    os.close(writing)
    with limited(process), open(reading, "rb") as pipe:
        pieces = [pipe.read(1)]
        time.sleep(0.5)  # the pipe is full: 64 kB
        pieces.append(pipe.read())
    assert process.stderr is not None
    with process.stderr as err:
        assert err.read() == b""
    assert process.wait(30) == 0
    assert b"".join(pieces).count(b"x" * 9000) == 30
    if not codec:
        assert [line[-3:] for line in b"".join(pieces).splitlines()] == [b'x"}'] * 30
