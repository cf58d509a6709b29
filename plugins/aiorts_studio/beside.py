"""`aiorts run --studio`: the page of a run, served by a process beside it that ends with it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Final

from anyio import to_thread

from aiorts import KernelService, Microkernel, setting
from aiorts.errors import ConfigurationError
from aiorts.late import dataclass
from aiorts.layout_file import layout_beside

_LAST: Final = 3.0
"""Seconds that the process has to end in."""


@dataclass(frozen=True, slots=True)
class StudioSettings:
    """Whether the run is shown in a browser."""

    show: bool = setting(False, "Serve a page that shows the run, from a process beside it.", option="")

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
        self._show = False
        self._process: subprocess.Popen[bytes] | None = None

    def configure(self, settings: StudioSettings) -> None:
        self._show = settings.show

    def started(self) -> None:
        if not self._show or self._process is not None:
            return
        if not self.kernel.address:
            raise ConfigurationError("--studio: the run cannot be reached; leave --control off out")
        command = [sys.executable, "-m", "aiorts", "studio", "--beside", self.kernel.address]
        if (runs := Path(self.kernel.registry.runs)).is_file():
            command += ["--layout", str(layout_beside(runs))]
        # It ends when its standard input does: also where this process is killed. What it prints is not the system's.
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=2)  # noqa: S603 # our own command

    async def leaving(self, budget: object) -> None:
        process, self._process = self._process, None
        if process is not None and process.stdin is not None:
            process.stdin.close()
            await to_thread.run_sync(_end, process)


def _end(process: subprocess.Popen[bytes]) -> None:
    try:
        process.wait(_LAST)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
