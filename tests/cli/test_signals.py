"""Signals to a run: each asks for an orderly end, the second ends it at once, and at no moment is there a traceback."""

from __future__ import annotations

import asyncio
import os
import re
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from aiorts import Kernel
from aiorts.cli.runtime import stopping
from campaign import CAMPAIGN, time_limit
from run_parts import begun, folder_of, limited, started

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no POSIX signals")

ORDERLY = 5.0
AT_ONCE = 0.5
SLACK = 1.0 if CAMPAIGN else 3.0
"""Seconds that a loaded machine may need on top of what is promised."""
START = 0.25
"""Seconds in which the interpreter itself starts, at the longest, and may show a traceback of its own."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return folder_of(tmp_path_factory.mktemp("signals"))


@pytest.mark.slow(kept_by="first")
@pytest.mark.fault("F10")
@pytest.mark.parametrize(
    ("target", "name", "status"),
    [
        ("system.toml", "SIGINT", 130),
        ("system.toml", "SIGTERM", 143),
        ("system.toml", "SIGHUP", 129),
        ("parts.py:Slow", "SIGTERM", 143),
    ],
)
def test_a_signal_ends_it_in_order_within_five_seconds(folder: Path, target: str, name: str, status: int) -> None:
    process = started(folder, target)
    at = time.monotonic()
    process.send_signal(getattr(signal, name))
    out, errors = process.communicate(timeout=20)
    assert time.monotonic() - at < ORDERLY + SLACK
    assert (process.returncode, unwatched(errors)) == (status, "")
    if target == "system.toml":
        assert "stopped in event" in out


@pytest.mark.fault("F10")
@pytest.mark.parametrize(("name", "status"), [("SIGINT", 130), ("SIGTERM", 143), ("SIGHUP", 129)])
@pytest.mark.parametrize(
    "command",
    [("run", "system.toml"), ("flexiconst", "-p", "TimedLong", "-c", "1", "-r", "20"), ("types",)],
    ids=["run", "filter", "types"],
)
def test_a_signal_while_the_command_is_imported_ends_it_with_its_status(
    folder: Path, command: tuple[str, ...], name: str, status: int
) -> None:
    """From the first line of `main` on; what Python prints of its imports tells when that has been."""
    process = subprocess.Popen(
        [sys.executable, "-X", "importtime", "-m", "aiorts", *command],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        cwd=folder,
    )
    with limited(process):
        assert process.stderr is not None
        while not (line := process.stderr.readline()).endswith("click.globals\n"):
            assert line, "it has ended before"
        process.send_signal(getattr(signal, name))
        _, errors = process.communicate(timeout=20)
    assert (process.returncode, "Traceback" in errors) == (status, False)


@pytest.mark.slow(kept_by="test_a_signal_ends_it_in_order_within_five_seconds")
@pytest.mark.fault("F10")
def test_a_hangup_is_ignored_under_nohup(folder: Path) -> None:
    process = started(folder, "system.toml", preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN))
    process.send_signal(signal.SIGHUP)
    time.sleep(0.3)
    assert process.poll() is None
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=20)
    assert process.returncode == 143


@pytest.mark.slow
@pytest.mark.fault("F10")
@pytest.mark.parametrize(("name", "status"), [("SIGTERM", 143), ("SIGHUP", 129)])
def test_the_second_of_any_kind_ends_it_at_once(folder: Path, name: str, status: int) -> None:
    process = started(folder, "parts.py:Blocked")
    process.send_signal(signal.SIGINT)
    time.sleep(0.2)
    assert process.poll() is None
    at = time.monotonic()
    process.send_signal(getattr(signal, name))
    process.communicate(timeout=20)
    assert time.monotonic() - at < AT_ONCE + SLACK
    assert process.returncode == status


@pytest.mark.slow(kept_by="first")
@pytest.mark.fault("F10")
@pytest.mark.parametrize("loop", ["asyncio", "uvloop"])
def test_usr1_prints_state_and_stacks_and_the_run_goes_on(folder: Path, loop: str) -> None:
    process = started(folder, "system.toml", "--set", "sink.limit=20", "--loop", loop, "--no-status")
    with limited(process):
        assert process.stdout is not None
        assert process.stdout.readline() == "stopped in event\n"  # the sink went to error
    process.send_signal(signal.SIGUSR1)
    time.sleep(0.3)
    assert process.poll() is None
    process.send_signal(signal.SIGUSR1)
    time.sleep(0.3)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=20)
    assert process.returncode == 130
    lines = errors.splitlines()
    for wanted in (
        "aiorts: component counter (Counter): active in fast",
        "aiorts: component sink (Sink): error in slow; last error ValueError: too much",
        "aiorts: context slow (event): ",
        "aiorts: context fast (periodic 100 Hz): ",
        "aiorts: connector counter.out",
        "aiorts: task ",
        "Current thread 0x",
    ):
        assert sum(line.startswith(wanted) for line in lines) >= 2, (wanted, errors)
    (ledger, *_) = (line for line in lines if line.startswith("aiorts: connector"))
    numbers = [int(word) for word in ledger.replace(",", "").split() if word.isdigit()]
    assert numbers[0] == sum(numbers[1:])
    assert any(line.endswith("is MainThread") for line in lines)


@pytest.mark.slow(kept_by="test_usr1_prints_state_and_stacks_and_the_run_goes_on")
@pytest.mark.fault("F10")
def test_usr1_tells_who_blocks_the_loop(folder: Path) -> None:
    process = started(folder, "parts.py:Blocked")
    process.send_signal(signal.SIGUSR1)
    time.sleep(0.5)
    process.send_signal(signal.SIGINT)
    process.send_signal(signal.SIGTERM)
    _, errors = process.communicate(timeout=20)
    assert 'parts.py", line 49 in on_execute' in errors or "in on_execute" in errors
    assert "aiorts: component blocked (Blocked): active in periodic0" in errors
    assert "Traceback" not in errors


@pytest.mark.slow(kept_by="test_usr1_prints_state_and_stacks_and_the_run_goes_on")
@pytest.mark.fault("F10")
def test_usr1_shows_the_stack_even_where_nothing_of_python_can_run(folder: Path) -> None:
    process = started(folder, "parts.py:BlockedInC")
    time.sleep(0.2)
    at = time.monotonic()
    process.send_signal(signal.SIGUSR1)
    with limited(process):
        assert process.stderr is not None
        assert "(most recent call first)" in process.stderr.readline()
        assert time.monotonic() - at < 2.5  # it holds the lock for 3 s
        errors = process.stderr.read()
        process.communicate(timeout=20)
    assert process.returncode == 0
    assert "in on_execute" in errors
    assert "aiorts: component blockedinc" in errors


@pytest.mark.slow(kept_by="test_usr1_prints_state_and_stacks_and_the_run_goes_on")
@pytest.mark.fault("F10")
def test_usr1_tells_of_a_filter_too() -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "aiorts", "flexiconst", "-p", "TimedLong", "-c", "1", "-r", "20"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    with limited(process):
        assert process.stdout is not None
        assert '"data": 1' in process.stdout.readline()
    process.send_signal(signal.SIGUSR1)
    time.sleep(0.3)
    process.send_signal(signal.SIGHUP)
    _, errors = process.communicate(timeout=20)
    assert process.returncode == 129
    assert "aiorts: connector flexiconst" in errors


# -- Ctrl-C at every moment --------------------------------------------------------------------------------------------

SLOW = ("parts.py:Slow", "--for", "1.6" if CAMPAIGN else "0.4")
"""It imports, initialises, activates, runs, deactivates and finalises, and takes its time for each."""
ENDS = 3.0 if CAMPAIGN else 1.8
POINTS = [0.02 * number for number in range(150)]


def moments() -> list[float]:
    """A dozen of the 150 moments, other ones in each phase; all of them in a campaign."""
    return POINTS if CAMPAIGN else [ENDS * number / 12 + 0.02 * (number % 3) for number in range(12)]


def unwatched(errors: str) -> str:
    """Without the lines of the loop's watch: these components block it on purpose."""
    lines = errors.splitlines(keepends=True)
    return "".join(line for line in lines if "kernel: the event loop does not turn for" not in line)


def interrupted(folder: Path, seconds: float, times: int) -> tuple[int, str, float]:
    """Ctrl-C so long after the start: exit status, standard error, and how long it took since the last one."""
    process = begun(folder, *SLOW, start_new_session=True)
    time.sleep(seconds)
    at = time.monotonic()
    for number in range(times):
        if number:
            time.sleep(0.05)
        at = time.monotonic()
        os.killpg(process.pid, signal.SIGINT) if process.poll() is None else None
    _, errors = process.communicate(timeout=20)
    return process.returncode, unwatched(errors), time.monotonic() - at


@pytest.mark.slow(kept_by="test_a_signal_while_the_command_is_imported_ends_it_with_its_status")
@pytest.mark.fault("F09")
@pytest.mark.parametrize("times", [1, 2])
@pytest.mark.timeout(time_limit(900))
def test_an_interrupt_at_any_moment_ends_it_without_a_traceback(folder: Path, times: int) -> None:
    promised = ORDERLY if times == 1 else AT_ONCE
    with ThreadPoolExecutor(4) as together:
        ends = list(together.map(lambda seconds: interrupted(folder, seconds, times), moments()))
    faults = [
        f"{seconds:.2f} s: {status} after {took:.1f} s: {errors}"
        for seconds, (status, errors, took) in zip(moments(), ends, strict=True)
        if took > promised + SLACK
        or not (is_starting(seconds, status, errors) or (errors == "" and status in (0, 130)))
    ]
    assert faults == []
    early = [status for seconds, (status, _, _) in zip(moments(), ends, strict=True) if 0.3 < seconds < 0.6]
    assert set(early) == {130}


def is_starting(seconds: float, status: int, errors: str) -> bool:
    """Whether the interpreter itself was still starting, and not one line of `main` had run."""
    ours = re.search(r"aiorts.cli.__init__\.py\", line \d+, in main", errors)  # site.py has a main, too
    return seconds < START and status in (1, -signal.SIGINT) and ours is None


@pytest.mark.slow
@pytest.mark.fault("F09")
@pytest.mark.parametrize("times", [1, 2])
def test_an_interrupt_in_a_blocked_hook_ends_it(folder: Path, times: int) -> None:
    process = started(folder, "parts.py:Blocked", "--log-file", f"blocked{times}.log", "-v")
    process.send_signal(signal.SIGINT)
    time.sleep(0.1)
    at = time.monotonic()
    if times == 2:
        process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=20)
    assert time.monotonic() - at < (ORDERLY if times == 1 else AT_ONCE) + SLACK
    assert process.returncode == 130
    if times == 1:
        assert unwatched(errors).startswith("aiorts: E-STOP: not everything ended in 4.8 s: parts.py:")
        assert errors.endswith(", in on_execute still runs; the process ends now\n")
    else:
        assert errors == ""
    text = (folder / f"blocked{times}.log").read_text()
    assert text == "" or text.endswith("\n")


@pytest.mark.slow
@pytest.mark.fault("F09")
def test_an_interrupt_while_a_plugin_is_imported_ends_it_at_once(folder: Path) -> None:
    (folder / "endless.py").write_text(
        "import time\nfrom aiorts import Component\nprint('ready', flush=True)\n"
        "while True:\n    time.sleep(0.01)\nclass Endless(Component):\n    pass\n"
    )
    process = started(folder, "endless.py:Endless")
    at = time.monotonic()
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=20)
    assert time.monotonic() - at < AT_ONCE + SLACK
    assert (process.returncode, errors) == (130, "")


def test_a_run_that_lingers_and_is_watched_again_ends_no_process_that_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    ended: list[str] = []
    monkeypatch.setattr(stopping, "LONGEST_STOP", 0.3)
    monkeypatch.setattr(stopping.Stopper, "end_now", lambda _self, _status, text="": ended.append(text))
    stopper = stopping.Stopper()

    async def attach() -> None:
        async with Kernel() as kernel:
            stopper.attach(kernel)

    asyncio.run(attach())
    for _ in range(50):
        stopper.watch(0)
        stopper.linger(0)
        stopping.watch_no_more()
    time.sleep(0.6)
    assert ended == []
