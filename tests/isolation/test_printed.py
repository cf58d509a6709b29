"""What an isolated component prints: on standard output of the program, and what becomes of it where nobody reads."""

from __future__ import annotations

import fcntl
import io
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from anyio import sleep

from aiorts import Kernel
from aiorts.isolation.isolating import Isolation
from aiorts.types import TimedLong
from isolation.test_isolated import ACTIVE, ERROR, answer, chain, runs, until
from run_parts import here

pytestmark = [
    pytest.mark.anyio,
    pytest.mark.row(51),
    pytest.mark.slow(
        kept_by="isolation/test_isolated.py::test_it_looks_like_any_other_and_runs_in_a_process_of_its_own"
    ),
]
SYSTEM = """\
schema = 1

[components.count]
type = "FlexiConst"
params.outputs = ["TimedLong"]
params.constants = ["3"]
params.rate = 20.0
params.count = 3

[components.show]
type = "FlexiDump"
isolation = "process"
params.inputs = ["TimedLong"]
params.format = "values"

[[connections]]
from = "count.output"
to = "show.input0"
subscription = "flush"

[contexts.a]
kind = "event"
members = ["show"]

[contexts.b]
kind = "event"
members = ["count"]
"""


async def test_what_it_prints_is_on_standard_output_and_its_log_in_the_log(
    caplog: pytest.LogCaptureFixture, capsys: pytest.CaptureFixture[str]
) -> None:
    caplog.set_level("INFO")
    async with Kernel() as kernel:
        source, _scale, sink, _ = await chain(kernel)
        assert await answer(source, sink, -5) == -10
        printed = ""
        while printed.count("\n") < 50:
            printed += capsys.readouterr().out
            await sleep(0.01)
        assert printed == "word\n" * 50
        await until(lambda: {"to standard error", "to the log"} <= {one.getMessage() for one in caplog.records})
        assert {one.levelname for one in caplog.records if one.getMessage() == "to standard error"} == {"WARNING"}
        assert not [one for one in caplog.records if "word" in one.getMessage()]


def test_a_dump_in_a_process_of_its_own_shows_its_lines_at_run(tmp_path: Path) -> None:
    path = tmp_path / "system.toml"
    path.write_text(SYSTEM)
    done = here("run", path, "--for", "3")
    assert (done.returncode, done.stdout) == (0, "3\n" * 3), done.stderr


@contextmanager
def unread(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """Standard output is a pipe of one page; this is its end to read from, which the test closes."""
    reads, writes = os.pipe()
    if hasattr(fcntl, "F_SETPIPE_SZ"):
        fcntl.fcntl(writes, fcntl.F_SETPIPE_SZ, 4096)
    with os.fdopen(writes, "w") as stream:
        monkeypatch.setattr(sys, "stdout", stream)
        yield reads


async def test_what_a_slow_standard_output_does_not_take_is_counted_and_nobody_waits(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("aiorts.isolation.printing._LINES", 20)
    with unread(monkeypatch) as reader:
        async with Kernel() as kernel:
            source, scale, sink, _ = await chain(kernel)
            source.out.write_nowait(TimedLong(0, -8))  # a flood
            report = kernel.service(Isolation).report
            longest, ends = 0.0, time.monotonic() + 10
            while (before := time.monotonic()) < ends and not report()["scale"]["unprinted"]:
                await sleep(0.01)
                longest = max(longest, time.monotonic() - before)
            assert 0 < report()["scale"]["unprinted"] <= 200
            assert longest < 2.0
            assert (await sink.inp.read(timeout=20)).data == -16
            assert scale.state is ACTIVE
            await kernel.remove(scale)
        sys.stdout.close()
        with os.fdopen(reader) as lines:
            assert set(lines.read().splitlines()) == {"word " * 13}
    said = [one.getMessage() for one in caplog.records if "standard output" in one.getMessage()]
    assert len(said) == 2, said
    assert "is too slow for what it prints: lines are left out" in said[0]
    assert "lines were left out" in said[1]


async def test_a_standard_output_whose_reader_has_gone_is_its_failure_as_it_is_here(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with unread(monkeypatch) as reader:
        os.close(reader)
        async with Kernel() as kernel:
            source, scale, sink, context = await chain(kernel)
            pid = scale.pid
            source.out.write_nowait(TimedLong(0, -5))
            await until(lambda: scale.state is ERROR)
            assert isinstance(scale.last_error, BrokenPipeError)
            await until(lambda: not runs(pid))
            shown = io.StringIO()
            monkeypatch.setattr(sys, "stdout", shown)
            await context.reset()
            await context.activate()
            sink.inp.drain()
            assert (await answer(source, sink, -5), scale.pid != pid) == (-10, True)
            await until(lambda: shown.getvalue() == "word\n" * 50)
