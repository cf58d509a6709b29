"""FlexiLogger as a Unix filter and in a run: pipes, signals, kill -9, a second recorder, a file that may not grow."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import IO, Any

import pytest
from click.testing import CliRunner

from aiorts_log import RecordingError, RecordingReader
from aiorts_log.commands.command import log
from aiorts_log.recorder.target import check_target
from campaign import CAMPAIGN, time_limit
from log_parts import read
from run_parts import aiorts, started

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no POSIX signals")

SLACK = 1.0 if CAMPAIGN else 4.0
"""Seconds that a loaded machine may need on top of what is promised."""
FLOOD = """
from aiorts import Component, OutPort
from aiorts.types import TimedOctetSeq

class Flood(Component):
    out = OutPort(TimedOctetSeq)
    n = 0
    def on_execute(self):
        self.n += 1
        if self.n == 1:
            for i in range(60):
                self.out.write_nowait(TimedOctetSeq(i, bytes(2**20)))
        if self.n == 2:
            print("ready", flush=True)
"""
SYSTEM = """
schema = 1
[components.flood]
type = "flood.py:Flood"
[components.log]
type = "FlexiLogger"
options = ["-p", "TimedOctetSeq", "-l", "run.mcap", "--min-free", "0"]
[[connections]]
from = "flood.out"
to = "log.input0"
length = 100
[contexts.fast]
kind = "periodic"
rate = 100.0
members = ["flood", "log"]
"""


def recorder(path: Path, *arguments: str, **options: Any) -> subprocess.Popen[str]:
    """A filter that records numbers, and is ready: its file is there."""
    command = [sys.executable, "-m", "aiorts", "flexilogger", "-p", "TimedLong", "-l", str(path), "--min-free", "0"]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    process = subprocess.Popen([*command, *arguments], text=True, **(pipes | options))
    until = time.monotonic() + 20
    while not path.exists() and process.poll() is None:
        assert time.monotonic() < until
        time.sleep(0.005)
    return process


def feed(stream: IO[str] | None, seconds: float, begin: int = 0) -> int:
    """Write numbers, a thousand a second; how many there are then."""
    assert stream is not None
    start, number = time.monotonic(), begin
    while (now := time.monotonic() - start) < seconds:
        due = begin + int(now * 1000)
        stream.write("".join(f"{n}\n" for n in range(number, due)))
        stream.flush()
        number = due
        time.sleep(0.002)
    return number


@pytest.mark.slow(kept_by="flexi/test_recording.py::test_any_mix_of_ports_and_types_is_recorded_each_sample_once")
@pytest.mark.row(115)
@pytest.mark.row(123)
def test_a_filter_records_every_line(tmp_path: Path) -> None:
    command = f"{sys.executable} -m aiorts"
    line = (
        f"{command} flexiconst -p TimedDouble -c 1.5 --continuous --count 5000 | "
        f"{command} flexilogger -p TimedDouble -l run.mcap --min-free 0"
    )
    done = subprocess.run(
        ["bash", "-o", "pipefail", "-c", line], cwd=tmp_path, capture_output=True, text=True, timeout=100
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    path = str(tmp_path / "run.mcap")
    told = json.loads(CliRunner().invoke(log, ["info", path, "--json"]).output)
    assert (told["samples"], told["closed"], told["fault"]) == (5000, True, "")
    lines = CliRunner().invoke(log, ["cat", path]).output.splitlines()
    assert len(lines) == 5000
    assert {json.loads(line)["data"] for line in lines} == {1.5}


@pytest.mark.slow(kept_by="log/test_writer.py::test_what_was_said_to_be_on_the_disk_is_there_after_a_kill")
@pytest.mark.row(117)
@pytest.mark.fault("D01")
def test_a_filter_that_is_killed_leaves_an_exact_prefix_that_opens_as_it_is(tmp_path: Path) -> None:
    chance, late = random.Random(3), []
    for number in range(100 if CAMPAIGN else 2):
        path = tmp_path / f"{number}.mcap"
        process = recorder(path)
        fed = feed(process.stdin, chance.uniform(0.3, 0.8))
        at = time.time_ns()
        process.kill()
        process.communicate(timeout=40)
        with RecordingReader(path) as reader:
            assert not reader.clean
            assert reader.fault == ""
            found = list(reader.records())
        assert [record.data for _, _, record in found] == list(range(len(found)))
        assert 0 < len(found) <= fed
        late.append((at - found[-1][1]) / 1e9)
    # What was written is at most 0.2 s old; the rest is what a busy machine made the process wait.
    assert sorted(late)[len(late) // 2] <= 0.25
    assert max(late) <= 2.0


@pytest.mark.slow
@pytest.mark.fault("D20")
@pytest.mark.parametrize(("name", "status"), [("SIGINT", 130), ("SIGTERM", 143), ("SIGHUP", 129)])
def test_a_signal_closes_a_recording_of_which_much_is_buffered(name: str, status: int, tmp_path: Path) -> None:
    (tmp_path / "flood.py").write_text(FLOOD)
    (tmp_path / "system.toml").write_text(SYSTEM)
    process = started(tmp_path, "system.toml")
    at = time.monotonic()
    process.send_signal(getattr(signal, name))
    _, errors = process.communicate(timeout=20)
    assert time.monotonic() - at < 2.0 + SLACK
    assert (process.returncode, "Traceback" in errors) == (status, False)
    with RecordingReader(tmp_path / "run.mcap") as reader:
        assert reader.clean
        assert reader.count == 60
        (system,) = (each for each in reader.attachments() if each.name == "system.toml")
    assert system.data.decode() == SYSTEM


@pytest.mark.slow
@pytest.mark.fault("F09")
@pytest.mark.parametrize("times", [1, 2])
def test_ctrl_c_while_recording_leaves_a_valid_log(times: int, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    process = recorder(path)
    fed = feed(process.stdin, 0.4)
    for _ in range(times):
        process.send_signal(signal.SIGINT)
    at = time.monotonic()
    _, errors = process.communicate(timeout=20)
    assert time.monotonic() - at < (5.0 if times == 1 else 0.5) + SLACK
    assert (process.returncode, "Traceback" in errors) == (130, False)
    stored = [record.data for _, _, record in read(path)]
    assert stored == list(range(len(stored)))
    with RecordingReader(path) as reader:
        assert reader.fault == ""
        assert reader.clean or times == 2
    assert fed - len(stored) < (400 if times == 1 else fed)


@pytest.mark.slow
@pytest.mark.fault("F09")
@pytest.mark.campaign
@pytest.mark.timeout(time_limit(1800))
def test_ctrl_c_at_any_moment_leaves_no_broken_log(tmp_path: Path) -> None:
    """From the start of the process on, once and twice; 150 moments of a raster of 20 ms in the campaign."""
    for number in range(150) if CAMPAIGN else (10, 45):
        path, times = tmp_path / f"{number}.mcap", 1 + number % 2
        command = [sys.executable, "-m", "aiorts", "flexilogger", "-p", "TimedLong", "-l", str(path), "--min-free", "0"]
        began = time.monotonic()
        with subprocess.Popen(
            command, text=True, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
        ) as process:
            assert process.stdin is not None
            count = 0
            while time.monotonic() - began < 0.02 * (number + 1):
                process.stdin.write(f"{count}\n")
                process.stdin.flush()
                count += 1
                time.sleep(0.001)
            for _ in range(times):
                process.send_signal(signal.SIGINT)
            at = time.monotonic()
            _, errors = process.communicate(timeout=20)
        assert time.monotonic() - at < (5.0 if times == 1 else 0.5) + SLACK
        assert process.returncode in (130, -signal.SIGINT), number  # the interpreter's own, before it is ours
        assert "Traceback" not in errors or process.returncode == -signal.SIGINT
        if path.exists() and path.stat().st_size:
            stored = [record.data for _, _, record in read(path)]
            assert stored == list(range(len(stored))), number
            with RecordingReader(path) as reader:
                assert reader.fault == ""
                assert reader.clean or times == 2


@pytest.mark.slow
@pytest.mark.fault("F15")
@pytest.mark.fault("D17")
def test_a_second_recorder_is_told_who_has_the_file(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    process = recorder(path)
    second = aiorts(tmp_path, "flexilogger", "-p", "TimedLong", "-l", "run.mcap", "--append")
    assert second.returncode == 2
    assert "run.mcap" in second.stderr
    if sys.platform == "linux":
        assert f"process {process.pid} (" in second.stderr
    for existing in ("refuse", "append", "overwrite"):
        with pytest.raises(RecordingError, match="writes it"):
            check_target(path, existing)  # type: ignore[arg-type]
    fed = feed(process.stdin, 0.1)
    process.communicate(timeout=20)
    assert process.returncode == 0
    assert len(read(path)) == fed


@pytest.mark.slow
@pytest.mark.fault("D03")
@pytest.mark.parametrize("limit", [3000, 30_000])
def test_a_file_that_may_not_grow_makes_the_filter_fail_also_at_its_end(limit: int, tmp_path: Path) -> None:
    import resource

    path = tmp_path / "run.mcap"

    def little() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    chunk = "1000000" if limit == 3000 else "4000"
    # Bytecode that may not grow would be half a file, which the next one reads.
    surroundings = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
    process = recorder(path, "--flush-age", "60", "--chunk", chunk, preexec_fn=little, env=surroundings)
    _, errors = process.communicate("".join(f"{n}\n" for n in range(2000)), timeout=20)
    assert process.returncode == 1
    assert errors.count("File too large") == 1
    stored = [record.data for _, _, record in read(path)]
    assert stored == list(range(len(stored)))
    assert len(stored) < 2000
    assert os.path.getsize(path) <= limit
