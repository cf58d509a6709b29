"""A component whose operator is on another host does what it says when that one is lost."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("zenoh")

from network.test_other_hosts import PARTS, WAIT, Far

PROGRAM = Path(__file__).parents[1] / "control" / "holding_program.py"
LOST = "counter: the link to its operator is lost: the operator [tester, another host]; it is deactivated"


class FarDrive(Far):
    """A run whose counter is to stand still without its operator."""

    parts = PARTS.replace('"""Counts."""', 'on_link_lost = "deactivate"')


@pytest.fixture
def drive(tmp_path: Path) -> Iterator[FarDrive]:
    run = FarDrive(tmp_path, "--allow-control", "-v")
    until = time.monotonic() + WAIT
    try:
        while "active" not in run.do("ls", "-l")[1].split():
            assert time.monotonic() < until, run.log.read_text()
        yield run
    finally:
        run.close()


def _holding(drive: FarDrive) -> tuple[subprocess.Popen[str], int]:
    """`aiorts at` with a client that operates the counter, and the client's process."""
    client = drive.start(stdin=subprocess.PIPE, start_new_session=True)
    assert client.stdin is not None
    assert client.stdout is not None
    client.stdin.write(f"echo $$; exec {sys.executable} {PROGRAM} robot configure=counter\n")
    client.stdin.flush()
    ending = threading.Timer(WAIT, client.kill)
    ending.start()
    process = int(client.stdout.readline())
    assert client.stdout.readline() == "holds\n"
    ending.cancel()
    return client, process


def _is_inactive(drive: FarDrive) -> bool:
    return "inactive" in drive.do("ls", "-l")[1].split()


@pytest.mark.slow(kept_by="control/test_operator_lost.py::test_each_does_what_it_says_when_the_client_is_killed")
@pytest.mark.parametrize("what", ["client", "all"])
def test_a_client_of_another_host_that_is_killed_is_lost(drive: FarDrive, what: str) -> None:
    at, process = _holding(drive)
    with at:
        if what == "client":
            os.kill(process, signal.SIGKILL)
        else:
            os.killpg(at.pid, signal.SIGKILL)
        until = time.monotonic() + WAIT
        while not _is_inactive(drive):
            assert time.monotonic() < until, drive.log.read_text()
    assert drive.log.read_text().count(LOST) == 1


@pytest.mark.slow(kept_by="control/test_operator_lost.py::test_who_ends_in_order_is_not_lost")
def test_one_that_ends_in_order_is_not(drive: FarDrive) -> None:
    at, _ = _holding(drive)
    with at:
        at.communicate("\n", timeout=WAIT)
    assert at.returncode == 0
    assert not _is_inactive(drive)
    assert LOST not in drive.log.read_text()
