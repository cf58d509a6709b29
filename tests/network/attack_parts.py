"""Measures an attack beside a running system, against the same system with an idle loop in the attacker's place.

    def attack(target: Target) -> Sequence[str]:
        return [sys.executable, str(PROGRAM), target.address, str(target.certificates)]

    found = beside(tmp_path, attack, seconds=2.0, names={"other": "component"})
    assert found.ratio >= 0.98
    assert found.lost == 0
    assert found.worst_answer < 2.0
    assert found.grown < 5 << 20

The system is three processes on one processor: `victim`, a kernel with a component at 100 Hz that listens; `reader`,
which a link leads to; and `otto`, an operator with an open session who gives a command every second. The attacker is a
process of its own on the other processor. It prints a line when it begins, and ends when its standard input does; it is
killed where it does not. In a baseline a loop that does nothing takes the attacker's processor.

Four rounds are run: baseline, attack, baseline, attack. Nothing is asserted here but that the system is whole before
the first round; `names` are further names with certificates and their roles, besides `victim`, `reader` and `otto`.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from network.certificate_parts import folder
from network.linked_parts import Linked
from network.network_parts import free_port

PROGRAM = Path(__file__).with_name("attacked_program.py")
IDLES = [sys.executable, "-c", "print(flush=True)\nwhile True: pass"]
BEGINS = 20.0
"""Seconds within which an attacker begins, and the system is whole."""
ENDS = 5.0
"""Seconds that an attacker has to end by itself."""
LATE = 60.0
"""Seconds in which a victim that is held up comes to say how it stands."""


class Target(NamedTuple):
    """What an attacker is told."""

    address: str
    certificates: Path
    host: str = "hvictim"
    kernel: str = "victim"
    process: int = 0
    """The victim's process."""


@dataclass(frozen=True)
class Round:
    """What was measured in one round."""

    attacked: bool
    seconds: float
    cycles: int
    gap: float
    """Seconds between two cycles, the longest."""
    lost: int
    """Samples that the link has lost."""
    written: int
    read: int
    """Samples that were written, and that have come."""
    answers: tuple[float, ...]
    """Seconds until each of the operator's commands was answered."""
    faults: tuple[str, ...]
    """What the operator was told instead of an answer."""
    memory: int
    """Bytes of the victim that are in memory at its end."""
    blocks: int
    """Blocks of memory that the victim's Python holds at its end: what the engine holds is not among them."""
    standing: str
    """How the victim stands with its name at its end."""
    said: str
    """What the attacker has said."""

    @property
    def rate(self) -> float:
        """Cycles a second."""
        return self.cycles / self.seconds


@dataclass(frozen=True)
class Outcome:
    """The rounds, and what they say together."""

    rounds: tuple[Round, ...]

    def _of(self, attacked: bool) -> list[Round]:
        return [one for one in self.rounds if one.attacked is attacked]

    @property
    def ratio(self) -> float:
        """Cycles a second of the attacked rounds to those of the others."""
        attacked, alone = (
            sum(one.cycles for one in found) / sum(one.seconds for one in found)
            for found in (self._of(True), self._of(False))
        )
        return attacked / alone

    @property
    def lost(self) -> int:
        """Samples that the link has lost in attacked rounds."""
        return sum(one.lost for one in self._of(True))

    @property
    def worst_answer(self) -> float:
        """Seconds until the operator's latest answer in attacked rounds; infinite where there was none, or a fault."""
        answers = [one for found in self._of(True) for one in found.answers]
        faults = [one for found in self._of(True) for one in found.faults]
        return max(answers) if answers and not faults else float("inf")

    @property
    def grown(self) -> int:
        """Bytes by which the last attacked round has made the victim larger than the first one."""
        first, *_, last = self._of(True)
        return last.memory - first.memory

    @property
    def kept(self) -> int:
        """Blocks by which the last attacked round has made the victim's Python larger than the first one."""
        first, *_, last = self._of(True)
        return last.blocks - first.blocks

    def __str__(self) -> str:
        lines = [
            f"{'attacked' if one.attacked else 'alone':8} {one.rate:6.2f} cycles/s, "
            f"longest gap {one.gap * 1e3:.0f} ms, {one.written} written, {one.read} read, {one.lost} lost, "
            f"answers up to {max(one.answers, default=float('inf')) * 1e3:.0f} ms {one.faults or ''}, "
            f"{one.memory >> 10} KiB, {one.standing}; {one.said}"
            for one in self.rounds
        ]
        whole = f"ratio {self.ratio:.4f}, lost {self.lost}, worst answer {self.worst_answer:.3f} s"
        return "\n".join([*lines, f"{whole}, grown {self.grown >> 10} KiB, kept {self.kept} blocks"])


@contextmanager
def pinned(processor: int) -> Iterator[None]:
    """What is started within runs on this processor."""
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {processor})
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


class System:
    """The victim, its reader and its operator."""

    def __init__(self, path: Path, names: Mapping[str, str], processor: int, every: float) -> None:
        self.certificates = path / "certificates"
        folder(self.certificates, victim="component", reader="component", otto="operator", **names)
        self.address = f"127.0.0.1:{free_port()}"
        self.processes: list[Linked] = []
        self._folder = tempfile.TemporaryDirectory(prefix="ai")  # short: a socket's path has 107 letters
        try:
            self._begin(path, processor, every)
        except BaseException:
            self.end()
            raise

    def _begin(self, path: Path, processor: int, every: float) -> None:
        with pinned(processor):
            self.victim = self._start(path, "victim", "victim")
            self.victim.until(lambda seen: seen["standing"] == "owns", BEGINS)
            self.reader = self._start(path, "reader", "reads")
            self.victim.until(lambda seen: "hreader/reader" in seen["peers"], BEGINS)
            self.victim.do("connect", to="hreader/reader/sink.inp")
            self.victim.until(lambda seen: seen["states"] == ["up"], BEGINS)
            self.operator = self._start(path, "otto", "operates", every=every, folder=self._folder.name)
        until = time.monotonic() + BEGINS
        while not self.operator.do("answers"):
            assert time.monotonic() < until, self.operator.said
            time.sleep(0.05)

    def _start(self, path: Path, name: str, role: str, **words: Any) -> Linked:
        settings = {"name": name, "role": role, "address": self.address, "certificates": str(self.certificates)}
        self.processes.append(one := Linked({**settings, **words}, path / f"{name}.log", program=PROGRAM))
        return one

    def end(self) -> None:
        """Kill its processes."""
        for one in self.processes:
            one.kill()
        self._folder.cleanup()

    @property
    def target(self) -> Target:
        return Target(self.address, self.certificates, process=self.victim.process.pid)

    def ledger(self) -> dict[str, Any]:
        """What the link has written and lost, when both its ends say so."""
        until = time.monotonic() + LATE
        while "fault" in (found := self.victim.do("ledger", within=LATE)):
            assert time.monotonic() < until, found
            time.sleep(0.1)
        return dict(found)


@contextmanager
def attacking(words: Sequence[str], processor: int, log: Path) -> Iterator[list[str]]:
    """An attacker that has begun; what it has said is there when it has ended."""
    said: list[str] = []
    with log.open("w") as output, pinned(processor):
        process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=output, text=True)
    try:
        assert process.stdin is not None
        assert process.stdout is not None
        assert process.stdout.readline(), f"the attacker has ended: {log.read_text()[-2000:]}"
        yield said
        process.stdin.close()
        with suppress(subprocess.TimeoutExpired):
            process.wait(0.0 if words is IDLES else ENDS)
        process.kill()
        said += process.stdout.read().split()
    finally:
        process.kill()
        process.wait(10.0)
        for end in (process.stdin, process.stdout):
            with suppress(OSError):  # what was written last does not arrive
                end and end.close()


def one_round(
    system: System, words: Sequence[str], processor: int, seconds: float, rest: float, log: Path, *, attacked: bool
) -> Round:
    """What happens beside one attacker, for `seconds`, and for `rest` after its end."""
    read, lost = system.reader.do("look")["read"], system.ledger()
    system.operator.do("answers")
    before, began = system.victim.do("look"), time.monotonic()
    with attacking(words, processor, log) as said:
        time.sleep(seconds)
    time.sleep(rest)
    after = system.victim.do("look", within=LATE)
    answers = [one for one in system.operator.do("answers") if one[0] + one[1] >= began]
    ledger = system.ledger()
    return Round(
        attacked,
        after["at"] - before["at"],
        after["cycles"] - before["cycles"],
        after["gap"],
        ledger["lost"] - lost["lost"],
        ledger["written"] - lost["written"],
        system.reader.do("look")["read"] - read,
        tuple(one[1] for one in answers),
        tuple(one[2] for one in answers if one[2]),
        after["memory"],
        after["blocks"],
        after["standing"],
        f"{' '.join(said)} {log.read_text()[-500:]}".strip(),
    )


def beside(
    path: Path,
    attack: Callable[[Target], Sequence[str]],
    *,
    seconds: float = 1.0,
    rest: float = 0.5,
    rounds: int = 2,
    every: float = 1.0,
    names: Mapping[str, str] | None = None,
) -> Outcome:
    """What becomes of a system beside an attack, and beside none, in turn.

    Args:
        path: for certificates and logs.
        attack: the words of the attacker's command.
        seconds: how long each round is from the attacker's start on; `rest`: and after its end.
        rounds: of each kind.
        every: seconds between two commands of the operator.
        names: further names with certificates, and their roles.
    """
    processors = sorted(os.sched_getaffinity(0))
    if len(processors) < 2:
        pytest.skip("not run: the attacker needs a processor of its own")
    its, theirs = processors[:2]
    system = System(path, names or {}, its, every)
    found = []
    try:
        for number in range(2 * rounds):
            attacked = bool(number % 2)
            words = attack(system.target) if attacked else IDLES
            log = path / f"attacker{number}.log"
            found.append(one_round(system, words, theirs, seconds, rest, log, attacked=attacked))
    finally:
        system.end()
    return Outcome(tuple(found))
