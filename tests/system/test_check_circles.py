"""A circle of components that run on events has one finding: it never rests, or it never begins."""

from __future__ import annotations

from pathlib import Path

import pytest

from aiorts import Component, EventContext, InPort, Kernel, OutPort
from aiorts.system import Finding, build, check_running, load
from aiorts.testing import simulate, simulated
from aiorts.types import TimedLong
from system.test_check import CYCLE, Write, changed, found

RING = "one.output → two.input → two.output → one.input → one.output"
KINDS = """
class Starts(Middle):
    def on_activated(self):
        self.first()
    def first(self):
        self.output.write_nowait(TimedLong(0, 1))

class Says(Middle):
    def on_activated(self):
        self.log.info("ready")

class Passes(Middle):
    def on_activated(self):
        pass

class Paced(Starts):
    async def on_execute(self):
        await self.kernel.sleep(0.01)
        self.output.write_nowait(TimedLong(0, 1))
"""


@pytest.fixture
def kinds(write: Write, tmp_path: Path) -> Write:
    """`write`, with a component that starts a circle and one that does not."""

    def written(text: str) -> Path:
        path = write(text)
        (tmp_path / "parts.py").write_text((tmp_path / "parts.py").read_text() + KINDS)
        return path

    return written


def started(name: str, kind: str = "Starts", text: str = CYCLE) -> str:
    """The circle with a component of another type."""
    return changed(
        f'[components.{name}]\ntype = "parts.py:Middle"', f'[components.{name}]\ntype = "parts.py:{kind}"', text
    )


def circles(path: Path) -> list[Finding]:
    """What is said of circles."""
    return [one for one in found(path) if one.code in ("N-CIRCLE", "W-LOOP", "E-COMPONENT", "E-PLUGIN")]


@pytest.mark.fault("B11")
def test_a_circle_on_events_alone_that_begins_is_a_warning_with_its_path(kinds: Write) -> None:
    (one,) = circles(kinds(started("one")))
    assert (one.severity, one.code, one.line) == ("warning", "W-LOOP", 9)
    assert one.cause.startswith(f"{RING}: all run on events, so that one sample keeps this cycle busy forever")
    himself = changed('to = "two.input"', 'to = "one.input"', started("one", text=CYCLE))
    assert circles(kinds(himself))[0].cause.startswith("one.output → one.input → one.output: ")


@pytest.mark.fault("B11")
@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('kind = "event"\nmembers = ["two"]', 'kind = "periodic"\nrate = 10.0\nmembers = ["two"]'),
        ('members = ["two"]', 'members = ["two"]\n[contexts.c]\nkind = "periodic"\nrate = 1.0\nmembers = ["one"]'),
        ('to = "one.input"', 'to = "one.input"\ndataflow = "pull"'),
        ('to = "one.input"', 'to = "one.input"\nsubscription = "periodic"\npush_rate = 10.0'),
    ],
)
def test_a_circle_that_something_paces_never_runs_hot(kinds: Write, old: str, new: str) -> None:
    codes = [one.code for one in found(kinds(changed(old, new, started("one"))), "warning", "error")]
    assert codes == (["W-UNFED"] if "pull" in new else [])


def test_a_circle_that_waits_for_itself_is_noted_once(write: Write) -> None:
    (one,) = found(write(CYCLE))
    assert (one.severity, one.code, one.where, one.line) == ("note", "N-CIRCLE", "connections[2]", 9)
    assert one.cause == f"{RING}: each waits for a sample of the one before, and none begins"
    assert one.remedy.startswith("write the first one in on_activated, to a connection with keep_last = true")


def test_a_hook_that_writes_nothing_does_not_start_a_circle(kinds: Write) -> None:
    (one,) = circles(kinds(started("two", "Says")))
    assert one.cause.endswith("of the one before, and none begins, unless on_activated of two writes first")
    (one,) = circles(kinds(started("one", "Says", started("two", "Says"))))
    assert one.cause.endswith("and none begins, unless on_activated of one or two writes first")
    (one,) = circles(kinds(started("two", "Passes")))
    assert one.cause.endswith("of the one before, and none begins")


@pytest.mark.parametrize("kind", ["Starts", "Paced"])
def test_a_circle_with_a_member_that_sleeps_never_runs_hot(kinds: Write, kind: str) -> None:
    assert [one.code for one in circles(kinds(started("one", kind)))] == (["W-LOOP"] if kind == "Starts" else [])


def test_a_circle_does_not_go_through_a_port_that_is_not_there(kinds: Write) -> None:
    path = kinds(changed('to = "one.input"', 'to = "one.inputt"', started("one")))
    assert [one.code for one in found(path) if one.code == "W-LOOP"] == []
    assert [one.code for one in found(path, "error")] != []


@pytest.mark.parametrize("together", [False, True])
@pytest.mark.parametrize(
    ("name", "kept", "begins"), [("one", "", True), ("two", "", False), ("two", "keep_last = true", True)]
)
def test_what_comes_before_its_reader_is_active_does_not_start_a_circle(
    kinds: Write, together: bool, name: str, kept: str, begins: bool
) -> None:
    text = changed('to = "one.input"', f'to = "one.input"\n{kept}', started(name))
    if together:
        text = text[: text.index("[contexts.a]")] + '[contexts.a]\nkind = "event"\nmembers = ["one", "two"]\n'
    path = kinds(text)
    (one,) = circles(path)
    lost = (
        f"{RING}: each waits for a sample of the one before, and what on_activated of two writes is lost, because one "
    )
    assert (one.code, one.cause.startswith(lost)) == (("W-LOOP", False) if begins else ("N-CIRCLE", True))

    async def comes_along() -> bool:
        async with Kernel() as kernel:
            await build(kernel, load(path))
            for _ in range(9):
                await kernel.sleep(0)
            return all(wire.statistics.delivered for wire in kernel.connectors.values())

    assert simulate(comes_along()) is begins


OUTSIDE = """\
[components.source]
type = "parts.py:Source"
[[connections]]
from = "source.out"
to = "one.input"
"""
RUNS = '[contexts.c]\nkind = "periodic"\nrate = 1.0\nmembers = ["source"]\n'


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('kind = "event"', 'kind = "event"\nevery = 1.0'),
        ('kind = "event"', 'kind = "periodic"\nrate = 1.0'),
        ("[[connections]]", f"{OUTSIDE}{RUNS}[[connections]]"),
    ],
    ids=["every", "rate", "a source"],
)
def test_a_circle_that_something_starts_is_not_noted(write: Write, old: str, new: str) -> None:
    assert [one for one in circles(write(changed(old, new, CYCLE))) if one.code != "W-LOOP"] == []


def test_a_source_that_never_runs_starts_no_circle(write: Write) -> None:
    assert [one.code for one in circles(write(changed("[[connections]]", f"{OUTSIDE}[[connections]]", CYCLE)))] == [
        "N-CIRCLE"
    ]


class Passes(Component):
    """Passes on what it gets."""

    input = InPort(TimedLong)
    output = OutPort(TimedLong)

    async def on_execute(self) -> None:
        for sample in self.input.drain():
            await self.sleep(1.0)
            self.output.write_nowait(sample)


@simulated
async def test_of_a_kernel_a_circle_is_noted_until_a_sample_came_along_it() -> None:
    async with Kernel() as kernel:
        one, two = await kernel.create(Passes, "one"), await kernel.create(Passes, "two")
        await kernel.connect(one.output, two.input)
        await kernel.connect(two.output, one.input)
        context = await kernel.start(EventContext(name="both"), one, two)
        one.output.write_nowait(TimedLong(0, 1))  # its reader is not active: it is lost
        assert noted(kernel) == []
        await context.activate(one, two)
        (said,) = noted(kernel)
        assert said.cause == f"{RING}: all run on events, and no sample came along this circle so far"
        one.output.write_nowait(TimedLong(0, 1))
        await kernel.sleep(0.5)
        assert noted(kernel) == []


def noted(kernel: Kernel) -> list[Finding]:
    """What is said of circles that wait."""
    return [one for one in check_running(kernel.profile(), "unit/") if one.code == "N-CIRCLE"]
