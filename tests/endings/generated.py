"""Systems made at random, of the components in `ending_parts.py`, and what their books have to say at the end.

Pure: a seed makes a system, books become faults. A system has cells of at least four kinds that are tied to one another
by their samples, in several contexts; a part of it may be another kernel, its peer.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import Any, Final

PARTS: Final = Path(__file__).with_name("ending_parts.py")
CELLS: Final = ("services", "goals", "synchronisers", "composites", "links", "isolated")
LEAST_KINDS: Final = 4
_LIKELY: Final = {"services": 0.7, "goals": 0.6, "synchronisers": 0.6, "composites": 0.6, "links": 0.4, "isolated": 0.4}
_OPTIONS: Final[list[str]] = [
    "length = 3",
    'length = 2\nfull = "reject"',
    'subscription = "new"\nlength = 1000',
    'subscription = "periodic"\npush_rate = 50.0\nlength = 1000\nout_length = 1000',
    'subscription = "new"\npush = "new"',
    "lifespan = 0.02\nlength = 1000",
]
ALL: Final = "length = 1000"
"""Of a connection that delivers every sample to a reader in an event context."""


@dataclass
class System:
    """A system: components by name with their tables, who is connected with whom, who runs in which context."""

    seed: int
    kinds: set[str] = field(default_factory=set)
    components: dict[str, str] = field(default_factory=dict)
    """By name: the class, and further lines of the table."""
    composites: dict[str, str] = field(default_factory=dict)
    connections: list[tuple[str, str, str]] = field(default_factory=list)
    contexts: list[tuple[str, list[str]]] = field(default_factory=list)
    """Lines of the table, and the members."""
    peer: set[str] = field(default_factory=set)
    """The components that are in the other kernel."""
    moment: float = 0.0
    """Seconds from the activation to the end."""
    turns: int = 0
    """Of the loop, after these seconds; for an end within this process."""

    def name_of_peer(self) -> str:
        return f"peer{self.seed}"

    def text(self, book: Path, *, of_peer: bool = False, links: bool = True) -> str:
        """The system file of this kernel, or of the peer."""
        here = {name for name in self.components if (name in self.peer) is of_peer}
        lines = ["schema = 1"]
        if of_peer and links:
            lines += ["[links]", f'name = "{self.name_of_peer()}"']
        for name, more in {one: self.components[one] for one in self.components if one in here}.items():
            kind, _, rest = more.partition("\n")
            lines += [f"[components.{name}]", f'type = "{PARTS.name}:{kind}"', f'params.book = "{book}"', rest]
        lines += ["[components.keeper]", f'type = "{PARTS.name}:Keeper"', f'params.book = "{book}"']
        if not of_peer:
            for name, more in self.composites.items():
                lines += [f"[composites.{name}]", more]
            for out, into, options in self.connections:
                ends = [
                    f"{self.name_of_peer()}/{end}" if end.partition(".")[0] in self.peer else end for end in (out, into)
                ]
                lines += ["[[connections]]", f'from = "{ends[0]}"', f'to = "{ends[1]}"', options]
        number = 0
        for table, members in self.contexts:
            those = [one for one in members if one in here or (one in self.composites and not of_peer)]
            if those:
                number += 1
                lines += [f"[contexts.c{number}]", table, f"members = {json.dumps(those)}"]
        lines += ["[contexts.last]", 'kind = "event"', 'members = ["keeper"]']
        return "\n".join(line for line in lines if line) + "\n"


class _Maker:
    """Makes one system."""

    def __init__(self, seed: int) -> None:
        self.random = Random(seed)
        self.system = System(seed)
        self.outs: list[str] = []
        """Out-ports of this kernel whose samples a cell may take."""
        self.loose: list[str] = []
        """Components, and composites, that have no context yet and may share one."""
        self.alone: list[str] = []
        """Those whose hooks wait for others."""
        self.threads: set[str] = set()
        """Those that may run in a thread."""

    def add(self, kind: str, more: str = "", *, alone: bool = False, thread: bool = False, peer: bool = False) -> str:
        name = f"{kind.lower()}{len(self.system.components)}"
        self.system.components[name] = f"{kind}\n{more}"
        (self.alone if alone else self.loose).append(name)
        if thread:
            self.threads.add(name)
        if peer:
            self.system.peer.add(name)
        return name

    def connect(self, out: str, into: str, options: str | None = None) -> None:
        if options is None:
            far = out.partition(".")[0] in self.system.peer  # whose kernel alone may say when samples are sent
            options = ALL if far or self.random.random() < 0.6 else self.random.choice(_OPTIONS)
        self.system.connections.append((out, into, options))

    def numbers(self, *, peer: bool = False) -> str:
        """The out-port of a source."""
        name = self.add("Numbers", f"params.burst = {self.random.choice((1, 1, 3, 20))}", thread=not peer, peer=peer)
        return f"{name}.out"

    def taker(self, **more: Any) -> str:
        """The in-port of a sink."""
        kind = self.random.choice(("Take", "Take", "TakeOne", "Await"))
        alone = kind == "Await"
        return f"{self.add(kind, alone=alone, thread=not alone and not more, **more)}.inp"

    def some_out(self) -> str:
        if not self.outs or self.random.random() < 0.3:
            self.outs.append(self.numbers())
        return self.random.choice(self.outs)

    # -- cells -----------------------------------------------------------------------------------------------------

    def services(self) -> None:
        provider = f"{self.add(*self.random.choice(self._answers()))}.s"
        if self.random.random() < 0.4:
            between = self.add("Between")
            self.connect(f"{between}.r", provider, "")
            provider = f"{between}.s"
            if self.random.random() < 0.4:
                circle = self.add("Between")
                self.connect(f"{circle}.r", provider, "")
                other = self.add("Between")
                self.connect(f"{other}.r", f"{circle}.s", "")
                provider = f"{other}.s"
        for _ in range(self.random.randint(1, 2)):
            self.asks(provider)

    @staticmethod
    def _answers() -> list[tuple[str]]:
        return [("Answer",), ("AnswerAtOnce",)]

    def asks(self, provider: str) -> None:
        name = self.add("Ask")
        self.connect(f"{name}.r", provider, "")
        self.outs.append(f"{name}.out")

    def goals(self) -> None:
        works = self.add("Work")
        for _ in range(self.random.randint(1, 2)):
            kind = self.random.choice(("Order", "Watch"))
            client = self.add(kind, alone=kind == "Order")
            self.connect(f"{client}.r", f"{works}.s", "")

    def synchronisers(self) -> None:
        fuse = self.add("Fuse")
        for port in "ab":
            self.connect(self.numbers(), f"{fuse}.{port}", ALL)
        self.outs.append(f"{fuse}.out")

    def composites(self) -> None:
        first, last = self.add("Pass"), self.add("Pass")
        taken = self.some_out()
        self.connect(f"{first}.out", f"{last}.inp")
        members, more = [first, last], ""
        if self.random.random() < 0.4:
            members.append(self.add("Numbers"))
            self.outs.append(f"{members[-1]}.out")
        self.random.shuffle(members)
        if self.random.random() < 0.4:
            more = '\norder = "dataflow"'
        name = f"group{len(self.system.composites)}"
        exported = {f"{first}.inp": "inp", f"{last}.out": "out"}
        table = ", ".join(f'"{port}" = "{shown}"' for port, shown in exported.items())
        self.system.composites[name] = f"members = {json.dumps(members)}\nexported = {{{table}}}{more}"
        self.loose = [one for one in self.loose if one not in members] + [name]
        self.connect(taken, f"{name}.inp")
        self.outs.append(f"{name}.out")

    def links(self) -> None:
        ways = self.random.sample(("out", "in", "call"), self.random.randint(1, 3))
        if "out" in ways:
            self.connect(self.some_out(), self.taker(peer=True), ALL)
        if "in" in ways:
            self.outs.append(self.numbers(peer=True))
        if "call" in ways:
            self.asks(f"{self.add('Answer', peer=True)}.s")

    def isolated(self) -> None:
        kind = self.random.choice(("Pass", "Ask", "Answer", "Take"))
        if kind == "Ask":
            self.asks(f"{self.add('Answer')}.s")
            name = self.system.connections[-1][0].partition(".")[0]
        else:
            taken = self.some_out() if kind != "Answer" else ""
            name = self.add(kind)
            if taken:
                self.connect(taken, f"{name}.inp", ALL)
            if kind == "Pass":
                self.outs.append(f"{name}.out")
            if kind == "Answer":
                self.asks(f"{name}.s")
        self.system.components[name] += '\nisolation = "process"'
        self.loose.remove(name)
        self.system.contexts.append((self.a_table(), [name]))

    # -- the rest --------------------------------------------------------------------------------------------------

    def a_table(self, *, thread: bool = False) -> str:
        """The table of a context."""
        if thread and self.random.random() < 0.4:
            return 'kind = "thread"\nrate = 100.0'
        if self.random.random() < 0.5:
            return f'kind = "event"\nevery = {self.random.choice((0.005, 0.02))}'
        return f'kind = "periodic"\nrate = {self.random.choice((50.0, 100.0, 200.0))}'

    def rest(self) -> None:
        """Sinks for what nobody takes yet, perhaps a circle and a source that waits, and contexts for all."""
        taken = {out for out, _, _ in self.system.connections}
        for out in [one for one in self.outs if one not in taken]:
            self.connect(out, self.taker())
        if self.random.random() < 0.3:
            one, other = self.add("Plant", alone=True), self.add("Pass")
            self.connect(f"{one}.out", f"{other}.inp")
            self.connect(f"{other}.out", f"{one}.inp")
        if self.random.random() < 0.3:
            patient, taker = self.add("Patient", "params.burst = 5", alone=True), self.add("Take", alone=True)
            self.connect(f"{patient}.out", f"{taker}.inp", 'length = 2\nfull = "block"\ntimeout = 20.0')
        self.random.shuffle(self.loose)
        for side in (False, True):
            those = [one for one in self.loose if (one in self.system.peer) is side]
            parts: dict[int, list[str]] = defaultdict(list)
            for one in those:
                parts[self.random.randrange(2 if side else 3)].append(one)
            for members in parts.values():
                able = not side and all(one in self.threads for one in members)
                self.system.contexts.append((self.a_table(thread=able), members))
        for one in self.alone:  # in a circle somebody has to have a rate
            rate = one.startswith("plant")
            self.system.contexts.append(('kind = "periodic"\nrate = 100.0' if rate else self.a_table(), [one]))
        self.random.shuffle(self.system.contexts)


def system_of(seed: int) -> System:
    """The system of a seed."""
    maker = _Maker(seed)
    random, system = maker.random, maker.system
    kinds = {kind for kind in CELLS if random.random() < _LIKELY[kind]}
    while len(kinds) < LEAST_KINDS - 1:  # several contexts are the fourth
        kinds.add(random.choice(CELLS))
    cells = sorted(kinds)
    random.shuffle(cells)
    for kind in cells:
        getattr(maker, kind)()
    maker.rest()
    system.kinds = kinds | {"contexts"}
    system.moment = random.choice((0.0, 0.02, 0.1, 0.3)) * random.random() * 2
    system.turns = random.randrange(40)
    return system


# -- what the books have to say ------------------------------------------------------------------------------------


def faults(system: System, books: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """What is wrong with the books of a system that has ended, by component; those of keepers are there, too."""
    found = [f"{name}: it has no book" for name in [*system.components, "keeper"] if name not in books]
    for name, book in books.items():
        counts = book["counts"]
        if book.get("faults"):
            found.append(f"{name}: {book['faults']}")
        if counts.get("aborted"):
            found.append(f"{name}: was in error")
        if counts.get("activated") != counts.get("deactivated"):
            found.append(f"{name}: activated {counts.get('activated')}, deactivated {counts.get('deactivated')}")
        found += [f"{name}: {one}" for one in _own(book, outlives=name in system.peer)]
    found += _joint(system, books)
    return found


def _own(book: Mapping[str, Any], *, outlives: bool) -> Iterable[str]:
    """What does not add up in the book of one component; `outlives`: what it sent on when its readers' kernel ended."""
    for ledger in book["ledgers"]:
        taken = ledger["acknowledged"] if ledger["delivered"] is None else ledger["delivered"]
        if ledger["written"] != taken + sum(ledger["dropped"].values()) + ledger["left"] or ledger["left"]:
            yield f"ledger {ledger}"
        if "unknown_fate" in ledger["dropped"] and not outlives:
            yield f"fate unknown in an orderly end: {ledger}"
    counts, goals, sync = book["counts"], book.get("goals"), book.get("sync")
    if goals and (goals["accepted"], goals["running"]) != (goals["ended"], 0):
        yield f"goals {goals}"
    if goals and goals["accepted"] != counts.get("accepted", 0):
        yield f"goals {goals}, it counted {counts}"
    for port, one in (sync or {}).items():
        if one["taken"] != one["matched"] + sum(one["dropped"].values()) + one["held"] or one["held"]:
            yield f"synchroniser's {port} {one}"
        if one["matched"] != counts.get("written", 0):
            yield f"synchroniser's {port} {one}, it counted {counts}"
    if counts.get("asked", 0) and "written" in counts and "read" not in counts and counts["asked"] != counts["written"]:
        yield f"asked and answered differ: {counts}"
    if counts.get("ordered", 0) - counts.get("done", 0) - counts.get("undone", 0) not in (0, 1):
        yield f"ordered and done differ: {counts}"


def _joint(system: System, books: Mapping[str, Mapping[str, Any]]) -> Iterable[str]:
    """What writers and readers say differently of one connection."""
    reads: dict[str, int] = defaultdict(int)
    for out, into, options in system.connections:
        if not options:
            continue
        writer, reader = _inner(system, out), _inner(system, into)
        if writer not in books or reader not in books:
            continue
        sent = _ledgers(books[writer], "out", f"{writer}.{_port(out)}", f"{reader}.{_port(into)}")
        got = _ledgers(books[reader], "in", f"{reader}.{_port(into)}", f"{writer}.{_port(out)}")
        wrote = books[writer]["counts"].get("written", 0)
        nothing = len(sent) + len(got) < 2 and not any(one["written"] for one in (*sent, *got))
        if nothing and (not wrote or writer in system.peer):
            continue  # it ended before they looked at their ports
        if not got and not books[reader]["counts"]:
            continue  # the reader's context was not started before the end
        if len(sent) != 1 or len(got) != 1:
            yield f"{out} -> {into}: ledgers {sent} and {got}"
            continue
        if sent[0]["written"] != wrote and (writer not in system.peer or sent[0]["written"] > wrote):
            yield f"{out} -> {into}: it wrote {wrote}, its ledger is {sent[0]}"
        came = got[0]["written"] - got[0]["dropped"].get("rejected", 0)
        if (taken := sent[0]["acknowledged"]) is not None and taken != came:
            yield f"{out} -> {into}: one end {sent[0]}, the other {got[0]}"
        reads[into] += got[0]["delivered"] or 0
        if options == ALL and _reads_all(system, writer, reader) and (sent[0]["dropped"] or got[0]["dropped"]):
            yield f"{out} -> {into}: lost {sent[0]} {got[0]}"
    for into, delivered in reads.items():
        reader = _inner(system, into)
        sync = books[reader].get("sync")
        read = sync[_port(into)]["taken"] if sync else books[reader]["counts"].get("read", 0)
        if read != delivered:
            yield f"{into}: it read {read}, delivered are {delivered}"


def _inner(system: System, path: str) -> str:
    """The component whose port it is: of a composite the member."""
    name = path.partition(".")[0]
    if name not in system.composites:
        return name
    table = system.composites[name]
    shown = f' = "{_port(path)}"'
    return table.partition(shown)[0].rpartition('"')[0].rpartition('"')[2].partition(".")[0]


def _port(path: str) -> str:
    return path.rpartition(".")[2]


def _ledgers(book: Mapping[str, Any], side: str, own: str, other: str) -> list[dict[str, Any]]:
    there = "in" if side == "out" else "out"
    return [one for one in book["ledgers"] if one[side].endswith(own) and one[there].endswith(other)]


def _reads_all(system: System, writer: str, reader: str) -> bool:
    """Whether it reads all that comes in an event context, where it ends after its writers and reads what is left."""
    kind = system.components[reader].partition("\n")[0]
    if system.components[writer].startswith("Plant") or writer in system.peer:
        return False  # a circle has no order, and the peer ends after this kernel
    place = next((name for name, table in system.composites.items() if f'"{reader}"' in table), reader)
    table = next(table for table, members in system.contexts if place in members)
    return kind in ("Take", "TakeOne", "Await", "Pass", "Fuse") and 'kind = "event"' in table and place == reader
