"""Filters join: one takes the samples of another, or of any out-port that runs, over its local socket."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from aiorts.cli.app import run_command
from aiorts.sessions import entries
from control_parts import WAIT, until

SOURCE = ("flexiconst", "-p", "TimedDouble", "-c", "1", "-r", "50")


@contextmanager
def source(name: str, *words: str) -> Iterator[subprocess.Popen[str]]:
    """A filter that can be reached by this name, from when it can be."""
    process = subprocess.Popen(
        [sys.executable, "-m", "aiorts", *(words or SOURCE), "--name", name],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        text=True,
    )
    try:
        until(lambda: any(one.name == name for one in entries()))
        yield process
    finally:
        process.kill()
        process.wait(WAIT)


def filtered(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "aiorts", *words], capture_output=True, text=True, timeout=WAIT, check=False
    )


@pytest.mark.slow
def test_a_filter_takes_the_samples_of_another_by_the_name_of_its_kernel() -> None:
    with source("src"):
        run = filtered("flexidump", "-p", "TimedDouble", "--connect", "src.output", "--count", "3")
    assert (run.returncode, run.stderr) == (0, "")
    assert [line.split()[-1] for line in run.stdout.splitlines()] == ["1.0"] * 3


@pytest.mark.slow(kept_by="test_what_does_not_run_is_absent")
def test_it_ends_with_its_source() -> None:
    with source("ends", *SOURCE, "--count", "100"):
        run = filtered("flexidump", "-p", "TimedDouble", "--connect", "ends.output")
    assert (run.returncode, run.stderr) == (0, "")
    assert run.stdout


@pytest.mark.slow(kept_by="test_what_does_not_run_is_absent")
def test_a_source_that_is_killed_is_told() -> None:
    with source("killed") as process:
        dump = subprocess.Popen(
            [sys.executable, "-m", "aiorts", "flexidump", "-p", "TimedDouble", "--connect", "killed.output"],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        try:
            assert dump.stdout is not None
            assert dump.stdout.readline()
            process.kill()
            _, told = dump.communicate(timeout=WAIT)
        finally:
            dump.kill()
            dump.communicate(timeout=WAIT)
    assert dump.returncode == 1
    assert "killed: has ended" in told


@pytest.mark.slow(kept_by="test_what_does_not_run_is_absent")
def test_another_type_is_refused_before_anything_runs() -> None:
    with source("other"):
        run = filtered("flexidump", "-p", "TimedLong", "--connect", "other.output")
    assert run.returncode == 2
    assert "output sends TimedDouble" in run.stderr
    assert "takes TimedLong; put a flexifilter between them" in run.stderr


def test_what_does_not_run_is_absent(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["flexidump", "-p", "TimedDouble", "--connect", "nobody.output"]) == 6
    assert "nobody.output: nothing runs that can be reached" in capsys.readouterr().err


def test_without_a_name_no_socket_is_opened(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["flexiconst", "-p", "TimedDouble", "-c", "1", "-r", "50", "--count", "1"]) == 0
    assert entries() == ()
