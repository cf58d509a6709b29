"""Either end of a link stands still at any moment or step, the other is started anew meanwhile: it is up soon after.

It stands still by SIGSTOP, or by a hook that blocks its loop. Each end is a process of its own.
"""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from campaign import CAMPAIGN, time_limit

pytestmark = pytest.mark.slow(
    kept_by="links/test_unix_transport.py::test_a_connection_that_was_ended_before_its_greeting_is_made_again"
)

PROGRAM = Path(__file__).with_name("held_program.py")
WITHIN = 2.0 if CAMPAIGN else 10.0
"""Seconds from when both ends can talk until the link is up; more beside other tests."""
STARTS = 30.0
BLOCKS = 2.5
"""Seconds that a hook blocks: longer than any end is waited for."""
SCHEDULES = {"sockets": 40, "zenoh": 20, "both": 10, "isolated": 15, "members": 15}
STEPS = {
    "begin": "finding",
    "found": "greeting",
    "asked": "offering",
    "answer_to": "answering",
    "settle": "hearing the answer",
    "keep": "opening the channel",
}
"""Methods of all transports at which an end stands still."""


class Process:
    """A program, what it tells, and when. Where it stands still at its step, it goes on after `stops` seconds."""

    def __init__(self, folder: str, *, stops: float = 1.0, **settings: Any) -> None:
        self._said = Path(folder) / f"{time.monotonic_ns()}.log"
        with self._said.open("wb") as said:
            self._process = subprocess.Popen(
                [sys.executable, str(PROGRAM), json.dumps(settings)],
                env=os.environ | {"XDG_RUNTIME_DIR": folder},
                stdout=subprocess.PIPE,
                stderr=said,
            )
        self.pid, self._stops = self._process.pid, stops
        self.went_on = 0.0
        """When it went on last."""
        self._goes = threading.Event()
        self._goes.set()
        self._lines: list[dict[str, Any]] = []
        self._came = threading.Condition()
        self._listening = threading.Thread(target=self._listen, daemon=True)
        self._listening.start()

    def _listen(self) -> None:
        assert self._process.stdout is not None
        with self._process.stdout as output:
            for line in map(json.loads, output):
                if line["what"] == "free":
                    self.went_on = line["t"]
                    self._goes.set()
                elif line["what"] == "held":
                    self._goes.clear()
                with self._came:
                    self._lines.append(line)
                    self._came.notify_all()
                if line["what"] == "held" and not line["blocks"]:
                    time.sleep(self._stops)
                    self.go_on()

    def stop(self) -> None:
        """Have it stand still."""
        self._process.send_signal(signal.SIGSTOP)

    def go_on(self) -> None:
        """Have it go on."""
        self._process.send_signal(signal.SIGCONT)
        self.went_on = time.monotonic()
        self._goes.set()

    def told(self, what: str, within: float, holds: Callable[[dict[str, Any]], object] = bool) -> dict[str, Any] | None:
        """The first line of this kind for which that holds; None: there is none in time."""
        until = time.monotonic() + within
        with self._came:
            while True:
                for line in self._lines:
                    if line["what"] == what and holds(line):
                        return line
                if (left := until - time.monotonic()) <= 0:
                    return None
                self._came.wait(left)

    def ready(self, holds: Callable[[dict[str, Any]], object] = bool) -> float:
        """When it had come up."""
        line = self.told("ready", STARTS, holds)
        assert line is not None, f"has not come up: {self.complaints}"
        return float(line["t"])

    def talks(self, holds: Callable[[dict[str, Any]], object] = bool) -> float:
        """From when it can talk: it has come up, and goes on."""
        ready = self.ready(holds)
        assert self._goes.wait(STARTS)
        return max(ready, self.went_on)

    def reads(self, since: Callable[[], float], writer: int) -> float | None:
        """Seconds until it read what this writer wrote, from when both ends could talk; None: it has not, in time."""
        while True:
            began = since()
            line = self.told("read", WITHIN, lambda line, began=began: line["t"] > began and line["of"] == writer)
            if line is not None and began == since():
                return float(line["t"]) - began
            if began == since():  # else one has stood still meanwhile
                return None

    @property
    def complaints(self) -> str:
        return self._said.read_text(errors="replace")[-3_000:]

    def end(self, how: signal.Signals = signal.SIGKILL) -> None:
        """End it, and wait for that."""
        self._process.send_signal(how)
        try:
            self._process.wait(STARTS)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait(STARTS)
        self._listening.join(STARTS)


class Schedule(NamedTuple):
    """What happens."""

    kind: str
    seed: int
    held: int
    """Which end stands still."""
    step: str
    """Where; "": at a moment."""
    call: int
    blocks: bool
    meanwhile: str
    """What becomes of the other end: "", "killed" or "ended"; then it is started anew."""

    def settings(self) -> dict[str, Any]:
        """What the program of the end that stands still is told."""
        return {"step": self.step, "call": self.call, "seconds": BLOCKS * self.blocks}

    @classmethod
    def of(cls, kind: str, seed: int) -> Schedule:
        chosen = random.Random(f"{kind} {seed}")
        step = [*STEPS, ""][seed % (len(STEPS) + 1)]
        blocks = bool(step) and chosen.random() < 0.3
        meanwhile = chosen.choice(["", "killed", "killed", "ended"])
        return cls(kind, seed, chosen.randrange(2), step, chosen.choice([1, 1, 2]), blocks, meanwhile)


@contextmanager
def folders(count: int) -> Iterator[list[str]]:
    with ExitStack() as stack:
        yield [stack.enter_context(tempfile.TemporaryDirectory(prefix="al")) for _ in range(count)]


class Ends:
    """Both ends of one link, each a process."""

    def __init__(self, schedule: Schedule, places: list[str]) -> None:
        self.schedule, self._places, self._chosen = schedule, places, random.Random(schedule.seed)
        self._roles = ("member", "holding") if schedule.kind == "members" else ("reader", "writer")
        self._zenoh: list[Any] = [None, None]
        if schedule.kind in ("zenoh", "both"):
            from network.network_parts import free_port  # late: it needs the plugin

            address = f"127.0.0.1:{free_port()}"
            self._zenoh = [
                {"host": "ha", "insecure": True, "listen": address},
                {"host": "hb", "insecure": True, "connect": address},
            ]
        self.processes: dict[int, Process] = {}

    def start(self, end: int) -> Process:
        is_held = end == self.schedule.held and end not in self.processes
        self.processes[end] = process = Process(
            self._places[end % len(self._places)],
            role=self._roles[end],
            zenoh=self._zenoh[end],
            stops=0.2 + self._chosen.random() * 5.0,
            **(self.schedule.settings() if is_held else {}),
        )
        return process

    def since(self) -> float:
        """From when both can talk."""
        return max(one.talks() for one in self.processes.values())

    def play(self) -> float | None:
        """Seconds from when both could talk until the link was up; None: it was not in time."""
        chosen, schedule = self._chosen, self.schedule
        for end in chosen.sample((0, 1), 2):
            self.start(end)
            if chosen.random() < 0.5:
                self.processes[end].told("ready", 2.0)
        held, other = self.processes[schedule.held], 1 - schedule.held
        at_step = bool(schedule.step) and held.told("held", 4.0) is not None
        if not at_step:
            time.sleep(chosen.random())
            held.stop()
        if schedule.meanwhile:
            self.processes[other].end(signal.SIGKILL if schedule.meanwhile == "killed" else signal.SIGTERM)
            self.start(other)
            if chosen.random() < 0.7:
                self.processes[other].told("ready", 4.0)
        time.sleep(chosen.random() * 2.0)
        if not at_step:
            held.go_on()
        writer, reader = self.processes[1], self.processes[1 if schedule.kind == "members" else 0]
        return reader.reads(self.since, writer.pid)


def play(schedule: Schedule) -> float | None:
    with folders(2 if schedule.kind == "zenoh" else 1) as places:
        if schedule.kind == "isolated":
            return play_isolated(schedule, places[0])
        ends = Ends(schedule, places)
        try:
            took = ends.play()
            if took is None:
                print(schedule, *(one.complaints for one in ends.processes.values()), sep="\n")
            return took
        finally:
            for one in ends.processes.values():
                one.end()


def play_isolated(schedule: Schedule, place: str) -> float | None:
    """The same where one end is the process of an isolated component; its kernel may stand still at any step."""
    chosen = random.Random(schedule.seed)
    settings = schedule.settings() if schedule.held == 0 else {}
    whole = Process(place, role="isolating", stops=chosen.random() * 2.5, **settings)
    try:
        whole.ready()
        line = whole.told("ready", 0.0)
        assert line is not None
        part = int(line["part"])
        time.sleep(chosen.random())
        stopped = whole.pid if schedule.held == 0 else part
        os.kill(stopped, signal.SIGSTOP)
        time.sleep(chosen.random() * 2.5)
        if schedule.meanwhile:
            os.kill(part, signal.SIGKILL)
        if not (schedule.meanwhile and stopped == part):
            os.kill(stopped, signal.SIGCONT)
        went_on = time.monotonic()

        def since() -> float:
            return max(went_on, whole.talks(lambda line: not schedule.meanwhile or line["part"] != part))

        took = whole.reads(since, whole.pid)
        if took is None:
            print(schedule, whole.complaints, sep="\n")
        return took
    finally:
        whole.end()


@pytest.mark.fault("E06")
@pytest.mark.timeout(time_limit(3_600))
@pytest.mark.parametrize("kind", SCHEDULES)
def test_an_end_that_stood_still_is_linked_again_soon_after(kind: str) -> None:
    if kind in ("zenoh", "both"):
        pytest.importorskip("zenoh")
    count = int(os.environ.get("HELD_UP", 0)) or (SCHEDULES[kind] if CAMPAIGN else 1)
    first = 0 if CAMPAIGN else 1
    took = [play(Schedule.of(kind, seed)) for seed in range(first, first + count)]
    known = sorted(one for one in took if one is not None)
    print(f"{kind}: {len(known)} of {count} up within {WITHIN:g} s; ", end="")
    print(f"median {known[len(known) // 2]:.2f} s, longest {known[-1]:.2f} s" if known else "none")
    assert len(known) == count


@pytest.mark.fault("E06")
@pytest.mark.parametrize("blocks", [False, True], ids=["stopped", "blocked"])
def test_a_writer_that_was_started_anew_finds_a_reader_that_stood_still_meanwhile(blocks: bool) -> None:
    """Longer than it waits for a greeting: they were never linked again."""
    with folders(1) as (place,):
        step: dict[str, Any] = {"step": "lost", "call": 1, "seconds": BLOCKS} if blocks else {}
        reader = Process(place, role="reader", **step)
        writers = []
        try:
            reader.ready()
            writers.append(Process(place, role="writer"))
            assert reader.told("read", STARTS) is not None
            if not blocks:
                reader.stop()
            writers[0].end()
            writers.append(Process(place, role="writer"))
            writers[1].ready()
            if not blocks:
                time.sleep(1.5)
                reader.go_on()
            assert not blocks or reader.told("free", STARTS) is not None
            took = reader.reads(lambda: max(reader.talks(), writers[1].talks()), writers[1].pid)
            assert took is not None, f"they were not linked again: {reader.complaints}"
        finally:
            for one in (reader, *writers[-1:]):
                one.end()
