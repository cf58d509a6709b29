"""Imports extensions each in a process of its own, within a time limit: whatever it does there, it is only reported.

What a child has to say comes in a file, not a pipe: a process that the import has started may hold a pipe for ever.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Final

from aiorts import Extension
from aiorts.cli.plugin_child import ANSWER, END, HOME

__all__ = ("verdicts",)

_AT_ONCE: Final = 4
_LONGEST_START: Final = 30.0
"""Seconds until the interpreter of a child must be there; they are no fault of the plugin."""
_LOOKS: Final = 0.02


def verdicts(extensions: Iterable[Extension], limit: float) -> list[tuple[str, str]]:
    """For each "ok", or what is wrong with it, and the file that was imported, "" when there is none.

    Args:
        limit: seconds that each import may take.
    """
    running: set[subprocess.Popen[bytes]] = set()
    with tempfile.TemporaryDirectory(prefix="aiorts-") as folder, ThreadPoolExecutor(_AT_ONCE) as pool:
        try:
            asked = [
                pool.submit(_verdict, one, limit, Path(folder) / str(number), running)
                for number, one in enumerate(extensions)
            ]
            return [one.result() for one in asked]
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
            for child in tuple(running):  # interrupted: nobody waits for these any more
                _end(child)


def _verdict(
    extension: Extension, limit: float, folder: Path, running: set[subprocess.Popen[bytes]]
) -> tuple[str, str]:
    folder.mkdir()
    asked = [extension.kind, extension.name, extension.target, extension.source, str(extension.folder or "")]
    child = subprocess.Popen(  # noqa: S603 - this interpreter; what it imports is the user's own wish
        [sys.executable, "-m", "aiorts.cli.plugin_child", json.dumps(asked), str(folder)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=os.name == "posix",  # a group of its own, which is ended with it
    )
    running.add(child)
    try:
        status = _awaited(child, limit, folder / HOME)
    finally:
        _end(child)
        running.discard(child)
    late = f"still being imported after {limit:g} s"
    return late if status is None else _told(folder / ANSWER, status), _read(folder / HOME)


def _awaited(child: subprocess.Popen[bytes], limit: float, begins: Path) -> int | None:
    """The exit status; None when the import, which begins with that file, has not come to an end in time."""
    until = time.monotonic() + _LONGEST_START + limit
    begun = False
    while (status := child.poll()) is None and time.monotonic() < until:
        if not begun and begins.exists():
            begun, until = True, time.monotonic() + limit
        time.sleep(_LOOKS)
    return status


def _read(file: Path) -> str:
    with contextlib.suppress(OSError, ValueError):
        return file.read_text(encoding="utf-8")
    return ""


def _end(child: subprocess.Popen[bytes]) -> None:
    """End the child and all that it has started."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        if os.name == "posix":
            os.killpg(child.pid, signal.SIGKILL)
        else:
            child.kill()
    child.wait()


def _told(answer: Path, status: int) -> str:
    *faults, end = _read(answer).split("\0")
    if end == END:
        return "; ".join(faults) or "ok"
    if status >= 0:
        return f"ended the interpreter with status {status}"
    names = {number.value: number.name for number in signal.Signals}
    return f"ended the interpreter by {names.get(-status, f'signal {-status}')}"
