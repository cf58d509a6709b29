"""Systems made at random, of the types in `kinds/counting.py`, in the one form in which a kernel is read."""

from __future__ import annotations

from pathlib import Path
from random import Random
from types import MappingProxyType
from typing import Any

from aiorts.model.policy import ErrorPolicy
from aiorts.model.wanted.entries import (
    ClockEntry,
    ComponentEntry,
    CompositeEntry,
    ConnectionEntry,
    ContextEntry,
    Wanted,
)
from aiorts.model.wanted.restart_policy import Supervision

KINDS = Path(__file__).parent / "kinds" / "counting.py"
_OPTIONS: list[dict[str, Any]] = [
    {},
    {"length": 3},
    {"length": 2, "full": "block"},
    {"length": 4, "full": "reject"},
    {"subscription": "new"},
    {"subscription": "periodic", "push_rate": 5.0},
    {"subscription": "periodic", "push_rate": 20.0, "push": "fifo"},
    {"keep_last": True},
    {"lifespan": 1.0},
    {"measure": 5},
    {"stamp": "read"},
    {"max_gap": 2.0},
]


def random_system(random: Random) -> Wanted:
    """A system of up to eight components."""
    components: dict[str, ComponentEntry] = {}
    for name in sorted(random.sample("abcdefgh", random.randint(0, 8))):
        writer = name in "abcd"
        kind = random.choice(("Count", "CountBack") if writer else ("Note", "NoteAgain"))
        params = {("step" if writer else "most"): random.randint(4, 6)} if random.random() < 0.4 else {}
        supervision = Supervision(restart="reset") if random.random() < 0.1 else None
        components[name] = ComponentEntry(name, f"{KINDS}:{kind}", MappingProxyType(params), supervision=supervision)
    connections = _connections(random, list(components))
    left = list(components)
    random.shuffle(left)
    composites: dict[str, CompositeEntry] = {}
    if len(left) > 1 and random.random() < 0.4:
        count = random.randint(1, min(3, len(left)))
        members, left = left[:count], left[count:]
        shown = {f"{name}.{'a' if name in 'abcd' else 'x'}": f"of_{name}" for name in members if random.random() < 0.3}
        errors = ErrorPolicy.ISOLATE if random.random() < 0.2 else ErrorPolicy.STOP
        composites["group"] = CompositeEntry("group", tuple(members), errors=errors, exported=shown, named=True)
        left.append("group")
        random.shuffle(left)
    contexts: dict[str, ContextEntry] = {}
    for name in random.sample(["one", "two", "three"], random.randint(0, 3)):
        count = random.randint(0, len(left))
        members, left = left[:count], left[count:]
        kind, given = random.choice(
            [("event", {"every": 0.1}), ("periodic", {"rate": 10.0}), ("periodic", {"rate": 20.0})]
        )
        active = not members or random.random() < 0.8
        contexts[name] = ContextEntry(name, kind, tuple(members), active, MappingProxyType(given))
    return Wanted(
        MappingProxyType(components),
        connections,
        MappingProxyType(contexts),
        ClockEntry("simulated"),
        MappingProxyType(composites),
    )


def _connections(random: Random, names: list[str]) -> tuple[ConnectionEntry, ...]:
    outs = [f"{name}.{port}" for name in names if name in "abcd" for port in "ab"]
    ins = [f"{name}.{port}" for name in names if name not in "abcd" for port in "xy"]
    if not outs or not ins:
        return ()
    pairs = sorted({(random.choice(outs), random.choice(ins)) for _ in range(random.randint(0, 6))})
    return tuple(
        ConnectionEntry(pair, MappingProxyType(dict(random.choice(_OPTIONS))), number)
        for number, pair in enumerate(pairs, 1)
    )
