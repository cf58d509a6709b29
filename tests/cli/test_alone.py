"""A component without in-ports, alone: `aiorts NAME` and `aiorts run NAME` write its samples to standard output."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from run_parts import here, limited

PARTS = '''
from collections.abc import Iterator
from aiorts import Component, InPort, OutPort, Param, component
from aiorts.types import TimedLong

class Counter(Component):
    """Sends numbers and says where."""
    out = OutPort(TimedLong)
    other = OutPort(TimedLong)
    last = Param(3)
    n = 0
    async def on_execute(self):
        self.n += 1
        await self.out.write(TimedLong(self.clock.time_ns(), self.n))
        if self.n == self.last:
            await self.other.write(TimedLong(0, -1))
            self.finish()
    def on_deactivated(self):
        self.log.warning("%s %s", self.context.kind, self.context.rate)

class Sets(Counter):
    configurations = {"two": {"last": 2}}

class Named(Sets):
    active = Param(1)

class Fast(Counter):
    alone = {"rate": 200.0}

class Threaded(Counter):
    alone = {"kind": "thread"}
    def on_execute(self):
        self.n += 1
        self.out.write_blocking(TimedLong(0, self.n))
        if self.n == self.last:
            self.finish()

class Echo(Component):
    """Takes and sends."""
    numbers = InPort(TimedLong)
    out = OutPort(TimedLong)
    async def on_execute(self):
        for sample in self.numbers.drain():
            await self.out.write(sample)
    def on_activated(self):
        self.log.warning("%s %s", self.context.kind, self.context.rate)

class Failing(Counter):
    async def on_execute(self):
        raise ValueError("no")

class Burst(Component):
    """Sends more at once than there is room for, and does not wait."""
    out = OutPort(TimedLong)
    def on_execute(self):
        for number in range(1500):
            self.out.write_nowait(TimedLong(0, number))

class Crossed(Counter):
    first = Param(1)
    def check_configuration(self, values):
        if values["first"] > values["last"]:
            raise ValueError("first is above last")

class BadRate(Counter):
    alone = {"rate": -1.0}

class BadKey(Counter):
    alone = {"rat": 1.0}

class BadKind(Counter):
    alone = {"kind": "periodical"}

class BadTable(Counter):
    alone = 50.0

@component
def ramp(*, upto: int = 3) -> Iterator[int]:
    yield from range(upto)
'''


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "parts.py").write_text(PARTS)
    return tmp_path


def data(text: str) -> list[object]:
    return [json.loads(line)["data"] for line in text.splitlines()]


@pytest.mark.row(123)
@pytest.mark.parametrize("command", [["run", "parts.py:Counter", "--set", "last=2"], ["counter", "--last", "2"]])
def test_without_in_ports_it_produces_until_it_finishes(folder: Path, command: list[str]) -> None:
    done = here(folder, *command, "--rate", "500", AIORTS_PLUGINS=".")
    assert done.returncode == 0
    assert data(done.stdout) == [1, 2, -1]
    assert json.loads(done.stdout.splitlines()[-1])["port"] == "other"


@pytest.mark.parametrize(
    ("name", "options", "context"),
    [
        ("Counter", ["--simulate"], "periodic 10.0"),
        ("Counter", ["--rate", "500"], "periodic 500.0"),
        ("Fast", [], "periodic 200.0"),
        ("Fast", ["--rate", "500"], "periodic 500.0"),
        ("Threaded", [], "thread None"),
        ("Threaded", ["--rate", "500"], "thread 500.0"),
    ],
)
def test_a_class_says_which_context_it_runs_in_alone(folder: Path, name: str, options: list[str], context: str) -> None:
    done = here(folder, "run", f"parts.py:{name}", *options)
    assert done.returncode == 0
    assert context in done.stderr
    assert data(done.stdout)[:3] == [1, 2, 3]


def test_as_a_filter_too(folder: Path) -> None:
    done = here(folder, "fast", AIORTS_PLUGINS=".")
    assert (done.returncode, data(done.stdout)) == (0, [1, 2, 3, -1])


@pytest.mark.parametrize(
    ("options", "last"), [(["active=two"], 2), (["active=default"], 3), (["active=two", "last=4"], 4)]
)
def test_a_configuration_set_is_chosen_by_run_and_by_the_filter(folder: Path, options: list[str], last: int) -> None:
    for command in (
        ["run", "parts.py:Sets", *(word for one in options for word in ("--set", one))],
        ["sets", *(f"--{one}" for one in options)],
    ):
        done = here(folder, *command, "--rate", "500", AIORTS_PLUGINS=".")
        assert (done.returncode, data(done.stdout)) == (0, [*range(1, last + 1), -1]), done.stderr


@pytest.mark.parametrize(
    ("command", "said"),
    [
        (["run", "parts.py:Sets", "--set", "active=tow"], "sets: no set 'tow'; did you mean two?"),
        (["sets", "--active", "tow"], "'tow' is not one of 'default', 'two'"),
        (["counter", "--active", "two"], "No such option '--active'"),
        (["counter", "--set", "last=1.5"], "--set is of `aiorts run`; write --last 1.5;"),
        (["counter", "--set=counter.last=1"], "write --last 1;"),
        (["counter", "--set", "lats=1"], "its parameters are options: --last"),
        (["named", "--active", "two"], "--active 'two': "),
    ],
)
def test_a_set_that_is_not_there_and_an_option_of_run_are_answered(folder: Path, command: list[str], said: str) -> None:
    done = here(folder, *command, AIORTS_PLUGINS=".")
    assert (done.returncode, done.stdout) == (2, "")
    assert said in done.stderr


def test_the_help_of_the_filter_names_the_sets(folder: Path) -> None:
    assert "--active SET" in here(folder, "sets", "--help", AIORTS_PLUGINS=".").stdout
    assert "--active" not in here(folder, "counter", "--help", AIORTS_PLUGINS=".").stdout


@pytest.mark.parametrize("command", [["run", "parts.py:ramp", "--set", "upto=1000"], ["ramp", "--upto", "1000"]])
def test_a_generator_is_as_fast_as_it_is_read(folder: Path, command: list[str]) -> None:
    done = here(folder, *command, AIORTS_PLUGINS=".")
    assert (done.returncode, data(done.stdout), done.stderr) == (0, list(range(1000)), "")


def test_one_that_takes_data_is_fed_as_before_or_periodically(folder: Path) -> None:
    done = here(folder, "echo", "--rate", "500", stdin="1\n2\n", AIORTS_PLUGINS=".")
    assert (done.returncode, data(done.stdout)) == (0, [1, 2])
    assert "periodic 500.0" in done.stderr
    done = here(folder, "run", "parts.py:Echo", "--for", "0.01")
    assert (done.returncode, done.stdout) == (0, "")
    assert "event None" in done.stderr


@pytest.mark.parametrize(
    ("name", "options", "stdin", "printed"),
    [
        ("Counter", ["--count", "2", "--rate", "500", "--set", "last=5000"], "", [1, 2]),
        ("Counter", ["--count", "2", "--simulate", "--set", "last=5000"], "", [1, 2]),
        ("Counter", ["--count", "9", "--rate", "500"], "", [1, 2, 3, -1]),
        ("Echo", ["--count", "2"], "1\n2\n3\n4\n", [1, 2]),
        ("Echo", ["--count", "2", "--quiet"], "1\n2\nbad\n", []),
    ],
)
def test_run_ends_after_a_count_of_samples(
    folder: Path, name: str, options: list[str], stdin: str, printed: list[int]
) -> None:
    done = here(folder, "run", f"parts.py:{name}", *options, stdin=stdin)
    assert (done.returncode, "bad" in done.stderr) == (0, False)
    assert data(done.stdout) == printed


def test_what_refuses_its_parameters_is_named_once(folder: Path) -> None:
    done = here(folder, "run", "parts.py:Crossed", "--set", "first=4")
    assert done.returncode == 2
    assert "E-CONFIG: crossed: check_configuration: first is above last" in done.stderr


def test_a_count_of_nothing_is_refused(folder: Path) -> None:
    done = here(folder, "run", "parts.py:Counter", "--quiet", "--count", "2")
    assert (done.returncode, done.stdout) == (2, "")
    assert "--count: no samples are printed and none are read" in done.stderr
    done = here(folder, "run", "parts.py:Echo", "--simulate", "--rate", "500", "--count", "2")
    assert (done.returncode, done.stdout) == (2, "")
    assert "--count: echo has in-ports, and standard input is not read" in done.stderr
    (folder / "system.toml").write_text('schema = 1\ncomponents.a.type = "parts.py:Counter"\n')
    done = here(folder, "run", "system.toml", "--count", "2")
    assert done.returncode == 2
    assert "--count is for a component alone" in done.stderr


def test_a_burst_that_does_not_wait_is_an_error_with_its_remedy_after_what_had_room_was_printed(folder: Path) -> None:
    done = here(folder, "run", "parts.py:Burst")
    assert (done.returncode, data(done.stdout)) == (3, list(range(1000)))
    assert (
        "WouldBlock: burst.out: stdout.out has no room (1000 unread), and no reader got this sample; await write()"
        in (done.stderr)
    )


def test_count_and_quiet_end_and_silence_it(folder: Path) -> None:
    done = here(folder, "fast", "--last", "1000000", "--count", "2", AIORTS_PLUGINS=".")
    assert (done.returncode, data(done.stdout)) == (0, [1, 2])
    done = here(folder, "run", "--quiet", "parts.py:Fast")
    assert (done.returncode, done.stdout) == (0, "")


@pytest.mark.parametrize("command", [["run", "parts.py:Failing"], ["failing"]])
def test_one_that_fails_ends_with_3(folder: Path, command: list[str]) -> None:
    done = here(folder, *command, AIORTS_PLUGINS=".")
    assert (done.returncode, done.stdout) == (3, "")
    assert "ValueError: no" in done.stderr


@pytest.mark.fault("F04")
@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("BadRate", "E-DECLARE: BadRate.alone: rate: expected a number of Hz from 0.001 on"),
        ("BadKey", "E-DECLARE: BadKey.alone: rat: unknown key 'rat'; did you mean 'rate'?"),
        ("BadKind", "E-DECLARE: BadKind.alone: no context named 'periodical'; did you mean periodic"),
        ("BadTable", "E-DECLARE: BadTable.alone = 50.0: expected a table"),
    ],
)
def test_what_cannot_be_is_refused(folder: Path, name: str, said: str) -> None:
    done = here(folder, "run", f"parts.py:{name}")
    assert (done.returncode, done.stdout) == (2, "")
    assert said in done.stderr
    done = here(folder, name.lower(), AIORTS_PLUGINS=".")
    assert (done.returncode, done.stdout) == (2, "")


def test_a_bad_rate_is_refused(folder: Path) -> None:
    done = here(folder, "counter", "--rate", "nan", AIORTS_PLUGINS=".")
    assert done.returncode == 2
    assert "--rate" in done.stderr


@pytest.mark.slow(kept_by="test_a_generator_is_as_fast_as_it_is_read")
def test_it_waits_for_its_reader_and_ends_quietly_when_that_goes(folder: Path) -> None:
    command = [sys.executable, "-m", "aiorts", "run", "parts.py:ramp", "--set", "upto=1000000000"]
    process = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    with process, limited(process):
        assert process.stdout is not None
        assert process.stderr is not None
        lines = [json.loads(process.stdout.readline())["data"] for _ in range(3)]
        process.stdout.close()
        assert (lines, process.stderr.read(), process.wait(20)) == ([0, 1, 2], b"", 128 + 13)


@pytest.mark.slow(kept_by="test_count_and_quiet_end_and_silence_it")
def test_without_standard_output_it_runs_all_the_same(folder: Path) -> None:
    command = f"{sys.executable} -m aiorts run parts.py:Fast >&-"
    done = subprocess.run(["sh", "-c", command], cwd=folder, capture_output=True, timeout=30, env=dict(os.environ))
    assert done.returncode == 0
    assert b"periodic 200.0" in done.stderr


PERIODICAL = '''
from aiorts import Component, InPort, OutPort, Param
from aiorts.types import TimedLong

class Ticking(Component):
    """Has a rate of its own and finishes after three cycles."""
    alone = {"rate": 200.0}
    numbers = InPort(TimedLong)
    n = 0
    def on_execute(self):
        self.n += 1
        if self.n == 3:
            print("three cycles", flush=True)
            self.finish()

class First(Component):
    """Passes one on and finishes."""
    numbers = InPort(TimedLong)
    out = OutPort(TimedLong)
    def on_execute(self):
        self.out.write_nowait(self.numbers.latest)
        self.finish()

class Refusing(Component):
    numbers = InPort(TimedLong)
    def on_activated(self):
        raise ValueError("no")

class Picky(Component):
    numbers = InPort(TimedLong)
    def on_execute(self):
        raise ValueError("no")

class Many(Component):
    """Has as many in-ports as its parameter says."""
    inputs = Param(1)
    out = OutPort(TimedLong)
    def ports_for(self, values):
        return {f"in{number}": InPort(TimedLong) for number in range(values["inputs"])}
    async def on_execute(self):
        for port in self.ports.values():
            for sample in port.drain() if isinstance(port, InPort) else ():
                await self.out.write(sample)
'''


@pytest.mark.slow
@pytest.mark.row(123)
def test_run_feeds_ports_that_a_parameter_makes(folder: Path) -> None:
    (folder / "parts.py").write_text(PERIODICAL)
    fed = here(folder, "run", "parts.py:Many", "--set", "inputs=3", stdin='{"port": "in2", "data": 7}\n')
    assert (fed.returncode, data(fed.stdout), fed.stderr) == (0, [7], "")
    none = here(folder, "run", "parts.py:Many", "--set", "inputs=0", "--rate", "100", "--for", "0.05", stdin="1\n")
    assert (none.returncode, none.stdout) == (0, "")


@pytest.mark.row(123)
@pytest.mark.parametrize("options", [[], ["--rate", "500"]])
def test_run_feeds_one_that_takes_data_from_a_file_or_a_pipe_as_the_filter_does(
    folder: Path, options: list[str]
) -> None:
    as_run = here(folder, "run", "parts.py:Echo", *options, stdin="1\n2\n")
    as_filter = here(folder, "echo", *options, stdin="1\n2\n", AIORTS_PLUGINS=".")
    assert (as_run.returncode, data(as_run.stdout)) == (as_filter.returncode, data(as_filter.stdout)) == (0, [1, 2])
    assert "W-UNFED" not in as_run.stderr


@pytest.mark.slow(kept_by="test_as_a_filter_too")
def test_run_passes_every_line_of_a_pipe_and_ends_with_it(folder: Path) -> None:
    command = [sys.executable, "-m", "aiorts", "run", "parts.py:Echo"]
    lines = "".join(f"{n}\n" for n in range(5000))
    done = subprocess.run(command, cwd=folder, input=lines, capture_output=True, text=True, timeout=30)
    assert (done.returncode, data(done.stdout)) == (0, list(range(5000)))


def test_run_tells_a_bad_line_and_ends_with_1(folder: Path) -> None:
    done = here(folder, "run", "parts.py:Echo", stdin="1\nx\n3\n")
    assert (done.returncode, data(done.stdout)) == (1, [1, 3])
    assert "E-LINE: standard input, line 2: " in done.stderr


def test_quiet_prints_nothing_of_one_that_is_fed_and_virtual_time_feeds_none(folder: Path) -> None:
    assert here(folder, "run", "parts.py:Echo", "--quiet", stdin="1\n").stdout == ""
    assert here(folder, "run", "parts.py:Echo", "--simulate", "--for", "1", stdin="1\n").stdout == ""


def test_one_that_fails_on_its_data_ends_the_run_with_3_and_one_line(folder: Path) -> None:
    (folder / "more.py").write_text(PERIODICAL)
    done = here(folder, "run", "more.py:Picky", stdin="1\n" * 3)
    assert done.returncode == 3
    assert (
        done.stderr
        == "aiorts: E-COMPONENT: picky.on_execute: ValueError: no (more.py:32); --debug shows the traceback\n"
    )


@pytest.mark.parametrize("stdin", ["", "\n"])
def test_an_input_without_a_line_does_not_end_one_with_a_rate(folder: Path, stdin: str) -> None:
    (folder / "more.py").write_text(PERIODICAL)
    done = here(folder, "run", "more.py:Ticking", stdin=stdin)
    assert (done.returncode, done.stdout, done.stderr) == (0, "three cycles\n", "")
    done = here(folder, "run", "parts.py:Echo", stdin=stdin)
    assert (done.returncode, done.stdout) == (0, "")


@pytest.mark.slow(kept_by="cli/test_run.py::test_it_ends_when_the_source_has_finished_and_all_was_taken")
@pytest.mark.parametrize("command", [["run", "more.py:First"], ["more.py:First"], ["run", "more.py:Ticking"]])
def test_one_that_has_finished_ends_it_though_nobody_closes_the_pipe(folder: Path, command: list[str]) -> None:
    (folder / "more.py").write_text(PERIODICAL)
    reading, writing = os.pipe()
    os.write(writing, b"7\n" * 3000)
    words = [sys.executable, "-m", "aiorts", *command]
    try:
        done = subprocess.run(words, cwd=folder, stdin=reading, capture_output=True, text=True, timeout=30)
    finally:
        os.close(reading)
        os.close(writing)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == "three cycles\n" if "Ticking" in command[-1] else data(done.stdout) == [7]


@pytest.mark.slow(kept_by="test_one_that_fails_ends_with_3")
def test_one_alone_that_failed_long_ago_is_told_once(folder: Path) -> None:
    (folder / "more.py").write_text(PERIODICAL)
    words = [sys.executable, "-m", "aiorts", "run", "more.py:Refusing", "--speed", "10000"]
    done = subprocess.run(words, cwd=folder, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=30)
    said = "aiorts: E-COMPONENT: refusing.on_activated: ValueError: no (more.py:27); --debug shows the traceback\n"
    assert (done.returncode, done.stderr) == (3, said)


@pytest.mark.slow(kept_by="test_one_that_takes_data_is_fed_as_before_or_periodically")
def test_null_is_no_input_and_one_with_a_rate_runs_all_the_same(folder: Path) -> None:
    (folder / "more.py").write_text(PERIODICAL)
    words = [sys.executable, "-m", "aiorts", "run", "more.py:Ticking"]
    done = subprocess.run(words, cwd=folder, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=30)
    assert (done.returncode, done.stdout, done.stderr) == (0, "three cycles\n", "")
