"""Either end of a link stands still at any moment or step, the other one is started anew meanwhile: it is up soon after.

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
    """A program, what it tells, and when."""

    def __init__(self, folder: str, **settings: Any) -> None:
        self.said = tempfile.TemporaryFile()
        self._process = subprocess.Popen(
            [sys.executable, str(PROGRAM), json.dumps(settings)],
            env=os.environ | {"XDG_RUNTIME_DIR": folder},
            stdout=subprocess.PIPE,
            stderr=self.said,
        )
        self.pid = self._process.pid
        self._lines: list[dict[str, Any]] = []
        self._came = threading.Condition()
        self._listening = threading.Thread(target=self._listen, daemon=True)
        self._listening.start()

    def _listen(self) -> None:
        assert self._process.stdout is not None
        with self._process.stdout as output:
            for line in output:
                with self._came:
                    self._lines.append(json.loads(line))
                    self._came.notify_all()

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

    def went_on(self, since: float, *, blocks: bool) -> bool:
        """Whether it came to the step at which it stands still after this moment; it goes on now."""
        if self.told("held", 0.0, lambda line: line["t"] > since) is None:
            return False
        if blocks:
            return self.told("free", STARTS) is not None
        self.send(signal.SIGCONT)
        return True

    def ready(self, holds: Callable[[dict[str, Any]], object] = bool) -> dict[str, Any]:
        """What it tells when it has come up."""
        line = self.told("ready", STARTS, holds)
        assert line is not None, f"has not come up: {self.complaints}"
        return line

    @property
    def complaints(self) -> str:
        self.said.seek(0)
        return self.said.read().decode(errors="replace")[-3_000:]

    def send(self, number: signal.Signals) -> None:
        self._process.send_signal(number)

    def end(self, how: signal.Signals = signal.SIGKILL) -> None:
        """End it, and wait for that."""
        self._process.send_signal(how)
        try:
            self._process.wait(STARTS)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait(STARTS)
        self._listening.join(STARTS)
        self.said.close()


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
        self.schedule, self._places = schedule, places
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
        held = end == self.schedule.held and end not in self.processes
        step = {"step": self.schedule.step, "call": self.schedule.call, "seconds": BLOCKS * self.schedule.blocks}
        place = self._places[end % len(self._places)]
        self.processes[end] = process = Process(
            place, role=self._roles[end], zenoh=self._zenoh[end], **(step if held else {})
        )
        return process

    def is_up(self, after: float, within: float) -> float | None:
        """When a sample of the writer that there is now was read after this moment."""
        writer, reader = self.processes[1], self.processes[1 if self.schedule.kind == "members" else 0]
        line = reader.told("read", within, lambda line: line["t"] > after and line["of"] == writer.pid)
        return None if line is None else float(line["t"])

    def hold(self, chosen: random.Random) -> bool:
        """Wait until the end stands still at its step, or stop it at a moment; whether a hook blocks it."""
        held = self.processes[self.schedule.held]
        if self.schedule.step and held.told("held", 4.0) is not None:
            return self.schedule.blocks
        time.sleep(chosen.random())
        held.send(signal.SIGSTOP)
        return False

    def play(self) -> float | None:
        """Seconds from when both could talk until the link was up; None: it was not in time."""
        chosen, schedule = random.Random(self.schedule.seed), self.schedule
        for end in chosen.sample((0, 1), 2):
            self.start(end)
            if chosen.random() < 0.5:
                self.processes[end].told("ready", 2.0)
        held, other = self.processes[schedule.held], 1 - schedule.held
        blocked = self.hold(chosen)
        if schedule.meanwhile:
            self.processes[other].end(signal.SIGKILL if schedule.meanwhile == "killed" else signal.SIGTERM)
            self.start(other)
            if chosen.random() < 0.7:
                self.processes[other].told("ready", 4.0)
        time.sleep(chosen.random() * 2.0)
        if blocked:
            free = held.told("free", STARTS)
            assert free is not None
            since = float(free["t"])
        else:
            held.send(signal.SIGCONT)
            since = time.monotonic()
        for one in self.processes.values():
            one.ready()
        both = max(since, *(float(one.ready()["t"]) for one in self.processes.values()))
        up = self.is_up(both, WITHIN)
        if up is None and held.went_on(since, blocks=schedule.blocks):  # it came to its step only now
            both = time.monotonic()
            up = self.is_up(both, WITHIN)
        if up is None:
            later = self.is_up(both, 15.0)
            print(f"{schedule}: up after {'more than 15' if later is None else round(later - both, 2)} s")
            for one in self.processes.values():
                print(one.complaints)
            return None
        return up - both


def play(schedule: Schedule) -> float | None:
    apart = schedule.kind == "zenoh"
    with folders(2 if apart else 1) as places:
        if schedule.kind == "isolated":
            return play_isolated(schedule, places[0])
        ends = Ends(schedule, places)
        try:
            return ends.play()
        finally:
            for one in ends.processes.values():
                one.end()


def play_isolated(schedule: Schedule, place: str) -> float | None:
    """The same where one end is the process of an isolated component; its kernel may stand still at any step."""
    chosen = random.Random(schedule.seed)
    step = {"step": schedule.step, "call": schedule.call + 2, "seconds": BLOCKS * schedule.blocks}
    whole = Process(place, role="isolating", **(step if schedule.held == 0 else {}))
    stopped = 0
    try:
        since = 0.0
        if schedule.held == 0 and schedule.step and whole.told("held", 6.0) is not None:
            time.sleep(chosen.random() * 2.0)
            if not schedule.blocks:
                whole.send(signal.SIGCONT)
                since = time.monotonic()
        part = int(whole.ready()["part"])
        time.sleep(chosen.random())
        stopped = whole.pid if schedule.held == 0 else part
        os.kill(stopped, signal.SIGSTOP)
        time.sleep(chosen.random() * 2.5)
        if schedule.meanwhile:
            os.kill(part, signal.SIGKILL)
        if not (schedule.meanwhile and stopped == part):
            os.kill(stopped, signal.SIGCONT)
        since = max(since, time.monotonic())
        anew = None if schedule.meanwhile else {"t": since}
        for _ in range(2):
            anew = anew or whole.told("ready", STARTS / 3, lambda line: line["part"] != part)
            if whole.went_on(since, blocks=schedule.blocks):  # it came to its step only now
                since = time.monotonic()
        assert anew is not None, f"{schedule}: has not come up: {whole.complaints}"
        since = max(since, float(anew["t"]))
        line = whole.told("read", WITHIN, lambda line: line["t"] > since and line["of"] == whole.pid)
        if line is None and whole.went_on(since, blocks=schedule.blocks):
            since = time.monotonic()
            line = whole.told("read", WITHIN, lambda line: line["t"] > since and line["of"] == whole.pid)
        if line is None:
            print(f"{schedule}: not up within {WITHIN} s; {whole.complaints}")
        return None if line is None else float(line["t"]) - since
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
        step = {"step": "lost", "call": 1, "seconds": BLOCKS} if blocks else {}
        reader = Process(place, role="reader", **step)
        writers = []
        try:
            reader.ready()
            writers.append(Process(place, role="writer"))
            assert reader.told("read", STARTS) is not None
            if not blocks:
                reader.send(signal.SIGSTOP)
            writers[0].end()
            writers.append(Process(place, role="writer"))
            writers[1].ready()
            if blocks:
                free = reader.told("free", STARTS)
                assert free is not None
                since = float(free["t"])
            else:
                time.sleep(1.5)
                reader.send(signal.SIGCONT)
                since = time.monotonic()
            up = reader.told("read", 10.0, lambda line: line["of"] == writers[-1].pid)
            assert up is not None, "they were not linked again"
            assert float(up["t"]) - since < WITHIN
        finally:
            for one in (reader, *writers[-1:]):
                one.end()
