"""Recordings that pages ask for: `aiorts record`, as a process of its own, writes into the folder of --files."""

from __future__ import annotations

import asyncio
import json
import signal
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from aiorts.errors import ControlError

_LAST: Final = 5.0
"""Seconds within which a recording has to end."""
_LONGEST: Final = 64 << 10


class Recorder:
    """One recording at a time.

    Args:
        folder: where files go; None: nothing is recorded.
        why: the text for a page where nothing can be recorded.
        tell: called with messages to pages.
    """

    def __init__(self, folder: Path | None, why: str, tell: Callable[[Mapping[str, Any]], object]) -> None:
        self._folder, self._why, self._tell = folder, why, tell
        self._file = ""
        self._begins = False
        self._process: asyncio.subprocess.Process | None = None
        self._ending: asyncio.Task[None] | None = None

    @property
    def can_record(self) -> bool:
        """Whether there is a folder."""
        return self._folder is not None

    def state(self, why: str = "", samples: int = 0) -> dict[str, Any]:
        """The message with the state of the recording."""
        on = self._process is not None
        why = why or ("" if self.can_record else self._why)
        return {"t": "recording", "on": on, "file": self._file or None, "samples": samples, "why": why}

    async def begin(self, ports: Sequence[tuple[str, str]]) -> None:
        """Record these ports of one kernel: its address, and the path of the port.

        Raises:
            ControlError: there is no folder, a recording goes on, or the ports are of several kernels.
        """
        if self._folder is None:
            raise ControlError(self._why)
        if self._process is not None or self._begins:
            raise ControlError("a recording goes on; end it first")
        kernels = {kernel for kernel, _ in ports}
        if len(kernels) != 1:
            raise ControlError("a recording is of one kernel; choose ports of one")
        kernel = kernels.pop()
        self._file = f"{kernel.rpartition('/')[2]}-{datetime.now(UTC):%Y%m%dT%H%M%SZ}.mcap"
        names = [f"{kernel}/{path}" for _, path in ports]
        target = str(self._folder / self._file)
        self._begins = True
        try:
            self._process = await asyncio.create_subprocess_exec(
                *(sys.executable, "-m", "aiorts", "record", "--json", "-o", target, "--", *names),
                stdin=asyncio.subprocess.DEVNULL,
                stdout=asyncio.subprocess.PIPE,
                stderr=asyncio.subprocess.PIPE,
            )
        finally:
            self._begins = False
        self._ending = asyncio.create_task(self._wait(self._process), name="studio recording")
        self._tell(self.state())

    async def _wait(self, process: asyncio.subprocess.Process) -> None:
        printed, complained = await process.communicate()
        self._process = None
        samples, why = 0, ""
        with suppress(ValueError, KeyError, TypeError):
            samples = int(json.loads(printed[:_LONGEST])["samples"])
        if process.returncode not in (0, -signal.SIGINT, 130):
            why = complained.decode("utf-8", "replace").strip().rpartition("\n")[2][:300]
        self._tell(self.state(why, samples))

    def end(self) -> None:
        """End the recording; its file is whole then, and pages are told."""
        if self._process is not None:
            with suppress(ProcessLookupError):
                self._process.send_signal(signal.SIGINT)

    async def close(self) -> None:
        """End the recording, and wait for its end."""
        self.end()
        process, ending = self._process, self._ending
        if ending is None:
            return
        done, _ = await asyncio.wait((ending,), timeout=_LAST)
        if not done and process is not None:
            with suppress(ProcessLookupError):
                process.kill()
            await asyncio.wait((ending,))
