"""One table of exit statuses: every command keeps to it, and `aiorts help` shows it."""

from __future__ import annotations

import ast
import signal
from pathlib import Path

import pytest

from aiorts import Catalogue, exits
from aiorts.cli.app import aiorts, run_command
from aiorts.diagnostics.loop_monitor import EXIT_STATUS
from aiorts.errors import ComponentError, ConfigurationError
from aiorts_log.mcap.reader import RecordingReader
from run_parts import here
from trees import dotted, nodes, parse

ROOT = Path(__file__).parents[2]
COMPONENTS = [name.lower() for name in Catalogue.default().extensions("components")]
LOG = ("info", "cat", "convert", "cut", "merge", "diff", "plot", "import", "salvage")
BENCHES = tuple(Catalogue.default().extensions("benches"))
COMMANDS = [(name,) for name in (*aiorts.own, "bench", "log", *COMPONENTS)]
BELOW = [*(("log", name) for name in LOG), *(("bench", name) for name in BENCHES)]
PARTS = '''
from aiorts import Component, InPort, OutPort, Param
from aiorts.types import TimedLong

class Source(Component):
    """Sends numbers; what is more than `most` it cannot send."""
    out = OutPort(TimedLong)
    most = Param(100)
    n = 0
    def on_execute(self):
        self.n += 1
        if self.n > self.most:
            raise ValueError("too much")
        self.out.write_nowait(TimedLong(0, self.n))
        if self.n == 10:
            self.finish()

class Double(Component):
    """Doubles."""
    inp = InPort(TimedLong)
    out = OutPort(TimedLong)
    def on_execute(self):
        for sample in self.inp.drain():
            if sample.data == 13:
                raise ValueError("not that one")
            self.out.write_nowait(TimedLong(0, 2 * sample.data))

class Unmade(Component):
    """Its constructor fails."""
    inp = InPort(TimedLong)
    def __init__(self, name=""):
        super().__init__(name)
        raise LookupError("no camera")

class Uninitialized(Component):
    """Its first hook fails."""
    inp = InPort(TimedLong)
    def on_initialize(self):
        raise LookupError("no camera")

class Inactive(Component):
    """It cannot be activated."""
    inp = InPort(TimedLong)
    out = OutPort(TimedLong)
    def on_activated(self):
        raise LookupError("no camera")

class Asks(Component):
    """Asks for the end with a status of its own."""
    def on_execute(self):
        self.kernel.request_stop(9)
'''
SYSTEM = """
schema = 1
[components.source]
type = "parts.py:Source"
[components.double]
type = "parts.py:Double"
[[connections]]
from = "source.out"
to = "double.inp"
[contexts.fast]
kind = "periodic"
rate = 100.0
members = ["source"]
[contexts.data]
kind = "event"
members = ["double"]
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "parts.py").write_text(PARTS)
    (tmp_path / "system.toml").write_text(SYSTEM)
    (tmp_path / "unmade.toml").write_text(SYSTEM.replace("Double", "Unmade"))
    return tmp_path


def test_the_table_is_what_scripts_may_rely_on() -> None:
    numbers = (exits.DONE, exits.FAILED, exits.REFUSED, exits.IN_ERROR, exits.DENIED, exits.NO_ANSWER, exits.ABSENT)
    assert numbers == (0, 1, 2, 3, 4, 5, 6)
    assert [number for number, _ in exits.TABLE] == ["0", "1", "2", "3", "4", "5", "6", "70", "128 + n"]
    assert {exits.of_signal(signal.SIGTERM), exits.INTERRUPTED, exits.BROKEN_PIPE} == {143, 130, 141}
    assert exits.STALLED == EXIT_STATUS
    assert exits.of_error(ConfigurationError("x")) == exits.REFUSED
    assert exits.of_error(ComponentError("x")) == exits.FAILED


def test_help_shows_the_table(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["help", "commands"]) == 0
    shown = " ".join(capsys.readouterr().out.partition("Exit status:")[2].split())
    assert shown == " ".join(f"{number} {meaning}" for number, meaning in exits.TABLE)


@pytest.mark.parametrize("command", [*COMMANDS, *BELOW], ids=" ".join)
def test_every_command_has_help_and_refuses_what_it_does_not_know(
    command: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command([*command, "--help"]) == exits.DONE
    assert run_command([*command, "--no-such-option"]) == exits.REFUSED
    capsys.readouterr()


@pytest.mark.parametrize(
    ("words", "status"),
    [
        (("run", "system.toml", "--simulate"), exits.DONE),
        (("run", "system.toml", "--simulate", "--set", "source.most=5"), exits.IN_ERROR),
        (("run", "system.toml", "--simulate", "--set", "source.most=5", "--lenient"), exits.DONE),
        (("run", "system.toml", "--simulate", "--set", "source.most=many"), exits.REFUSED),
        (("run", "parts.py:Source", "--simulate", "--set", "most=5"), exits.IN_ERROR),
        (("run", "parts.py:Asks", "--simulate"), 9),
        (("run", "unmade.toml"), exits.FAILED),
        (("run", "parts.py:Unmade"), exits.FAILED),
        (("run", "parts.py:Uninitialized"), exits.FAILED),
        (("run", "missing.toml"), exits.REFUSED),
        (("run", "system.toml", "--strict"), exits.REFUSED),
        (("--plugins", ".", "double"), exits.DONE),
        (("--plugins", ".", "unmade"), exits.FAILED),
        (("--plugins", ".", "uninitialized"), exits.FAILED),
        (("--plugins", ".", "inactive"), exits.IN_ERROR),
        (("run", "parts.py:Inactive", "--simulate"), exits.IN_ERROR),
        (("check", "system.toml"), exits.DONE),
        (("check", "missing.toml"), exits.REFUSED),
        (("graph", "missing.toml"), exits.REFUSED),
        (("schema", "missing"), exits.REFUSED),
        (("inspect", "FlexiDump"), exits.DONE),
        (("inspect", "FlexiDmp"), exits.ABSENT),
        (("inspect", "parts.py:Sorce"), exits.ABSENT),
        (("inspect", "missing.py:Source"), exits.ABSENT),
        (("types", "TimedLong"), exits.DONE),
        (("types", "TimedLnog"), exits.ABSENT),
        (("plugins",), exits.DONE),
        (("help", "errors", "E-LIEN"), exits.REFUSED),
        (("completion", "tcsh"), exits.REFUSED),
        (("demo", "--save", "."), exits.REFUSED),
        (("log", "info", "missing.mcap"), exits.REFUSED),
        (("bench", "push", "--compare", "missing.json"), exits.REFUSED),
        (("nothing-of-that-name",), exits.REFUSED),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_each_command_keeps_to_it(folder: Path, words: tuple[str, ...], status: int) -> None:
    done = here(folder, *words)
    assert done.returncode == status, done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("lines", "status"), [("1\n2\n", exits.DONE), ("1\nx\n", exits.FAILED), ("1\n13\n", exits.IN_ERROR)]
)
def test_a_filter_keeps_to_it(folder: Path, lines: str, status: int) -> None:
    done = here(folder, "--plugins", ".", "double", stdin=lines)
    assert (done.returncode, "2}" in done.stdout) == (status, True)


@pytest.mark.slow
def test_a_recording_that_is_damaged_or_differs_is_a_failure(folder: Path) -> None:
    for name, value in (("one", "1"), ("two", "2")):
        made = here(folder, "flexilogger", "-p", "TimedLong", "-l", f"{name}.mcap", stdin=f"{value}\n" * 100)
        assert made.returncode == exits.DONE, made.stderr
    assert here(folder, "log", "diff", "one.mcap", "two.mcap", "--ignore", "tm").returncode == exits.FAILED
    assert here(folder, "log", "info", "--check", "one.mcap").returncode == exits.DONE
    raw = bytearray((folder / "one.mcap").read_bytes())
    with RecordingReader(folder / "one.mcap") as reader:
        raw[reader.pieces[0].offset + 99] ^= 2
    (folder / "one.mcap").write_bytes(raw)
    assert here(folder, "log", "info", "--check", "one.mcap").returncode == exits.FAILED
    assert here(folder, "log", "convert", "one.mcap", "one.csv").returncode == exits.REFUSED


@pytest.mark.slow
def test_a_component_that_waits_to_be_helped_when_the_time_is_over_has_ended_in_error(folder: Path) -> None:
    table = '[components.source.supervision]\nrestart = "{}"\nbackoff = 20.0\n[components.double]'
    for action in ("reset", "restart"):
        (folder / "system.toml").write_text(SYSTEM.replace("[components.double]", table.format(action)))
        words = ("run", "system.toml", "--simulate", "--set", "source.most=5")
        assert here(folder, *words, "--for", "10").returncode == exits.IN_ERROR


LAST = '''
import asyncio
from aiorts import Component

class Asked(Component):
    """Asks for the end."""
    def on_execute(self):
        self.kernel.request_stop()

class Deactivated(Asked):
    """Fails."""
    def on_deactivated(self):
        raise ValueError("the last moment")

class Shut(Asked):
    """Fails."""
    def on_shutdown(self):
        raise ValueError("the last moment")

class Finalized(Asked):
    """Fails."""
    def on_finalize(self):
        raise ValueError("the last moment")

class Hangs(Asked):
    """Waits too long."""
    async def on_deactivated(self):
        await asyncio.sleep(1000)

class HangsLater(Asked):
    """Waits too long."""
    async def on_shutdown(self):
        await asyncio.sleep(1000)

class Asking(Asked):
    """Fails as it asks for the end."""
    def on_execute(self):
        super().on_execute()
        raise ValueError("the last moment")

class Cancelled(Component):
    """Fails while it is stopped."""
    async def on_execute(self):
        asyncio.get_running_loop().call_later(0.1, self.kernel.request_stop)
        try:
            await asyncio.sleep(1000)
        finally:
            raise ValueError("the last moment")

class Task(Asked):
    """Its task fails."""
    def on_activated(self):
        self.task = asyncio.create_task(self.fail())
    async def fail(self):
        try:
            await asyncio.sleep(1000)
        finally:
            raise ValueError("the last moment")

class LateTask(Asked):
    """Its task, which is begun at the end, fails."""
    def on_deactivated(self):
        self.task = asyncio.create_task(self.fail())
    async def fail(self):
        raise ValueError("the last moment")

class Finishing(Component):
    """Fails when it has finished."""
    def on_execute(self):
        self.finish()
    def on_deactivated(self):
        raise ValueError("the last moment")

class Stopped(Component):
    """Fails when it stops itself for good."""
    async def on_execute(self):
        await self.context.stop()
    def on_deactivated(self):
        raise ValueError("the last moment")

class StoppedInError(Component):
    """Its context is stopped while it is in error."""
    def on_execute(self):
        raise ValueError("the last moment")
    async def on_error(self, error):
        await self.context.stop()

class Fault(Component):
    """Makes its context fail."""
    def on_execute(self):
        def fail(*_):
            raise RuntimeError("of aiorts")
        self.context._end_cycle = fail

class Again(Component):
    """What fails is made good."""
    n = 0
    async def on_execute(self):
        self.n += 1
        if self.n == 3:
            self.kernel.request_stop()
        elif self.n == 1:
            await self.context.deactivate()
            asyncio.get_running_loop().call_later(0.1, lambda: asyncio.ensure_future(self.contexts[0].activate()))
    def on_deactivated(self):
        if self.n == 1:
            raise ValueError("not the last moment")
'''
UNFINISHED = ("Deactivated", "Shut", "Finalized", "Hangs", "HangsLater", "Finishing", "Stopped")
IN_ERROR = ("Asking", "Cancelled", "Task", "LateTask", "StoppedInError")


@pytest.mark.parametrize(
    ("name", "status", "lenient"),
    [
        *((name, exits.FAILED, exits.FAILED) for name in (*UNFINISHED, "Fault")),
        *((name, exits.IN_ERROR, exits.DONE) for name in IN_ERROR),
        ("Asked", exits.DONE, exits.DONE),
        ("Again", exits.DONE, exits.DONE),
    ],
)
def test_a_failure_in_the_last_moments_counts(tmp_path: Path, name: str, status: int, lenient: int) -> None:
    (tmp_path / "last.py").write_text(LAST)
    for words, expected in ((), status), (("--lenient",), lenient):
        done = here(tmp_path, "run", f"last.py:{name}", "--simulate", "--for", "20", *words)
        assert done.returncode == expected, done.stderr
        assert ("aiorts: E-" in done.stderr or "fault" in done.stderr) is (name != "Asked"), done.stderr


@pytest.mark.slow
def test_a_failure_in_the_last_moments_of_a_thread_counts(folder: Path) -> None:
    (folder / "last.py").write_text(LAST)
    for name, status in ("Deactivated", exits.FAILED), ("Asking", exits.IN_ERROR):
        contexts = '[contexts.one]\nkind = "thread"\nrate = 100.0\nmembers = ["one"]\n'
        (folder / "thread.toml").write_text(f'schema = 1\n[components.one]\ntype = "last.py:{name}"\n{contexts}')
        assert here(folder, "run", "thread.toml", "--for", "20").returncode == status


GOING = """
from aiorts import Component, OutPort
from aiorts.types import TimedLong

class Source(Component):
    out = OutPort(TimedLong)

class Hand(Component):
    async def on_execute(self):
        if self.context.ticks == 2:
            {done}

class Slow(Component):
    async def on_activated(self):
        await self.sleep(3.0)
    def on_execute(self):
        if self.context.ticks > 100:
            raise ValueError("nobody has ended it")
"""
SOURCE_GOES = """
schema = 1
components.source.type = "going.py:Source"
components.hand.type = "going.py:Hand"
components.slow.type = "going.py:Slow"
contexts.first = { kind = "periodic", rate = 10.0, members = ["source"] }
contexts.second = { kind = "periodic", rate = 10.0, members = ["hand"] }
contexts.third = { kind = "periodic", rate = 10.0, members = ["slow"] }
"""


@pytest.mark.parametrize(
    ("done", "status"),
    [
        ('await self.kernel.remove(self.kernel.components["source"])', exits.DONE),
        ('await self.kernel.contexts["first"].stop()', exits.DONE),
        ('self.kernel.contexts["first"]._end_cycle = None', exits.FAILED),
    ],
)
def test_a_run_whose_source_goes_for_good_before_all_is_started_ends(tmp_path: Path, done: str, status: int) -> None:
    (tmp_path / "going.py").write_text(GOING.format(done=done))
    (tmp_path / "going.toml").write_text(SOURCE_GOES)
    ended = here(tmp_path, "run", "going.toml", "--simulate", "--for", "60")
    assert ended.returncode == status, ended.stderr
    assert "nobody has ended it" not in ended.stderr


@pytest.mark.slow
def test_no_command_returns_a_number_of_its_own() -> None:
    """In functions that click calls, and in what ends the process, a status is a name of the table."""
    faults = []
    for folder in ("aiorts/cli", "aiorts/bench", "plugins/aiorts_log", "plugins/aiorts_flexi"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            for node in nodes(parse(path)):
                if isinstance(node, ast.FunctionDef) and _is_command(node):
                    faults += [f"{path.name}:{one.lineno}" for one in ast.walk(node) if _returns_number(one)]
                elif isinstance(node, ast.Call) and _ends(node):
                    faults += [f"{path.name}:{node.lineno}" for arg in node.args if _is_number(arg)]
    assert faults == []


def _is_command(node: ast.FunctionDef) -> bool:
    return any("command" in ast.unparse(one) for one in node.decorator_list) or node.name in ("execute", "run_command")


def _returns_number(node: ast.AST) -> bool:
    return isinstance(node, ast.Return) and node.value is not None and _is_number(node.value)


def _ends(node: ast.Call) -> bool:
    return dotted(node.func) in ("sys.exit", "os._exit", "SystemExit")


def _is_number(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and type(node.value) is int
