"""`aiorts run` as a user meets it: how it ends, what it says, and that no mistake of theirs gives a traceback."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from aiorts.cli.app import run_command
from aiorts.cli.console.report import LONGEST
from run_parts import here, limited

if TYPE_CHECKING:
    from collections.abc import Callable

ROOT = Path(__file__).parents[2]
COMPONENTS = '''
import os, sys, time
from aiorts import Component, InPort, OutPort, Param
from aiorts.types import TimedLong

class Counter(Component):
    """Sends `count` numbers and finishes."""
    out = OutPort(TimedLong)
    count = Param(5)
    fails = Param(0)
    failed = False
    n = 0
    async def on_execute(self):
        if self.fails and self.n == self.fails - 1 and not Counter.failed:
            Counter.failed = True
            raise ValueError("no such luck")
        await self.out.write(TimedLong(0, self.n))
        self.n += 1
        if self.n == self.count:
            self.finish()

class Total(Component):
    """Adds up what comes."""
    numbers = InPort(TimedLong)
    total = 0
    async def on_execute(self):
        for sample in self.numbers.drain():
            await self.sleep(0.02)
            self.total += sample.data
    def on_deactivated(self):
        print("total", self.total, flush=True)

class Ready(Component):
    """Says that it runs."""
    def on_activated(self):
        print("ready", flush=True)
    def on_deactivated(self):
        print("stopped", flush=True)

class Boss(Component):
    """Switches the counter off for half a second."""
    n = 0
    async def on_execute(self):
        self.n += 1
        counter = self.kernel.components["counter"]
        if self.n == 3:
            await counter.context.deactivate(counter)
        if self.n == 8:
            await counter.context.activate(counter)

class Stopper(Component):
    status = Param(7)
    def on_execute(self):
        self.kernel.request_stop(self.status)

class Failing(Component):
    def on_execute(self):
        raise ValueError("no such luck")

class Unmade(Component):
    def on_initialize(self):
        raise ValueError("not today")

class Blocked(Component):
    def on_execute(self):
        print("ready", flush=True)
        while True:
            time.sleep(0.01)

class Stubborn(Component):
    async def on_execute(self):
        print("ready", flush=True)
        while True:
            try:
                await self.sleep(60)
            except BaseException:
                pass
'''


@pytest.fixture
def write(tmp_path: Path) -> Callable[[str], Path]:
    """Write a system file beside the components above."""

    def write(text: str) -> Path:
        (tmp_path / "parts.py").write_text(COMPONENTS)
        path = tmp_path / "system.toml"
        path.write_text("schema = 1\n" + textwrap.dedent(text))
        return path

    return write


def one(kind: str, context: str = 'kind = "periodic"\nrate = 100.0', params: str = "") -> str:
    return f'[components.it]\ntype = "parts.py:{kind}"\n{params}\n[contexts.loop]\n{context}\nmembers = ["it"]\n'


def aiorts(*arguments: object, **options: Any) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "aiorts", *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=30,
        check=False,
        cwd=ROOT,
        **options,
    )


def started(path: Path, *arguments: str) -> subprocess.Popen[str]:
    """A run that has said that it is ready."""
    process = subprocess.Popen(
        [sys.executable, "-m", "aiorts", "run", str(path), *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
    )
    with limited(process):
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
    return process


def only_line(done: subprocess.CompletedProcess[str]) -> str:
    """The one line on standard error, which is all that a user has to read."""
    lines = done.stderr.splitlines()
    assert len(lines) == 1, done.stderr
    assert lines[0].startswith("aiorts: ")
    assert len(re.sub(r"/\S+", "", lines[0])) <= LONGEST  # paths are never cut
    return lines[0]


SOURCE_AND_SINK = """
    [components.counter]
    type = "parts.py:Counter"
    [components.total]
    type = "parts.py:Total"
    [[connections]]
    from = "counter.out"
    to = "total.numbers"
    length = 100
    [contexts.a]
    kind = "periodic"
    rate = 1000.0
    members = ["counter"]
    [contexts.b]
    kind = "event"
    members = ["total"]
"""


@pytest.mark.slow(kept_by="first")
@pytest.mark.parametrize("loop", ["auto", "asyncio", "uvloop"])
def test_it_ends_when_the_source_has_finished_and_all_was_taken(write: Callable[[str], Path], loop: str) -> None:
    done = here("run", write(SOURCE_AND_SINK), "--loop", loop, "--set", "counter.count=10")
    assert (done.returncode, done.stdout, done.stderr) == (0, "total 45\n", "")


def test_it_ends_at_the_status_that_a_component_asks_for(write: Callable[[str], Path]) -> None:
    done = here("run", write(one("Stopper")))
    assert (done.returncode, done.stderr) == (7, "")


@pytest.mark.slow(kept_by="cli/test_clock.py::test_the_clock_of_the_file_is_taken_and_the_command_line_wins")
def test_it_ends_after_its_duration_in_virtual_time_too(write: Callable[[str], Path]) -> None:
    path = write(one("Ready"))
    begun = time.monotonic()
    for arguments in (
        ["--duration", "0.2"],
        ["--duration", "1000", "--simulate"],
        ["--duration", "20", "--speed", "100"],
    ):
        done = here("run", path, *arguments)
        assert (done.returncode, done.stdout, done.stderr) == (0, "ready\nstopped\n", "")
    assert time.monotonic() - begun < 20


@pytest.mark.parametrize(("lenient", "status"), [([], 3), (["--lenient"], 0)])
@pytest.mark.parametrize("how", [[], ["--duration", "0.1"]])
def test_a_component_in_error_is_one_line_and_a_status_unless_that_is_not_wanted(
    write: Callable[[str], Path], how: list[str], lenient: list[str], status: int
) -> None:
    done = here("run", write(one("Failing")), *how, *lenient)
    assert done.returncode == status
    assert only_line(done).startswith("aiorts: E-COMPONENT: it.on_execute: ValueError: no such luck (")


SWITCHED = """
    [components.boss]
    type = "parts.py:Boss"
    [contexts.slow]
    kind = "periodic"
    rate = 10.0
    members = ["boss"]
"""
HELPED = """
    [components.counter.supervision]
    restart = "{}"
    backoff = 0.5
"""


@pytest.mark.parametrize("more", ["", SWITCHED, HELPED.format("reset"), HELPED.format("restart")])
def test_it_goes_on_while_its_source_is_switched_off_or_waits_to_be_helped(
    write: Callable[[str], Path], more: str
) -> None:
    text = SOURCE_AND_SINK.replace("rate = 1000.0", "rate = 20.0")
    fails = "--set=counter.fails=3" if more.startswith(HELPED[:20]) else "--set=counter.fails=0"
    done = here("run", write(text + more), "--simulate", "--set", "counter.count=10", fails)
    assert done.returncode == 0, done.stderr
    total = int(done.stdout.split()[-1])
    assert total == (sum(range(10)) if 'restart = "restart' not in more else 1 + sum(range(10)))


def test_one_that_is_not_helped_ends_it_with_status_3(write: Callable[[str], Path]) -> None:
    done = here("run", write(SOURCE_AND_SINK), "--simulate", "--set", "counter.fails=3", "--set", "counter.count=10")
    assert (done.returncode, done.stdout) == (3, "total 1\n")
    only_line(done)


def test_debug_shows_the_traceback(write: Callable[[str], Path]) -> None:
    done = here("run", write(one("Failing")), "--for", "0.1", "--debug")
    assert "Traceback (most recent call last)" in done.stderr
    assert "raise ValueError" in done.stderr


def test_a_component_that_cannot_be_made_ends_the_run(write: Callable[[str], Path]) -> None:
    done = here("run", write(one("Unmade")))
    assert done.returncode == 1
    assert only_line(done).startswith("aiorts: E-COMPONENT: it: ValueError: not today (")


@pytest.mark.fault("F04")
@pytest.mark.parametrize(
    ("text", "arguments", "said"),
    [
        (one("Reddy"), [], "did you mean 'Ready'"),
        (one("Ready").replace("parts.py", "part.py"), [], "did you mean 'parts.py:"),
        (one("Ready").replace("parts.py:Ready", "FlexiFliter"), [], "did you mean FlexiFilter"),
        (one("Ready").replace("parts.py:Ready", "../x.py:Ready"), [], "outside the system file's folder"),
        (one("Ready", 'kind = "periodik"'), [], "did you mean 'periodic'"),
        (one("Ready", 'kind = "periodic"\nrate = 2.0\nrat = 5.0'), [], "did you mean 'rate'"),
        (one("Ready", 'kind = "periodic"\nrate = -5.0'), [], "rate = -5.0"),
        (one("Counter", params="params.cuont = 5"), [], "did you mean count"),
        (one("Counter"), ["--set", "it.count=many"], "must be an int"),
        (one("Counter"), ["--set", "its.count=5"], "did you mean 'it'"),
        (one("Counter"), ["--set", "it.count"], "COMPONENT.PARAM=VALUE"),
        (one("Counter"), ["--sped", "5"], "--speed"),
        (one("Counter"), ["--speed", "nan"], "above 0"),
        (one("Counter"), ["--duration", "-1"], "above 0"),
        (one("Counter"), ["--loop", "trio"], "trio"),
        ("[", [], "not valid TOML"),
        (SOURCE_AND_SINK.replace("total.numbers", "total.number"), [], "did you mean"),
        (SOURCE_AND_SINK.replace("length = 100", "lenght = 100"), [], "did you mean 'length'"),
        (SOURCE_AND_SINK.replace("length = 100", 'full = "blok"'), [], "did you mean 'block'"),
    ],
)
def test_a_mistake_is_one_line_with_what_was_meant(
    write: Callable[[str], Path], capsys: pytest.CaptureFixture[str], text: str, arguments: list[str], said: str
) -> None:
    status = run_command(["run", str(write(text)), *arguments])
    printed = capsys.readouterr()
    assert status == 2
    assert printed.out == ""
    assert said in printed.err
    assert printed.err.startswith("aiorts: E-")
    first, *quoted = printed.err.splitlines()
    assert len(re.sub(r"/\S+", "", first)) <= LONGEST  # paths are never cut
    assert len(quoted) in (0, 2)  # typed text is quoted, and the place marked
    assert all(line.startswith("  ") for line in quoted)


def test_a_file_that_does_not_load_is_named_with_its_line(write: Callable[[str], Path]) -> None:
    path = write(one("Ready").replace("parts.py", "bad.py"))
    (path.parent / "bad.py").write_text("import sys\nraise SystemExit(9)\n")
    done = here("run", path)
    assert done.returncode == 2
    first, *quoted = done.stderr.splitlines()
    assert "bad.py:Ready cannot be loaded: SystemExit: 9 (" in first
    assert quoted == ['  type = "bad.py:Ready"', f"         {'^' * 14}"]


MANY = """
    [components.a]
    type = "parts.py:Reddy"
    [components.b]
    type = "parts.py:Counter"
    params.cuont = 5
    [contexts.loop]
    kind = "periodic"
    rat = 5.0
    members = ["a", "bb"]
"""


def test_every_mistake_of_a_file_is_told_as_check_tells_it(write: Callable[[str], Path]) -> None:
    path = write(MANY)
    done, checked = here("run", path), here("check", path, "--quiet")
    assert (done.returncode, checked.returncode) == (2, 2)
    assert done.stderr == checked.stdout.rpartition(f"{path}: ")[0]
    assert [line.split(": ")[1] for line in done.stderr.splitlines() if line.startswith("aiorts")] == [
        "E-PLUGIN", "E-CONFIG", "E-SYSTEM", "E-SYSTEM", "E-SYSTEM",
    ]  # fmt: skip
    lines = here("run", path, "--log-format", "json").stderr.splitlines()
    assert [json.loads(line)["code"] for line in lines] == ["E-PLUGIN", "E-CONFIG", "E-SYSTEM", "E-SYSTEM", "E-SYSTEM"]


def test_what_is_wrong_when_the_system_is_made_is_told_in_the_same_way(write: Callable[[str], Path]) -> None:
    path = write(SOURCE_AND_SINK.replace("total.numbers", "total.number"))
    done, checked = here("run", path), here("check", path, "--quiet")
    assert done.returncode == 2
    assert done.stderr == checked.stdout.rpartition(f"{path}: ")[0]


def test_a_mistake_of_the_command_line_stands_beside_those_of_the_file(write: Callable[[str], Path]) -> None:
    path = write(MANY)
    first, *others = here("run", path, "--set", "x").stderr.splitlines()
    assert first.startswith(f"aiorts: E-CONFIG: {path}: --set 'x': expected COMPONENT.PARAM=VALUE")
    assert sum(line.startswith("aiorts: ") for line in others) == 5


@pytest.mark.parametrize("arguments", [["run"], ["run", "missing.toml"], ["rum"], ["--nope"]])
def test_a_bad_command_line_is_one_line_and_status_2(arguments: list[str]) -> None:
    done = here(*arguments)
    assert done.returncode == 2
    only_line(done)


@pytest.mark.slow(kept_by="cli/test_signals.py::test_a_signal_ends_it_in_order_within_five_seconds")
@pytest.mark.skipif(sys.platform == "win32", reason="no POSIX signals")
@pytest.mark.parametrize(("loop", "number", "status"), [("asyncio", "SIGINT", 130), ("uvloop", "SIGTERM", 143)])
def test_a_signal_ends_it_in_order(write: Callable[[str], Path], loop: str, number: str, status: int) -> None:
    process = started(write(one("Ready")), "--loop", loop)
    process.send_signal(getattr(signal, number))
    out, errors = process.communicate(timeout=20)
    assert (process.returncode, out, errors) == (status, "stopped\n", "")


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="no POSIX signals")
@pytest.mark.fault("F09")
@pytest.mark.parametrize("kind", ["Blocked", "Stubborn"])
def test_the_second_signal_ends_it_at_once_also_when_the_loop_is_blocked(
    write: Callable[[str], Path], kind: str
) -> None:
    process = started(write(one(kind)))
    process.send_signal(signal.SIGINT)
    time.sleep(0.2)
    assert process.poll() is None
    begun = time.monotonic()
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=20)
    assert time.monotonic() - begun < 3.5  # 0.5 s on a machine that is free; the first signal alone takes 5 s
    assert process.returncode == 130
    assert "Traceback" not in errors


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="no POSIX signals")
@pytest.mark.fault("F09")
def test_it_is_gone_within_five_seconds_whatever_is_left(write: Callable[[str], Path]) -> None:
    path = write(one("Blocked"))
    other = path.with_name("other.toml")
    other.write_text(path.read_text().replace("Blocked", "Stubborn"))
    processes = [started(path), started(other)]
    begun = time.monotonic()
    for process in processes:
        process.send_signal(signal.SIGTERM)
    for process in processes:
        _, errors = process.communicate(timeout=20)
        assert time.monotonic() - begun < 8.0  # 5 s on a machine that is free
        assert process.returncode == 143
        assert "Traceback" not in errors


FLOOD = """
    [components.counter]
    type = "parts.py:Counter"
    params.count = 100000
    [components.show]
    type = "FlexiDump"
    params.inputs = ["TimedLong"]
    [[connections]]
    from = "counter.out"
    to = "show.input0"
    full = "block"
    timeout = inf
    [contexts.a]
    kind = "periodic"
    rate = 5000.0
    members = ["counter"]
    [contexts.b]
    kind = "event"
    members = ["show"]
"""


@pytest.mark.slow(kept_by="cli/test_demo.py::test_a_reader_that_has_seen_enough_ends_it_quietly")
@pytest.mark.skipif(sys.platform == "win32", reason="no POSIX pipes")
@pytest.mark.fault("F11")
def test_a_reader_that_goes_away_ends_it_quietly(write: Callable[[str], Path]) -> None:
    with (
        subprocess.Popen(
            [sys.executable, "-m", "aiorts", "run", str(write(FLOOD))],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            cwd=ROOT,
        ) as process,
        limited(process),
    ):
        assert process.stdout is not None
        assert process.stderr is not None
        assert process.stdout.readline().startswith("input0 TimedLong")
        process.stdout.close()
        assert process.wait(timeout=10) in (0, 141)
        assert process.stderr.read() == ""


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.fault("F12")
@pytest.mark.parametrize("flush", ["", ", flush=True"])
def test_a_full_disk_is_said_and_a_failure(write: Callable[[str], Path], flush: str) -> None:
    path = write(one("Ready"))
    parts = path.parent / "parts.py"
    parts.write_text(parts.read_text().replace(", flush=True", flush))
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "aiorts", "run", str(path), "--duration", "0.1"],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            timeout=20,
            check=False,
            cwd=ROOT,
        )
    assert done.returncode == 3  # it is the component's own print that fails
    assert "No space left" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="needs a POSIX shell")
@pytest.mark.fault("F12")
@pytest.mark.parametrize("closed", ["<&-", ">&-", "2>&-"])
def test_it_runs_without_a_standard_stream(write: Callable[[str], Path], closed: str) -> None:
    path = write(one("Ready"))
    done = subprocess.run(
        ["sh", "-c", f'"$0" -m aiorts run "$1" --duration 0.1 {closed}', sys.executable, str(path)],
        capture_output=True,
        text=True,
        timeout=20,
        check=False,
        cwd=ROOT,
    )
    assert done.returncode == 0, done.stderr


def test_help_and_version_are_fast_and_load_no_system() -> None:
    code = (
        "import sys; sys.argv = ['aiorts', '--help']; import aiorts.cli; status = aiorts.cli.main(); "
        "assert status == 0; assert 'aiorts.system' not in sys.modules; assert 'numpy' not in sys.modules"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=20, check=False, cwd=ROOT, env=os.environ
    )
    assert done.returncode == 0, done.stderr
    assert "run" in done.stdout
    assert "bench" in done.stdout
    assert aiorts("--version").stdout.startswith("aiorts ")
