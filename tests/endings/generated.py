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
from typing import Any, Final, NamedTuple, TypeAlias

PARTS: Final = Path(__file__).with_name("ending_parts.py")
CELLS: Final = ("services", "goals", "synchronisers", "composites", "links", "isolated")
LEAST_KINDS: Final = 4
_LIKELY: Final = {"services": 0.7, "goals": 0.6, "synchronisers": 0.6, "composites": 0.6, "links": 0.4, "isolated": 0.4}
Options: TypeAlias = dict[str, Any]
"""The entries of a table of the system file."""
_OPTIONS: Final[list[Options]] = [
    {"length": 3},
    {"length": 2, "full": "reject"},
    {"subscription": "new", "length": 1000},
    {"subscription": "periodic", "push_rate": 50.0, "length": 1000, "out_length": 1000},
    {"subscription": "new", "push": "new"},
    {"lifespan": 0.02, "length": 1000},
]
ALL: Final[Options] = {"length": 1000}
"""Of a connection that delivers every sample to a reader in an event context."""
CALLS: Final[Options] = {}
"""Of a connection of services."""


class Part(NamedTuple):
    """A component."""

    kind: str
    """Its class."""
    options: Options


class Composite(NamedTuple):
    """A composite: its members, the ports of members by the names that it gives them."""

    members: list[str]
    exported: dict[str, str]
    options: Options


class Place(NamedTuple):
    """A context."""

    kind: str
    options: Options
    members: list[str]


@dataclass
class System:
    """A system: components by name, who is connected with whom, who runs in which context."""

    seed: int
    kinds: set[str] = field(default_factory=set)
    components: dict[str, Part] = field(default_factory=dict)
    composites: dict[str, Composite] = field(default_factory=dict)
    connections: list[tuple[str, str, Options]] = field(default_factory=list)
    contexts: list[Place] = field(default_factory=list)
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
        here = {name: part for name, part in self.components.items() if (name in self.peer) is of_peer}
        lines = ["schema = 1"]

        def table(head: str, options: Options) -> None:
            lines.append(head)
            lines.extend(f"{name} = {json.dumps(value)}" for name, value in options.items())

        if of_peer and links:
            table("[links]", {"name": self.name_of_peer()})
        for name, part in (here | {"keeper": Part("Keeper", {})}).items():
            of_class = {"type": f"{PARTS.name}:{part.kind}", "params.book": str(book)}
            table(f"[components.{name}]", of_class | part.options)
        if not of_peer:
            for name, group in self.composites.items():
                exported = {f'exported."{port}"': shown for shown, port in group.exported.items()}
                table(f"[composites.{name}]", {"members": group.members} | exported | group.options)
            for out, into, options in self.connections:
                ends = [f"{self.name_of_peer()}/{end}" if owner(end) in self.peer else end for end in (out, into)]
                table("[[connections]]", {"from": ends[0], "to": ends[1]} | options)
        for number, place in enumerate([*self.contexts, Place("event", {}, ["keeper"])]):
            those = [
                one for one in place.members if one in {*here, "keeper"} or (one in self.composites and not of_peer)
            ]
            if those:
                table(f"[contexts.c{number}]", {"kind": place.kind, "members": those} | place.options)
        return "\n".join(lines) + "\n"


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

    def add(
        self,
        kind: str,
        options: Options | None = None,
        *,
        alone: bool = False,
        thread: bool = False,
        peer: bool = False,
    ) -> str:
        name = f"{kind.lower()}{len(self.system.components)}"
        self.system.components[name] = Part(kind, options or {})
        (self.alone if alone else self.loose).append(name)
        if thread:
            self.threads.add(name)
        if peer:
            self.system.peer.add(name)
        return name

    def connect(self, out: str, into: str, options: Options | None = None) -> None:
        if options is None:
            far = owner(out) in self.system.peer  # whose kernel alone may say when samples are sent
            options = ALL if far or self.random.random() < 0.6 else self.random.choice(_OPTIONS)
        self.system.connections.append((out, into, options))

    def numbers(self, *, peer: bool = False) -> str:
        """The out-port of a source."""
        burst = self.random.choice((1, 1, 3, 20))
        name = self.add("Numbers", {"params.burst": burst}, thread=not peer, peer=peer)
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
        provider = self.add(self.random.choice(("Answer", "AnswerAtOnce")))
        if self.random.random() < 0.4:
            between = self.add("Between")
            self.calls(between, provider)
            provider = between
        for _ in range(self.random.randint(1, 2)):
            self.asks(provider)
        if self.random.random() < 0.4:  # a circle
            one, other = self.add("Between"), self.add("Between")
            self.calls(one, other)
            self.calls(other, one)
            self.asks(other)

    def calls(self, client: str, provider: str) -> None:
        self.connect(f"{client}.r", f"{provider}.s", CALLS)

    def asks(self, provider: str) -> str:
        """One that asks this one."""
        name = self.add("Ask")
        self.calls(name, provider)
        self.outs.append(f"{name}.out")
        return name

    def goals(self) -> None:
        works = self.add("Work")
        for _ in range(self.random.randint(1, 2)):
            kind = self.random.choice(("Order", "Watch"))
            client = self.add(kind, alone=kind == "Order")
            self.calls(client, works)

    def synchronisers(self) -> None:
        fuse = self.add("Fuse")
        for port in "ab":
            self.connect(self.numbers(), f"{fuse}.{port}", ALL)
        self.outs.append(f"{fuse}.out")

    def composites(self) -> None:
        first, last = self.add("Pass"), self.add("Pass")
        taken = self.some_out()
        self.connect(f"{first}.out", f"{last}.inp")
        members = [first, last]
        if self.random.random() < 0.4:
            members.append(self.add("Numbers"))
            self.outs.append(f"{members[-1]}.out")
        self.random.shuffle(members)
        options = {"order": "dataflow"} if self.random.random() < 0.4 else {}
        name = f"group{len(self.system.composites)}"
        self.system.composites[name] = Composite(members, {"inp": f"{first}.inp", "out": f"{last}.out"}, options)
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
            self.asks(self.add("Answer", peer=True))

    def isolated(self) -> None:
        kind = self.random.choice(("Pass", "Ask", "Answer", "Take"))
        if kind == "Ask":
            name = self.asks(self.add("Answer"))
        else:
            taken = self.some_out() if kind != "Answer" else ""
            name = self.add(kind)
            if taken:
                self.connect(taken, f"{name}.inp", ALL)
            if kind == "Pass":
                self.outs.append(f"{name}.out")
            if kind == "Answer":
                self.asks(name)
        self.system.components[name].options["isolation"] = "process"
        self.loose.remove(name)
        self.place([name])

    # -- the rest --------------------------------------------------------------------------------------------------

    def place(self, members: list[str], *, thread: bool = False) -> None:
        """Put them into a context."""
        if thread and self.random.random() < 0.4:
            made = Place("thread", {"rate": 100.0}, members)
        elif self.random.random() < 0.5:
            made = Place("event", {"every": self.random.choice((0.005, 0.02))}, members)
        else:
            made = Place("periodic", {"rate": self.random.choice((50.0, 100.0, 200.0))}, members)
        self.system.contexts.append(made)

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
            patient, taker = self.add("Patient", {"params.burst": 5}, alone=True), self.add("Take", alone=True)
            self.connect(f"{patient}.out", f"{taker}.inp", {"length": 2, "full": "block", "timeout": 20.0})
        self.random.shuffle(self.loose)
        for side in (False, True):
            those = [one for one in self.loose if (one in self.system.peer) is side]
            parts: dict[int, list[str]] = defaultdict(list)
            for one in those:
                parts[self.random.randrange(2 if side else 3)].append(one)
            for members in parts.values():
                self.place(members, thread=not side and self.threads.issuperset(members))
        for one in self.alone:
            if self.system.components[one].kind == "Plant":  # in a circle somebody has to have a rate
                self.system.contexts.append(Place("periodic", {"rate": 100.0}, [one]))
            else:
                self.place([one])
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
    keepers = ["keeper", "peer/keeper"] if system.peer else ["keeper"]
    found = [f"{name}: it has no book" for name in [*system.components, *keepers] if name not in books]
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
        lost = sum(got[0]["dropped"].values()) - got[0]["dropped"].get("rejected", 0)
        came = got[0]["written"] - got[0]["dropped"].get("rejected", 0)
        # Of what is lost at the reader's end the writer's end counts as dropped what it has been told of.
        if (taken := sent[0]["acknowledged"]) is not None and not came - lost <= taken <= came:
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
    name = owner(path)
    return owner(system.composites[name].exported[_port(path)]) if name in system.composites else name


def owner(path: str) -> str:
    return path.partition(".")[0]


def _port(path: str) -> str:
    return path.rpartition(".")[2]


def _ledgers(book: Mapping[str, Any], side: str, own: str, other: str) -> list[dict[str, Any]]:
    there = "in" if side == "out" else "out"
    return [one for one in book["ledgers"] if one[side].endswith(own) and one[there].endswith(other)]


def _reads_all(system: System, writer: str, reader: str) -> bool:
    """Whether it reads all that comes in an event context, where it ends after its writers and reads what is left."""
    if system.components[writer].kind == "Plant" or writer in system.peer:
        return False  # a circle has no order, and the peer ends after this kernel
    alone = any(place.kind == "event" and reader in place.members for place in system.contexts)
    return alone and system.components[reader].kind in ("Take", "TakeOne", "Await", "Pass", "Fuse")
