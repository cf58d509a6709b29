"""`aiorts top` on a terminal: what it shows, its keys, and the terminal is what it was on every way out."""

from __future__ import annotations

import asyncio
import fcntl
import json
import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

import control_parts
from aiorts import Kernel
from aiorts.cli.app import run_command
from aiorts.cli.commands.live.edges import Edge
from aiorts.cli.commands.live.measure.readings import counters_in, rate_of
from aiorts.cli.commands.live.measure.screen import keys_in
from aiorts.cli.commands.live.measure.table import KINDS, View, fitted, screen_of, tables, text_of
from aiorts.model.timing import ConnectorCounters
from aiorts.sessions import Client
from control_parts import WAIT, Counter, Reader, controlled, entry_of, running

COLUMNS, LINES = 100, 20


def counters(at_ns: int, written: int, count: int = 3) -> Mapping[str, Any]:
    """Connectors a0 -> b0, a1 -> b1 ...: each has ten times the samples of the one before; the second loses some."""
    return counters_in({
        "at_ns": at_ns,
        "time_ns": at_ns,
        "simulated": False,
        "connectors": {
            f"w{n}": [written * 10**n, 0, n, {"overwritten": 5, "expired": 1} if n == 1 else {}, n % 2]
            for n in range(count)
        },
        "timed": {"w1": {"latency": [10, 1000, 2000, 3000]}},
        "contexts": {
            "loop": {
                "rate": 100.0, "running": True, "cycles": written, "skipped": 0, "overruns": 2,
                "lateness_p50_ns": 1000, "lateness_p99_ns": 2000, "lateness_max_ns": 3000,
            }
        },
        "components": {
            "a0": {"states": {"loop": "active"}, "failed": False},
            "b0": {"states": {"loop": "error"}, "failed": True, "calls": {"arm": {"calls": 7, "failures": 1}}},
        },
    })  # fmt: skip


EDGES = {f"w{n}": Edge(f"w{n}", f"a{n}.out", f"b{n}.in") for n in range(1000)}


def test_the_tables_have_rates_drops_by_reason_lateness_and_states() -> None:
    found = tables(counters(2 * 10**9, 200), counters(10**9, 100), EDGES)
    assert text_of(found, View()) == [
        "CONNECTOR        RATE/S  BUFFERED  DROPPED/S  LATENCY   P99  DROPPED",
        "a0.out -> b0.in   100.0         0",
        "a1.out -> b1.in  1000.0         1        0.0     1 us  2 us  expired 1, overwritten 5",
        "a2.out -> b2.in   10000         2",
        "",
        "CONTEXT  RATE/S   OF  LATE P50   P99   MAX  OVERRUNS  SKIPPED",
        "loop      100.0  100      1 us  2 us  3 us         2",
        "",
        "COMPONENT  STATE   CALLS",
        "a0         active",
        "b0         error   arm 7 (1 failed)",
    ]


@pytest.mark.parametrize(
    ("view", "names"),
    [
        (View(sort="rate"), ["a2", "a1", "a0"]),
        (View(sort="rate", reverse=True), ["a0", "a1", "a2"]),
        (View(sort="dropped"), ["a1", "a0", "a2"]),
        (View(sort="buffered"), ["a2", "a1", "a0"]),
        (View(sort="late"), ["a1", "a0", "a2"]),
        (View(text="B1"), ["a1"]),
        (View(reverse=True), ["a2", "a1", "a0"]),
    ],
)
def test_rows_are_sorted_and_filtered(view: View, names: list[str]) -> None:
    found = tables(counters(2 * 10**9, 200), counters(10**9, 100), EDGES)
    assert [row.name.partition(".")[0] for row in view.rows(found["connectors"])] == names


@pytest.mark.parametrize("height", [3, 5, 12, 24, 200])
@pytest.mark.parametrize("kinds", [KINDS, ("connectors",), ("components",)])
def test_a_screen_has_its_lines_and_columns_whatever_there_is(height: int, kinds: tuple[str, ...]) -> None:
    found = tables(counters(2 * 10**9, 200, 100), None, EDGES)
    for first in (0, 50, 10**6):
        lines = screen_of(found, View(kinds, first=first), "head", "foot", 40, height)
        assert len(lines) == height
        assert (lines[0], lines[-1]) == ("head", "foot")
        assert max(map(len, lines)) <= 40


def test_a_long_table_says_which_part_it_shows_and_the_short_ones_are_whole() -> None:
    found = tables(counters(2 * 10**9, 200, 100), None, EDGES)
    lines = screen_of(found, View(first=10), "head", "foot", 120, 24)
    assert lines[1].endswith("11-26 of 100")
    assert lines[2].startswith("a18.out")
    assert lines[-2].startswith("b0         error")


def test_a_narrow_terminal_shows_the_numbers_and_cuts_the_names() -> None:
    long = {name: Edge(name, f"{edge.out}_of_a_long_name", edge.in_) for name, edge in EDGES.items()}
    found = tables(counters(2 * 10**9, 200), counters(10**9, 100), long)
    assert [line.rstrip() for line in screen_of(found, View(KINDS[:2]), "head", "foot", 60, 24)[1:6]] == [
        "CONNECTOR         RATE/S  BUFFERED  DROPPED/S  LATENCY   P99",
        "a0.out_of_a_lo..   100.0         0",
        "a1.out_of_a_lo..  1000.0         1        0.0     1 us  2 us",
        "a2.out_of_a_lo..   10000         2",
        "CONTEXT  RATE/S   OF  LATE P50   P99   MAX  OVERRUNS",
    ]


def test_a_line_is_cut_by_columns_not_characters() -> None:
    assert (fitted("abcdef", 3), fitted("あいう", 5), fitted("é", 1)) == ("abc", "あい", "é")


def test_keys_are_characters_and_names() -> None:
    assert keys_in(b"q\x1b[A\x1b[5~\x7f\r/") == ["q", "up", "page up", "back", "enter", "/"]
    assert keys_in("é\x1b[99;5X\x1b".encode() + b"\xff\x01") == ["é", "escape"]


async def prints(name: str, *words: str) -> int:
    return await asyncio.to_thread(run_command, ["top", name, "--interval", "0.05", *words])


@pytest.mark.anyio
async def test_without_a_terminal_it_prints(capsys: pytest.CaptureFixture[str]) -> None:
    async with controlled("plain"):
        assert await prints("plain", "--once", "--json", "--only", "connectors") == 0
        (found,) = map(json.loads, capsys.readouterr().out.splitlines())
        assert found["kernel"] == "plain"
        assert found["connectors"][0]["from"] == "counter0.out"
        assert found["connectors"][0]["rate"] > 0
        assert found["connectors"][0].keys() >= set(ConnectorCounters._fields)
        assert "contexts" not in found
        assert await prints("plain", "--count", "2") == 0
    assert capsys.readouterr().out.count("counter0.out -> reader0.in") == 2


@pytest.mark.slow(kept_by="test_without_a_terminal_it_prints")
@pytest.mark.anyio
async def test_connectors_that_come_while_it_runs_have_their_ports(capsys: pytest.CaptureFixture[str]) -> None:
    async with controlled("come") as kernel:
        shown = asyncio.ensure_future(prints("come", "--count", "8", "--json"))
        await kernel.sleep(0.1)
        other = await kernel.create(Counter, "other")
        await kernel.connect(other.out, kernel.components["reader0"].ports["in"])
        assert await shown == 0
    last = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert [one["from"] for one in last["connectors"]] == ["counter0.out", "other.out"]


# -- on a terminal -----------------------------------------------------------------------------------------------------


class Top:
    """`aiorts top` in a process of its own, which has a terminal of its own."""

    def __init__(self, *words: str) -> None:
        self.ours, self.theirs = pty.openpty()
        fcntl.ioctl(self.theirs, termios.TIOCSWINSZ, struct.pack("HHHH", LINES, COLUMNS, 0, 0))
        self.before = termios.tcgetattr(self.theirs)
        self.raw = ""
        self.process = subprocess.Popen(
            [sys.executable, "-m", "aiorts", "top", "--interval", "0.1", *words],
            env={**os.environ, "TERM": "xterm", "NO_COLOR": "1"},
            preexec_fn=lambda: os.login_tty(self.theirs),  # its own, as Ctrl-C needs it
        )

    def __enter__(self) -> Top:
        return self

    def __exit__(self, *error: object) -> None:
        self.process.kill()
        self.process.wait(WAIT)
        for end in (self.ours, self.theirs):
            if end >= 0:
                os.close(end)

    def read(self) -> None:
        if select.select([self.ours], [], [], 0.05)[0]:
            self.raw += os.read(self.ours, 1 << 16).decode()

    @property
    def screen(self) -> str:
        """The last whole picture."""
        parts = self.raw.split("\x1b[H")
        whole = [part for part in parts if part.endswith("\x1b[J")]
        return re.sub(r"\x1b\[\w+|\r", "", whole[-1]) if whole else ""

    def until(self, condition: Callable[[str], Any]) -> str:
        """Read until the picture is so."""
        end = time.monotonic() + WAIT
        while not condition(self.screen):
            assert time.monotonic() < end, self.raw[-3000:]
            assert self.process.poll() is None, self.raw[-3000:]
            self.read()
        return self.screen

    def type(self, keys: str) -> None:
        os.write(self.ours, keys.encode())

    def end(self) -> int:
        """The exit status, once it has ended, and the terminal is what it was."""
        end = time.monotonic() + WAIT
        while self.process.poll() is None:
            assert time.monotonic() < end, self.raw[-3000:]
            self.read()
        self.read()
        assert termios.tcgetattr(self.theirs) == self.before
        assert self.raw.count("\x1b[?1049h") == self.raw.count("\x1b[?1049l") >= 1
        assert self.raw.rindex("\x1b[?25h") > self.raw.rindex("\x1b[?25l")
        assert "Traceback" not in self.raw
        return self.process.returncode


async def on_terminal(use: Callable[[Top], None], *words: str) -> None:
    def work() -> None:
        with Top(*words) as top:
            use(top)

    await asyncio.to_thread(work)


@pytest.mark.slow(kept_by="first")
@pytest.mark.anyio
async def test_it_fills_the_terminal_and_hears_its_keys() -> None:
    def use(top: Top) -> None:
        lines = top.until(lambda text: re.search(r"in +\d+\.\d ", text)).split("\n")
        assert len(lines) == LINES
        assert lines[0].startswith("keys  ")
        assert "CONTEXT" in top.screen
        top.type("1")
        top.until(lambda text: "CONTEXT" not in text)
        top.type("/x")
        top.until(lambda text: "counter0.out" not in text and "filter: x_" in text)
        top.type("\x7fREAD\r")
        top.until(lambda text: "filter READ" in text and "counter0.out" in text)
        top.type("\x1b")
        top.until(lambda text: "filter READ" not in text)
        top.type("ri0")
        top.until(lambda text: "by rate, turned round" in text and "CONTEXT" in text)
        top.type(" ")
        top.until(lambda text: "held still" in text)
        fcntl.ioctl(top.theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 8, 60, 0, 0))
        top.until(lambda text: len(text.split("\n")) == 8)
        top.type("q")
        assert top.end() == 0

    async with controlled("keys"):
        await on_terminal(use)


@pytest.mark.slow(kept_by="test_it_fills_the_terminal_and_hears_its_keys")
@pytest.mark.anyio
@pytest.mark.parametrize(
    ("how", "status"), [("\x03", 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129), (signal.SIGINT, 130)]
)
async def test_the_terminal_is_what_it_was_after_a_signal(how: Any, status: int) -> None:
    def use(top: Top) -> None:
        top.until(lambda text: "counter0" in text)
        top.type(how) if isinstance(how, str) else top.process.send_signal(how)
        assert top.end() == status

    async with controlled("signal"):
        await on_terminal(use)


@pytest.mark.slow(kept_by="test_keys_are_characters_and_names")
@pytest.mark.anyio
async def test_a_terminal_that_goes_away_ends_it() -> None:
    def use(top: Top) -> None:
        top.until(lambda text: "counter0" in text)
        for end in (top.theirs, top.ours):
            os.close(end)
        top.ours = top.theirs = -1
        assert top.process.wait(WAIT) == 129

    async with controlled("gone"):
        await on_terminal(use)


@pytest.mark.slow(kept_by="test_without_a_terminal_it_prints")
@pytest.mark.anyio
async def test_a_kernel_that_ends_gets_one_line() -> None:
    kernel = await Kernel(services={"control": {"name": "ends"}}).open()
    await kernel.create(Reader, "reader0")
    loop = asyncio.get_running_loop()

    def use(top: Top) -> None:
        top.until(lambda text: "reader0" in text)
        asyncio.run_coroutine_threadsafe(kernel.aclose(), loop).result(WAIT)
        assert top.end() == 0
        assert top.raw.endswith("\x1b[?1049laiorts: ends: has ended\r\n")

    await on_terminal(use)


@pytest.mark.slow(kept_by="test_keys_are_characters_and_names")
@pytest.mark.anyio
async def test_stopped_with_ctrl_z_the_shell_has_its_terminal() -> None:
    def use(top: Top) -> None:
        top.until(lambda text: "counter0" in text)
        top.process.send_signal(signal.SIGTSTP)
        end = time.monotonic() + WAIT
        while "\x1b[?1049l" not in top.raw or termios.tcgetattr(top.theirs) != top.before:
            assert time.monotonic() < end
            top.read()
        os.waitpid(top.process.pid, os.WUNTRACED)
        top.raw = top.raw.replace("\x1b[H", "")
        top.process.send_signal(signal.SIGCONT)
        top.until(lambda text: "counter0" in text)
        top.type("q")
        assert top.end() == 0

    async with controlled("stopped"):
        await on_terminal(use)


# -- beside runs in processes of their own -----------------------------------------------------------------------------

LOOP = """schema = 1
[components.counter0]
type = "control_parts:Counter"
[components.reader0]
type = "control_parts:Reader"
[[connections]]
from = "counter0.out"
to = "reader0.in"
[contexts.loop]
kind = "periodic"
rate = 1000.0
members = ["counter0", "reader0"]
"""


@pytest.mark.slow(kept_by="control/test_measure.py::test_hz_shows_the_rate_by_the_counter")
def test_the_rate_is_that_of_the_edge(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", str(Path(control_parts.__file__).parent))
    (tmp_path / "loop.toml").write_text(LOOP.replace("1000.0", "100.0"))  # a rate that a busy machine holds too
    with running("edge", str(tmp_path / "loop.toml")):
        words = [sys.executable, "-m", "aiorts", "hz", "counter0.out", "--interval", "0.2", "--count", "5", "--json"]
        with Client.open(entry_of("edge"), timeout=WAIT) as client:
            before = counters_in(client.call("statistics"))
            done = subprocess.run(words, capture_output=True, text=True, timeout=WAIT, check=True)
            after = counters_in(client.call("statistics"))
    name = "counter0.out-reader0.in"
    truth = rate_of(after, before, name)
    assert json.loads(done.stdout.splitlines()[-1])["rate"] == pytest.approx(truth, rel=0.2)


@pytest.mark.slow(
    kept_by="control/test_measure.py::test_in_simulated_time_streams_go_by_real_time_and_look_between_instants"
)
def test_a_simulated_run_with_top_beside_it_records_the_same_bytes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONPATH", str(Path(control_parts.__file__).parent))
    (tmp_path / "loop.toml").write_text(LOOP)
    simulated = ("--simulate", "--for", "20", "--record")
    words = [sys.executable, "-m", "aiorts", "top", "--interval", "0.05", "--json"]
    with running("beside", str(tmp_path / "loop.toml"), *simulated, str(tmp_path / "beside.mcap")) as process:
        top = subprocess.run(words, capture_output=True, text=True, timeout=WAIT, check=False)
        process.wait(WAIT)
    with running("alone", str(tmp_path / "loop.toml"), *simulated, str(tmp_path / "alone.mcap")) as process:
        process.wait(WAIT)
    assert (tmp_path / "beside.mcap").read_bytes() == (tmp_path / "alone.mcap").read_bytes()
    assert top.stdout.count("\n") > 0
    assert top.stderr == "aiorts: beside: has ended\n"


@pytest.mark.slow(kept_by="control/test_measure.py::test_delay_says_that_it_measures_and_puts_it_back")
@pytest.mark.anyio
async def test_a_delay_that_is_killed_leaves_nothing_measured() -> None:
    async with controlled("killed") as kernel:
        connector = next(iter(kernel.connectors.values()))
        words = [sys.executable, "-m", "aiorts", "delay", "reader0.in"]
        process = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            async with asyncio.timeout(WAIT):
                while not connector.profile.measure:
                    await kernel.sleep(0.01)
            process.kill()
            async with asyncio.timeout(WAIT):
                while connector.profile.measure:
                    await kernel.sleep(0.01)
        finally:
            process.kill()
            process.wait(WAIT)


@pytest.mark.slow(kept_by="test_without_a_terminal_it_prints")
@pytest.mark.anyio
@pytest.mark.parametrize("command", ["top", "hz counter0.out"])
async def test_a_reader_that_has_seen_enough_ends_it_without_a_word(command: str) -> None:
    def work() -> tuple[int, str]:
        words = [sys.executable, "-m", "aiorts", *command.split(), "--interval", "0.05"]
        with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            assert process.stderr is not None
            assert process.stdout.readline()
            process.stdout.close()
            told = process.stderr.read()
            return process.wait(WAIT), told

    async with controlled("enough"):
        assert await asyncio.to_thread(work) == (141, "")
