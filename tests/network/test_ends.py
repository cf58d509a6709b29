"""A process with certificates ends within 5 s, however it ends, and whatever its connection is like."""

from __future__ import annotations

import os
import queue
import re
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Self

import pytest

pytest.importorskip("zenoh")
pytest.importorskip("cryptography")

from campaign import CAMPAIGN, time_limit
from network.certificate_parts import folder
from network.network_parts import free_port

PROGRAM = Path(__file__).with_name("ending_program.py")
ENDS = 5.0
AT_ONCE = 4
"""Processes that end at the same time, each linked with one of its own."""


@dataclass(frozen=True)
class Way:
    """How a process ends.

    Args:
        sent: a signal that it gets.
        errors: names of exceptions of which it may say that they were raised.
        linked: it needs somebody to be linked with.
    """

    status: int = 0
    sent: signal.Signals | None = None
    errors: set[str] = field(default_factory=set)
    linked: bool = False


INTERRUPTED = Way(-signal.SIGINT, errors={"CancelledError", "KeyboardInterrupt"})
WAYS = {
    "unclosed": Way(),
    "exit": Way(7, errors={"SystemExit"}),
    "exception": Way(1, errors={"RuntimeError"}),
    "SIGINT": Way(-signal.SIGINT, signal.SIGINT, INTERRUPTED.errors),
    "SIGTERM": Way(-signal.SIGTERM, signal.SIGTERM),
    "exit at SIGTERM": Way(143, signal.SIGTERM, {"SystemExit"}),
    "in a hook": Way(linked=True),
    "in a call": Way(linked=True),
    "in a listener": Way(linked=True),
    "peer gone": Way(linked=True),
    "threads": Way(),
    "twice": Way(),
    "SIGINT in close": INTERRUPTED,
    "two SIGINT in close": INTERRUPTED,
}
UVLOOP_ALONE = "two SIGINT in close"
"""Of asyncio's loop, a second SIGINT may take the turn of a task that the end then waits for."""
CONNECTIONS = ("linked", "refused", "nobody there")
TIMES = 200 if CAMPAIGN else len(WAYS)


class Place:
    """Where one process after the other ends; none of them knows of other places."""

    def __init__(self, certificates: Path, loop: str) -> None:
        self._certificates, self._loop, self._address = certificates, loop, f"127.0.0.1:{free_port()}"
        self._folder = tempfile.TemporaryDirectory(prefix="ai")

    def __enter__(self) -> Self:
        self._peer = self._start(self._address, "ours", "listen")
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        self._peer.kill()
        self._peer.communicate(timeout=20.0)
        self._folder.cleanup()

    def _start(self, address: str, certificates: str, *words: str) -> subprocess.Popen[str]:
        command = [sys.executable, "-X", "faulthandler", str(PROGRAM), address]
        command += [str(self._certificates / certificates), self._loop, *words]
        own = os.environ | {"XDG_RUNTIME_DIR": self._folder.name}
        said = None if words == ("listen",) else subprocess.PIPE
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=said, text=True, env=own
        )
        assert process.stdout is not None
        if (line := process.stdout.readline()) not in ("listens\n", "ready\n"):
            process.kill()
            raise AssertionError(f"{words}: {line!r} {process.communicate(timeout=20.0)}")
        return process

    def end(self, name: str, connection: str) -> tuple[float, str]:
        """The seconds that it took, and what is wrong with it."""
        way = WAYS[name]
        address = f"127.0.0.1:{free_port()}" if connection == "nobody there" else self._address
        words = (name, "linked") if connection == "linked" else (name,)
        process = self._start(address, "theirs" if connection == "refused" else "ours", *words)
        assert process.stdout is not None
        assert process.stdout.readline() == "ending\n"
        began = time.monotonic()
        if way.sent is not None:
            process.send_signal(way.sent)
        if name == "peer gone":
            with suppress(OSError):
                self._peer.communicate("end\n", timeout=20.0)
        try:
            _, said = process.communicate(timeout=20.0)
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGABRT)
            return 20.0, f"{name}, {connection}: it hangs; {process.communicate(timeout=20.0)[1][-5000:]}"
        took = time.monotonic() - began
        if name == "peer gone":
            self._peer = self._start(self._address, "ours", "listen")
        raised = set(re.findall(r"^(?:\w+\.)*(\w+(?:Error|Exception|Exit|Interrupt))(?::|$)", said, re.MULTILINE))
        wrong = raised - way.errors or (not way.errors and "Traceback" in said)
        wrong = wrong or "Fatal Python error" in said or "panicked" in said
        if wrong or process.returncode != way.status or took > ENDS:
            return took, f"{name}, {connection}: status {process.returncode} after {took:.2f} s; {said[-2000:]}"
        return took, ""


@pytest.mark.slow(kept_by="network/test_security.py::test_two_kernels_with_certificates_lose_nothing")
@pytest.mark.fault("E25", "G11")
@pytest.mark.campaign
@pytest.mark.timeout(time_limit(1_800))
@pytest.mark.parametrize("loop", ["asyncio", "uvloop"])
def test_the_interpreter_ends_in_any_way_whatever_its_connection_is_like(tmp_path: Path, loop: str) -> None:
    pytest.importorskip(loop)
    for one in ("ours", "theirs"):
        folder(tmp_path / one, reader="component", writer="component")
    todo: queue.SimpleQueue[tuple[str, str]] = queue.SimpleQueue()
    names = [name for name in WAYS if loop == "uvloop" or name != UVLOOP_ALONE]
    for number in range(TIMES):
        name, turn = names[number % len(names)], number + number // len(names)
        todo.put((name, "linked" if WAYS[name].linked else CONNECTIONS[turn % len(CONNECTIONS)]))

    def work(_: int) -> list[tuple[float, str]]:
        found = []
        with Place(tmp_path, loop) as place:
            while True:
                try:
                    found.append(place.end(*todo.get_nowait()))
                except queue.Empty:
                    return found
                if found[-1][1]:
                    print(found[-1][1])  # also where the run is ended before its end

    with ThreadPoolExecutor(AT_ONCE) as pool:
        found = [one for several in pool.map(work, range(AT_ONCE)) for one in several]
    took, wrong = [seconds for seconds, _ in found], [what for _, what in found if what]
    print(f"{loop}: {len(found) - len(wrong)} of {len(found)} ended, median {statistics.median(took):.2f} s, ", end="")
    print(f"last {max(took):.2f} s")
    assert len(found) == TIMES
    assert not wrong, "\n".join(wrong)
