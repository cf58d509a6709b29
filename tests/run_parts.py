"""Real runs of the command line for tests: processes with pipes or on a terminal, commands in this process."""

from __future__ import annotations

import contextlib
import gc
import os
import select
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from aiorts.cli.app import run_command
from aiorts.kernel.extensions.catalogue import Catalogue
from aiorts.kernel.extensions.finders import offer_from

COMPONENTS = '''
import time
from aiorts import Component, InPort, OutPort, Param
from aiorts.types import TimedLong

class Counter(Component):
    """Sends `count` numbers and finishes."""
    out = OutPort(TimedLong)
    count = Param(3)
    n = 0
    async def on_execute(self):
        await self.out.write(TimedLong(0, self.n))
        self.log.debug("wrote %s", self.n)
        self.n += 1
        if self.n == self.count:
            self.finish()
    def on_deactivated(self):
        print("wrote", self.n, "in", self.contexts[0].kind, self.contexts[0].rate, flush=True)

class Sink(Component):
    """Fails at the number `limit`."""
    numbers = InPort(TimedLong)
    limit = Param(-1)
    def on_activated(self):
        self.log.info("ready")
        self.log.debug("quite ready")
        print("ready", flush=True)
    def on_execute(self):
        for sample in self.numbers.drain():
            if sample.data == self.limit:
                raise ValueError("too much")
    def on_deactivated(self):
        print("stopped in", self.contexts[0].kind, flush=True)

class Blocked(Component):
    def on_execute(self):
        print("ready", flush=True)
        while True:
            time.sleep(0.01)

class BlockedInC(Component):
    """Holds the interpreter lock: nothing of Python runs."""
    def on_execute(self):
        import ctypes
        print("ready", flush=True)
        ctypes.PyDLL(None).sleep(3)
        self.finish()
        self.kernel.request_stop()

class Slow(Component):
    """Takes its time at every hook on its way."""
    def on_initialize(self):
        time.sleep(0.3)
    async def on_activated(self):
        await self.sleep(0.3)
        print("ready", flush=True)
    async def on_deactivated(self):
        await self.sleep(0.3)
    def on_finalize(self):
        time.sleep(0.3)

class Talker(Component):
    n = 0
    def on_execute(self):
        self.n += 1
        self.log.warning(f"line {self.n}")
'''

SYSTEM = """
schema = 1
[components.counter]
type = "parts.py:Counter"
params.count = 1000000
[components.sink]
type = "parts.py:Sink"
[[connections]]
from = "counter.out"
to = "sink.numbers"
[contexts.fast]
kind = "periodic"
rate = 100.0
members = ["counter"]
[contexts.slow]
kind = "event"
members = ["sink"]
"""


def folder_of(path: Path) -> Path:
    """The folder with the components and the system."""
    (path / "parts.py").write_text(COMPONENTS)
    (path / "system.toml").write_text(SYSTEM)
    return path


def aiorts(folder: Path, *arguments: str, **options: Any) -> subprocess.CompletedProcess[str]:
    """A command, run to its end in the folder."""
    options = {"capture_output": True, "stdin": subprocess.DEVNULL, "text": True, "timeout": 30} | options
    return subprocess.run([sys.executable, "-m", "aiorts", *arguments], check=False, cwd=folder, **options)


def here(*arguments: str | Path, stdin: str | bytes = "", **environment: str) -> subprocess.CompletedProcess[Any]:
    """A command, run to its end in this process, on streams of its own.

    Where text and exit status are what is promised, a process would show no more and take ten times as long. A path as
    the first argument is the folder to run in. What the command prints is text, or bytes where its input is.
    """
    words = [str(argument) for argument in arguments]
    with contextlib.ExitStack() as stack:
        stack.enter_context(_as_if_just_begun())
        if isinstance(arguments[0], Path):
            sys.path.insert(0, words.pop(0))
            stack.enter_context(contextlib.chdir(sys.path[0]))
        before = dict(os.environ)
        stack.callback(lambda: (os.environ.clear(), os.environ.update(before)))
        os.environ.update({"COLUMNS": "120", "AIORTS_PLUGINS": ""} | environment)
        files = [stack.enter_context(tempfile.TemporaryFile()) for _ in range(3)]
        files[0].write(stdin.encode() if isinstance(stdin, str) else stdin)
        files[0].seek(0)
        with _streams([file.fileno() for file in files]):
            status = run_command(words)
        said = []
        for file in files[1:]:
            file.seek(0)
            said.append(file.read())
        if isinstance(stdin, bytes):
            return subprocess.CompletedProcess(words, status, *said)
        return subprocess.CompletedProcess(words, status, *(data.decode() for data in said))


@contextlib.contextmanager
def _as_if_just_begun() -> Iterator[None]:
    """Forget what another command has found, and then what this one has imported from elsewhere than the path."""
    Catalogue._default = None
    offer_from(None)
    gc.freeze()  # a run collects what it begins with: not all that the test session holds
    modules, path = set(sys.modules), list(sys.path)
    try:
        yield
    finally:
        gc.unfreeze()
        sys.path[:] = path
        for name in set(sys.modules) - modules:
            file = getattr(sys.modules[name], "__file__", None)
            if file and not file.startswith(tuple(filter(None, path))):
                del sys.modules[name]


@contextlib.contextmanager
def _streams(descriptors: list[int]) -> Iterator[None]:
    """Put the files in the place of the three standard streams, for Python and for the system."""
    names = ("stdin", "stdout", "stderr")
    streams = [getattr(sys, name) for name in names]
    for stream in streams[1:]:
        stream.flush()
    kept = [os.dup(number) for number in range(3)]
    for number, descriptor in enumerate(descriptors):
        os.dup2(descriptor, number)
    ours = [os.fdopen(number, mode, encoding="utf-8", closefd=False) for number, mode in enumerate(("r", "w", "w"))]
    try:
        for name, stream in zip(names, ours, strict=True):
            setattr(sys, name, stream)
        yield
    finally:
        for name, stream, mine in zip(names, streams, ours, strict=True):
            mine.close()
            setattr(sys, name, stream)
        for number, descriptor in enumerate(kept):
            os.dup2(descriptor, number)
            os.close(descriptor)


@contextlib.contextmanager
def limited(*processes: subprocess.Popen[Any], seconds: float = 40.0) -> Iterator[None]:
    """End the processes by force when the block has not ended by then, or fails.

    What is read of a process that says nothing ends with it: one test fails, and not the whole run at its time limit.
    """

    def end() -> None:
        for process in processes:
            process.kill()

    timer = threading.Timer(seconds, end)
    timer.start()
    try:
        yield
    except BaseException:
        end()
        raise
    finally:
        timer.cancel()
        timer.join()


def started(folder: Path, *arguments: str, **options: Any) -> subprocess.Popen[str]:
    """A run that has said that it is ready."""
    process = begun(folder, *arguments, **options)
    with limited(process):
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
    return process


def begun(folder: Path, *arguments: str, **options: Any) -> subprocess.Popen[str]:
    """A run that has just begun."""
    command = [sys.executable, "-m", "aiorts", "run", *arguments]
    pipes = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen(command, text=True, cwd=folder, **(pipes | options))


class Terminal:
    """A run whose standard error, and what else is asked for, is a terminal; `text` is what it showed so far."""

    def __init__(self, folder: Path, *arguments: str, stdin: bool = False, env: dict[str, str] | None = None) -> None:
        import pty

        self._ours, theirs = pty.openpty()
        self.text = ""
        self.process = subprocess.Popen(
            [sys.executable, "-m", "aiorts", "run", *arguments],
            stdin=theirs if stdin else subprocess.DEVNULL,
            stdout=theirs,
            stderr=theirs,
            cwd=folder,
            env={**os.environ, "TERM": "xterm", "NO_COLOR": "1", **(env or {})},
        )
        os.close(theirs)

    def __enter__(self) -> Terminal:
        return self

    def __exit__(self, *error: object) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        os.close(self._ours)

    def wait_for(self, text: str, seconds: float = 20) -> None:
        """Read until the terminal showed `text`, which is taken from what it shows next."""
        until = time.monotonic() + seconds
        while text not in self.text:
            assert time.monotonic() < until, self.text
            assert self._read(), self.text

    def write(self, text: str) -> None:
        """Type."""
        os.write(self._ours, text.encode())

    def send(self, number: signal.Signals) -> None:
        """A signal."""
        self.process.send_signal(number)

    def end(self) -> int:
        """Read to the end; the exit status."""
        with limited(self.process):
            while self._read():
                pass
        return self.process.wait(timeout=20)

    def _read(self) -> bool:
        if not select.select([self._ours], [], [], 20)[0]:
            return False
        try:
            data = os.read(self._ours, 65536)
        except OSError:  # all who had the other end have gone
            return False
        self.text += data.decode()
        return bool(data)
