"""Plans that touch what only one may have, a name, a port, a thread: there, back, and failed at each step."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from aiorts import Kernel
from aiorts.errors import ApplyError
from aiorts.planning import wanted_of
from aiorts.system import build, load, wanted
from planning.test_apply import FAILS, check_ledgers, fail_in_step, texts

pytestmark = pytest.mark.slow

PARTS = """
from typing import Protocol
from aiorts import Component, InPort, OutPort, Provided, Required
from aiorts.types import TimedLong

class Ramp(Component):
    out = OutPort(TimedLong)
    number = 0
    def on_execute(self):
        self.number += 1
        self.out.write_nowait(TimedLong(data=self.number))

class Single(Ramp):
    max_instance = 1

class Meter(Component):
    inp = InPort(TimedLong)
    count = 0
    def on_execute(self):
        self.count += len(self.inp.drain())

class One(Meter):
    inp = InPort(TimedLong, max_connectors=1)

class Adder(Protocol):
    async def add(self, a: int, b: int) -> int: ...

class Server(Component):
    adder = Provided[Adder]()
    async def add(self, a, b):
        return a + b

class Client(Component):
    adder = Required[Adder]()
"""
WORK = {"work": 'kind = "periodic"\nrate = 200.0\nmembers = ["r", "m", "x"]'}
PARTED = {
    "work": 'kind = "periodic"\nrate = 200.0\nmembers = ["r", "x"]',
    "alone": 'kind = "{}"\nrate = 200.0\nmembers = ["m"]',
}
TYPES = {"r": "Ramp", "m": "Meter", "x": "Meter"}
SHOWN = '[composites.g]\nmembers = ["r", "m"]\nexported = ["r.out", "m.inp"]\n'
System = tuple[dict[str, str], list[tuple[str, str, str]], dict[str, str], str]


def system(
    types: dict[str, str], connections: list[tuple[str, str, str]], contexts: dict[str, str] = WORK, more: str = ""
) -> System:
    return types, connections, contexts, more


def of_kind(kind: str) -> dict[str, str]:
    return {name: text.format(kind) for name, text in PARTED.items()}


def text_of(made: System) -> str:
    types, connections, contexts, more = made
    lines = ["schema = 1", more]
    lines += [f'[components.{name}]\ntype = "parts.py:{kind}"' for name, kind in types.items()]
    lines += [f'[[connections]]\nfrom = "{one}"\nto = "{two}"\n{options}' for one, two, options in connections]
    lines += [f"[contexts.{name}]\n{text}" for name, text in contexts.items()]
    return "\n".join(lines)


PLAIN = ("r.out", "m.inp", "")
SERVED = {"c": "Client", "s": "Server"}
IDLE = {"work": 'kind = "event"\nmembers = []'}
CASES: dict[str, tuple[System, System]] = {
    "a name goes to other ports": (
        system(TYPES, [("r.out", "m.inp", 'name = "k"')]),
        system(TYPES, [("r.out", "x.inp", 'name = "k"')]),
    ),
    "two names are swapped": (
        system(TYPES, [("r.out", "m.inp", 'name = "k"'), ("r.out", "x.inp", 'name = "l"')]),
        system(TYPES, [("r.out", "x.inp", 'name = "k"'), ("r.out", "m.inp", 'name = "l"')]),
    ),
    "another name": (system(TYPES, [PLAIN]), system(TYPES, [("r.out", "m.inp", 'name = "k"')])),
    "a port for one": (
        system({"r": "Ramp", "m": "One", "x": "Ramp"}, [PLAIN]),
        system({"r": "Ramp", "m": "One", "x": "Ramp"}, [("x.out", "m.inp", "")]),
    ),
    "a type for one": (
        system({"r": "Single", "m": "Meter", "x": "Meter"}, [PLAIN]),
        system(
            {"z": "Single", "m": "Meter", "x": "Meter"},
            [("z.out", "m.inp", "")],
            {"work": WORK["work"].replace('"r"', '"z"')},
        ),
    ),
    "an interface for one": (
        system(SERVED, [("c.adder", "s.adder", "")], IDLE),
        system({**SERVED, "t": "Server"}, [("c.adder", "t.adder", "")], IDLE),
    ),
    "into a thread": (system(TYPES, [PLAIN]), system(TYPES, [PLAIN], of_kind("thread"))),
    "into a real-time thread": (system(TYPES, [PLAIN]), system(TYPES, [PLAIN], of_kind("realtime"))),
    "a composite goes": (
        system(TYPES, [PLAIN, ("r.out", "x.inp", "")], {"work": WORK["work"].replace('"r", "m"', '"g"')}, SHOWN),
        system(TYPES, [PLAIN, ("r.out", "x.inp", "")]),
    ),
}


def files(case: str, folder: Path) -> list[Path]:
    """The two system files of a case."""
    (folder / "parts.py").write_text(PARTS)
    paths = [folder / "one.toml", folder / "two.toml"]
    for path, made in zip(paths, CASES[case], strict=True):
        path.write_text(text_of(made))
    return paths


@pytest.mark.parametrize("case", CASES)
def test_there_and_back(case: str, tmp_path: Path) -> None:
    async def main() -> None:
        async with Kernel() as kernel:
            paths = files(case, tmp_path)
            await build(kernel, load(paths[0]))
            await kernel.sleep(0.02)
            for path in (*reversed(paths), *reversed(paths)):
                target = wanted(load(path))
                same = {one.ports for one in wanted_of(kernel).connections} & {one.ports for one in target.connections}
                there = (
                    {one.profile.ports: one for one in kernel.connectors.values()} if case == "a composite goes" else {}
                )
                applied = await kernel.apply(target)
                assert (applied.done, applied.notes) == (True, ())
                assert texts(wanted_of(kernel), target) == []
                assert all(kernel.connectors[f"{a}-{b}"] is there[a, b] for a, b in same if there)
                before = {one: one.statistics.written for one in kernel.connectors.values()}
                await kernel.sleep(0.05)
                assert all(one.statistics.written > count for one, count in before.items())
                check_ledgers(kernel)
                assert not kernel.registry.parked

    asyncio.run(main())


@pytest.mark.parametrize("does_it_first", [False, True], ids=["not done", "done"])
@pytest.mark.parametrize("case", CASES)
def test_failed_at_each_step(case: str, does_it_first: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def main() -> None:
        async with Kernel() as kernel:
            one, two = files(case, tmp_path)
            await build(kernel, load(one))
            await kernel.sleep(0.02)
            objects, connectors = dict(kernel.components), dict(kernel.connectors)
            objects.pop("g", None)
            for number in range(len((await kernel.apply(wanted(load(two)), dry_run=True)).plan.steps)):
                with monkeypatch.context() as patch:
                    fail_in_step(patch, number, does_it_first=does_it_first)
                    FAILS.append(True)
                    with pytest.raises(ApplyError) as refused:
                        await kernel.apply(wanted(load(two)))
                    FAILS.clear()
                assert refused.value.not_undone == ()
                assert texts(wanted_of(kernel), wanted(load(one))) == []
                assert {name: one for name, one in kernel.components.items() if name != "g"} == objects
                assert dict(kernel.connectors) == connectors
                check_ledgers(kernel)

    asyncio.run(main())


def test_what_a_real_time_thread_refuses_needs_no_undoing(tmp_path: Path) -> None:
    async def main() -> None:
        async with Kernel() as kernel:
            path = files("into a real-time thread", tmp_path)[1]
            await build(kernel, load(path))
            other = tmp_path / "other.toml"
            other.write_text(path.read_text().replace('to = "m.inp"', 'to = "m.inp"\nsubscription = "new"'))
            with pytest.raises(ApplyError, match="a real-time thread is at it") as refused:
                await kernel.apply(wanted(load(other)))
            assert refused.value.not_undone == ()
            assert texts(wanted_of(kernel), wanted(load(path))) == []

    asyncio.run(main())
