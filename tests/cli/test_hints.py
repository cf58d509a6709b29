"""What a run says by itself though nothing failed, and that it ends soon where a hook takes long."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from aiorts.cli.console.codes import CODES
from aiorts.errors import SLOW_READER
from run_parts import aiorts, here, limited

PARTS = '''
import time
from aiorts import Component, InPort, OutPort, Param
from aiorts.types import TimedLong

class Block(Component):
    out = OutPort(TimedLong)
    def on_execute(self):
        print("cycle", flush=True)
        time.sleep(0.3)

class Newest(Component):
    """Takes the newest alone."""
    raw = InPort(TimedLong)
    out = OutPort(TimedLong)
    async def on_execute(self):
        if (sample := self.raw.latest) is not None:
            await self.out.write(sample)

class Every(Newest):
    """Takes each."""
    async def on_execute(self):
        for sample in self.raw.drain():
            await self.out.write(sample)

class Starts(Every):
    async def on_activated(self):
        await self.out.write(TimedLong(0, 1))

class Burst(Component):
    """Sends a hundred at once."""
    out = OutPort(TimedLong)
    async def on_execute(self):
        for number in range(100):
            await self.out.write(TimedLong(0, number))
        self.finish()

class Forgets(Component):
    out = OutPort(TimedLong)
    def on_execute(self):
        self.out.write(TimedLong(0, 1))
        self.finish()

class Sleepy(Component):
    out = OutPort(TimedLong)
    def on_execute(self):
        self.sleep(0.1)
        self.finish()

class Never(Newest):
    """Takes none."""
    def on_execute(self):
        pass
'''
SYSTEM = """
schema = 1
components.burst.type = "parts.py:Burst"
components.reader.type = "parts.py:{reader}"
connections = [{{ from = "burst.out", to = "reader.raw", length = 200{option} }}]
[contexts.writes]
kind = "periodic"
rate = 10
members = ["burst"]
[contexts.reads]
kind = "{kind}"
members = ["reader"]
"""
NO_CONTEXT = 'schema = 1\ncomponents.burst.type = "parts.py:Burst"\n'
NONE_CONNECTED = """
schema = 1
components.burst.type = "parts.py:Burst"
components.newest.type = "parts.py:Newest"
[contexts.loop]
kind = "periodic"
rate = 50
members = ["burst", "newest"]
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "parts.py").write_text(PARTS)
    return tmp_path


@pytest.mark.slow(kept_by="test_a_transformer_that_nothing_is_connected_to_is_not_waited_for")
@pytest.mark.parametrize("way", ["--for", "SIGINT", "SIGTERM"])
def test_the_end_costs_few_cycles_where_each_takes_longer_than_its_period(folder: Path, way: str) -> None:
    """It took 20 cycles more: each turn of the loop on the way to the end ran one of them."""
    more = ("--for", "1") if way == "--for" else ()
    process = subprocess.Popen(
        [sys.executable, "-m", "aiorts", "run", "parts.py:Block", "--rate", "50", *more],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=folder,
    )
    with limited(process):
        assert process.stdout is not None
        assert process.stdout.readline() == "cycle\n"
        if not more:
            assert process.stdout.readline() == "cycle\n"
            process.send_signal(getattr(signal, way))
        asked = time.monotonic()
        said, _ = process.communicate(timeout=30)
    # One that runs, one that begins, one for a slow machine; in 1 s four begin.
    assert said.count("cycle") <= (6 if more else 3)
    assert process.returncode == (0 if more else 128 + getattr(signal, way))
    assert time.monotonic() - asked < 10.0


def run_system(folder: Path, reader: str, kind: str, *more: str, option: str = "") -> subprocess.CompletedProcess[str]:
    context = f'{kind}"\nrate = 20.0\n#' if kind == "periodic" else kind
    (folder / "system.toml").write_text(SYSTEM.format(reader=reader, kind=context, option=option))
    return here(folder, "run", "system.toml", "--simulate", *more)


@pytest.mark.parametrize(
    ("reader", "kind", "option", "more", "told"),
    [
        ("Newest", "event", "", (), True),
        ("Every", "event", "", (), False),
        ("Every", "event", "", ("-v",), False),
        ("Newest", "event", ', subscription = "new", push = "new"', (), False),
        ("Newest", "event", ', subscription = "new", push = "new"', ("-v",), False),
        ("Newest", "periodic", "", (), False),
        ("Newest", "periodic", "", ("-v",), True),
    ],
)
def test_samples_that_a_reader_passed_over_unawares_are_told(
    folder: Path, reader: str, kind: str, option: str, more: tuple[str, ...], told: bool
) -> None:
    done = run_system(folder, reader, kind, *more, option=option)
    assert done.returncode == 0
    lines = [line for line in done.stderr.splitlines() if "W-DROPPED" in line]
    why = ".latest takes the newest alone; drain() or read() takes every one"
    said = f"aiorts: W-DROPPED: reader.raw: 99 of 100 samples superseded: {why}"
    assert lines == ([said] if told else [])


@pytest.mark.parametrize(("length", "more", "told"), [(200, (), True), (200, ("-v",), True), (8, (), False)])
def test_samples_that_wait_when_the_run_ends_are_told(
    folder: Path, length: int, more: tuple[str, ...], told: bool
) -> None:
    text = SYSTEM.replace("length = 200", f"length = {length}").format(reader="Never", kind="event", option="")
    (folder / "system.toml").write_text(text)
    done = here(folder, "run", "system.toml", "--simulate", "--for", "0.5", *more)
    assert done.returncode == 0
    said = "aiorts: W-DROPPED: reader.raw: 100 of 100 samples inactive: unread when the reader ended, or written while "
    assert (said in done.stderr) is told


def test_what_helps_a_slow_reader_is_the_same_in_the_run_and_in_the_explanation(folder: Path) -> None:
    """`aiorts check` and `aiorts bench push` have this text, too; see tests/flexi and tests/bench."""
    text = SYSTEM.replace("length = 200", "length = 8")
    (folder / "system.toml").write_text(text.format(reader="Every", kind="event", option=""))
    done = here(folder, "run", "system.toml", "--simulate", "-v")
    (line,) = [line for line in done.stderr.splitlines() if "W-DROPPED" in line]
    assert line.endswith(f"samples overwritten: the reader is slower than the writer; {SLOW_READER}")
    assert CODES["W-DROPPED"].remedy == f"{SLOW_READER.capitalize()}."


def test_the_warning_of_lost_samples_is_shown_whole_however_long_the_names_are(folder: Path) -> None:
    burst, reader = f"burst_{'a' * 58}", f"reader_{'b' * 57}"
    text = SYSTEM.replace(", length = 200{option} ", "").replace("burst", burst).replace("reader.raw", f"{reader}.raw")
    text = text.replace('"reader"', f'"{reader}"').replace("components.reader", f"components.{reader}")
    (folder / "system.toml").write_text(text.format(reader="Every", kind="event"))
    done = here(folder, "run", "system.toml", "--simulate")
    (line,) = [line for line in done.stderr.splitlines() if "lost so far" in line]
    assert line.startswith(f"aiorts: warning: {burst}.out -> {reader}.raw: ")
    assert line.partition(" lost so far: ")[2] == (
        "overwritten, the reader is slower than the writer; further losses are summarised here, all are counted in "
        "connector.statistics; "
        f"{SLOW_READER}"
    )


LOOPED = """
schema = 1
components.first.type = "parts.py:Every"
components.second.type = "parts.py:Starts"
connections = [
    { from = "first.out", to = "second.raw", length = 4 },
    { from = "second.out", to = "first.raw", length = 4 },
]
contexts.reacts = { kind = "event", members = ["first"] }
contexts.paces = { kind = "periodic", rate = 20.0, members = ["second"] }
"""


@pytest.mark.parametrize(("option", "told"), [("", 1), (", keep_last = true", 0)])
def test_a_command_that_came_before_its_reader_was_active_is_told_with_the_cure(
    folder: Path, option: str, told: int
) -> None:
    """The system stood still without a word: the count in `aiorts cat` alone had it."""
    (folder / "system.toml").write_text(LOOPED.replace('"first.raw", length = 4', f'"first.raw", length = 4{option}'))
    done = here(folder, "run", "system.toml", "--simulate", "--for", "0.1")
    said = (
        "aiorts: warning: W-INACTIVE: second.out -> first.raw: the first sample was dropped, first was not active yet: "
        'connect with keep_last = true, or have the writer start later (start.after = "first active")'
    )
    lines = [line for line in done.stderr.splitlines() if "W-INACTIVE" in line]
    assert [line.partition(";")[0] for line in lines] == [said] * told


@pytest.mark.slow(kept_by="test_samples_that_a_reader_passed_over_unawares_are_told")
@pytest.mark.parametrize(("name", "told"), [("newest", True), ("every", False)])
def test_a_filter_tells_of_every_sample_it_passed_over(folder: Path, name: str, told: bool) -> None:
    numbers = "".join(f"{number}\n" for number in range(100))
    done = subprocess.run(
        [sys.executable, "-m", "aiorts", "--plugins", ".", name],
        input=numbers,
        capture_output=True,
        text=True,
        timeout=30,
        check=False,
        cwd=folder,
    )
    assert done.returncode == 0
    assert done.stderr.startswith(f"aiorts: W-DROPPED: {name}0.raw: ") is told
    assert done.stderr.count("\n") == int(told)
    assert (done.stdout.count("\n") == 100) is not told


@pytest.mark.slow(kept_by="testing/test_rig.py::test_an_await_that_is_missing_is_raised_with_hook_line_and_remedy")
@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("Forgets", "parts.py:41: OutPort.write was never awaited and did nothing; use write_nowait, or async def"),
        ("Sleepy", "parts.py:47: Component.sleep was never awaited and did nothing; use async def and await"),
    ],
)
def test_a_missing_await_is_told_with_component_line_and_remedy(folder: Path, name: str, said: str) -> None:
    done = aiorts(folder, "run", f"parts.py:{name}", "--log-level", "error")
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"aiorts: E-AWAIT: {name.lower()}.on_execute: {said}")


@pytest.mark.slow(kept_by="test_a_system_in_which_nothing_runs_is_an_error")
def test_a_component_alone_without_data_says_how_it_gets_some(folder: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "aiorts", "run", "parts.py:Newest"],
        stdin=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        cwd=folder,
    )
    with limited(process):
        assert process.stderr is not None
        line = process.stderr.readline()
        process.terminate()
        process.communicate(timeout=30)
    hint = "in-port raw has no connection, nothing will come; feed it JSON lines: ... | aiorts run parts.py:Newest\n"
    assert line == f"aiorts: W-UNFED: newest: {hint}"


@pytest.mark.parametrize("arguments", [("run",), ("run", "--simulate"), ("check",)])
def test_a_system_in_which_nothing_runs_is_an_error(folder: Path, arguments: tuple[str, ...]) -> None:
    (folder / "system.toml").write_text(NO_CONTEXT)
    done = here(folder, *arguments, "system.toml")
    assert done.returncode == 2
    assert "no context runs anything; add [contexts.NAME] with kind and members\n" in done.stdout + done.stderr
    assert "W-UNUSED" not in done.stdout


def test_a_transformer_that_nothing_is_connected_to_is_not_waited_for(folder: Path) -> None:
    (folder / "system.toml").write_text(NONE_CONNECTED)
    done = here(folder, "run", "system.toml", "--simulate")
    assert (done.returncode, done.stderr) == (0, "")
