"""Kernels in processes of their own that are linked over a network, and what came of what they wrote."""

from __future__ import annotations

import json
import os
import queue
import signal
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from itertools import pairwise
from pathlib import Path
from typing import Any

from aiorts_zenoh import NetworkSettings
from aiorts_zenoh.network import engine_settings

PROGRAM = Path(__file__).with_name("linked_program.py")
LEASE = engine_settings(NetworkSettings(insecure=True)).get("transport/link/tx/lease", 10_000) / 1_000
"""Seconds without a sign of life after which the engine gives up a neighbour."""
WAIT = 30.0
"""Seconds for what is to happen at once on a machine that has other things to do."""


class Linked:
    """One kernel in a process of its own.

    Args:
        log: what it says.
        before: words before the command, such as those that run it on another host.
        program: what runs there; it takes commands and answers them as `linked_program.py` does.
    """

    def __init__(
        self, settings: Mapping[str, Any], log: Path, before: Sequence[str] = (), program: Path = PROGRAM
    ) -> None:
        self.settings, self.log, self._before, self._program = settings, log, before, program
        self.start()

    def start(self) -> None:
        """Start it, the first time or again."""
        command = [*self._before, sys.executable, str(self._program), json.dumps(self.settings)]
        with self.log.open("ab") as output:
            self.process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=output, text=True
            )
        self._answers: queue.Queue[str] = queue.Queue()
        threading.Thread(target=self._receive, args=(self.process.stdout, self._answers), daemon=True).start()

    @staticmethod
    def _receive(output: Any, answers: queue.Queue[str]) -> None:
        for line in output:
            answers.put(line)
        output.close()
        answers.put("")

    def do(self, what: str, *, within: float = WAIT, **words: Any) -> Any:
        """What one command answers."""
        self.begin(what, **words)
        return self.answered(within)

    def begin(self, what: str, **words: Any) -> None:
        """Give a command."""
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps({"do": what, **words}) + "\n")
        self.process.stdin.flush()

    def answered(self, within: float = WAIT) -> Any:
        """What the command that was given first answers."""
        try:
            line = self._answers.get(timeout=within)
        except queue.Empty:
            raise AssertionError(f"{self.settings['name']}: no answer within {within} s; {self.said[-2000:]}") from None
        assert line, f"{self.settings['name']} has ended: {self.said[-2000:]}"
        answer = json.loads(line)
        assert "error" not in answer, f"{self.settings['name']}: {answer['error']}"
        return answer["answer"]

    @property
    def said(self) -> str:
        """All that it has said."""
        return self.log.read_text(encoding="utf-8")

    def signal(self, number: signal.Signals) -> None:
        """Send it a signal."""
        os.kill(self.process.pid, number)

    def kill(self) -> None:
        """Kill it, and wait until it is gone."""
        self.process.kill()
        self.process.wait(10)
        if self.process.stdin is not None:
            with suppress(OSError):  # what was written last does not arrive
                self.process.stdin.close()

    def until(self, holds: Callable[[dict[str, Any]], object], within: float = WAIT) -> dict[str, Any]:
        """How it stands, as soon as that holds."""
        ends = time.monotonic() + within
        while not holds(seen := self.do("look")):
            assert time.monotonic() < ends, f"{self.settings['name']}: {seen['states']}, {seen['counts']}; {self.said}"
            time.sleep(0.02)
        return dict(seen)

    def up(self, count: int, within: float = WAIT) -> dict[str, Any]:
        """How it stands, as soon as so many connectors are up and all of them are."""
        return self.until(lambda seen: list(seen["states"].values()) == ["up"] * count, within)


@contextmanager
def ended(*processes: Linked) -> Iterator[None]:
    """Kill them at the end of the block."""
    try:
        yield
    finally:
        for one in processes:
            one.process.kill()
        for one in processes:
            one.kill()


def settings(name: str, *, sources: Sequence[str] = (), sinks: Mapping[str, Path] | None = None, **zenoh: Any) -> Any:
    """Of a kernel on the host `h` and its name."""
    files = {one: str(file) for one, file in (sinks or {}).items()}
    network = {"host": f"h{name}", "insecure": True, **zenoh}
    return {"name": name, "zenoh": network, "sources": list(sources), "sinks": files}


def changed(seen: Mapping[str, Any], since: float, state: str) -> dict[str, float]:
    """After how many seconds each link first had that state."""
    found: dict[str, float] = {}
    for when, name, now in seen["changes"]:
        if when >= since and now == state:
            found.setdefault(name, when - since)
    return found


def came(file: Path) -> dict[int, list[int]]:
    """The numbers that were read of each process that wrote, in the order of their coming."""
    found: dict[int, list[int]] = {}
    data = file.read_bytes() if file.exists() else b""
    for writer, number in struct.iter_unpack("<QQ", data[: len(data) // 16 * 16]):
        found.setdefault(writer, []).append(number)
    return found


def assert_in_order(file: Path) -> None:
    """Nothing came twice, and nothing before what was written earlier."""
    for numbers in came(file).values():
        wrong = [(one, two) for one, two in pairwise(numbers) if one >= two]
        assert not wrong, f"{file.name}: {wrong[:5]}"


def settled(writer: Linked, within: float = WAIT) -> dict[str, Any]:
    """The ledgers of all links that a kernel writes to, joined of both ends, when nothing is under way any more."""
    ends = time.monotonic() + within
    while True:
        found: dict[str, Any] = writer.do("ledger")
        if all("error" not in one and not one["buffered"] and not one["in_flight"] for one in found.values()):
            return found
        assert time.monotonic() < ends, f"{writer.settings['name']}: {found}"
        time.sleep(0.1)
