"""`aiorts run --studio`: the page of a run, served by a process of its own.

The process begins before the system is made, so that its address is there before the first sample. It ends with the
run; where a user sits at the terminal it stays while a page shows the run, or none has shown it yet.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from pathlib import Path
from typing import Final
from zlib import crc32

from anyio import to_thread

from aiorts import KernelService, Microkernel, setting
from aiorts.errors import ConfigurationError
from aiorts.late import dataclass
from aiorts.layout import layout_beside

_FIRST: Final = 5.0
"""Seconds for which a run waits at most for the address of its page before its contexts start."""
PORTS: Final = range(20_000, 32_000)
"""The ports of pages of runs, below those that a system gives to clients."""
_LAST: Final = 3.0
"""Seconds within which the process has to end."""


@dataclass(frozen=True, slots=True)
class StudioSettings:
    """Whether the run is shown in a browser."""

    show: bool = setting(False, "Show the run in a browser: print a page's address; it ends with the run.", option="")

    def __post_init__(self) -> None:
        if not isinstance(self.show, bool):
            raise ConfigurationError(f"show: expected true or false, got {self.show!r:.80}")


class StudioBeside(KernelService):
    """Starts `aiorts studio` for this kernel, as a process that ends with it."""

    name = "studio"
    settings = StudioSettings
    last = True

    def __init__(self, kernel: Microkernel) -> None:
        super().__init__(kernel)
        self._process: subprocess.Popen[bytes] | None = None
        self._was_made = False
        self._addressed = threading.Event()

    def configure(self, settings: StudioSettings) -> None:
        if not settings.show or self._process is not None:
            return
        from aiorts.control import Control

        control = self.kernel.attached(Control)
        if control is None or not control.hello:
            raise ConfigurationError("--studio: the run cannot be reached; leave --control off out")
        port = port_of(control.hello["lasting"])
        command = [sys.executable, "-m", "aiorts", "studio", "--beside", "--port", str(port), self.kernel.address]
        if (runs := Path(self.kernel.registry.runs)).is_file():
            command += ["--layout", str(layout_beside(runs))]
        if control.files is not None:
            command += ["--files", str(control.files)]
        # The server ends when its standard input ends: also where this process is killed.
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)  # noqa: S603 # our own
        threading.Thread(target=self._say_address, args=(self._process,), name="aiorts studio", daemon=True).start()

    async def starting(self) -> None:
        self._was_made = True
        await to_thread.run_sync(self._addressed.wait, _FIRST, abandon_on_cancel=True)

    def _say_address(self, process: subprocess.Popen[bytes]) -> None:
        """Print the page's address apart from the system's output; no line comes where the process has failed."""
        if process.stdout is None:
            return
        with process.stdout as said:
            line = said.readline().decode().strip()
        if line and sys.stderr is not None:
            from aiorts_studio.codes import GOOD_ONCE

            sys.stderr.write(f"\n    aiorts studio: {line}\n    {GOOD_ONCE}\n\n")
            sys.stderr.flush()
        self._addressed.set()

    async def leaving(self, budget: object) -> None:
        if not _at_terminal():
            await to_thread.run_sync(self._end)

    def linger(self, status: int) -> None:
        process = self._process
        if process is None or process.stdin is None:
            return
        try:
            if not self._was_made:
                return  # there is nothing to show
            os.write(process.stdin.fileno(), b"%d\n" % status)
            process.wait()
        except BrokenPipeError:
            pass  # it has ended
        finally:
            self._end()

    def _end(self) -> None:
        """End the process. Idempotent."""
        process, self._process = self._process, None
        if process is None or process.stdin is None:
            return
        process.stdin.close()
        try:
            process.wait(_LAST)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def port_of(lasting: str) -> int:
    """The port of a run's page: the same for each run of the same system, so that an open page finds it again."""
    return PORTS.start + crc32(lasting.encode()) % len(PORTS)


def _at_terminal() -> bool:
    """Whether a user may see what this process says, and press Ctrl-C."""
    return all(stream is not None and stream.isatty() for stream in (sys.stdin, sys.stderr))
