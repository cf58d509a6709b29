"""Import extensions, each in a process of its own and within a time limit, and report the results.

A child reports in a file, not through a pipe: a process that the import started may keep a pipe open without end.
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
from aiorts.cli.commands.plugin_child import ANSWER, END, HOME

_AT_ONCE: Final = 4
_LONGEST_START: Final = 30.0
"""Seconds for the start of a child's interpreter; a slow start is no fault of the plugin."""
_LOOKS: Final = 0.02


def verdicts(extensions: Iterable[Extension], limit: float) -> list[tuple[str, str]]:
    """Import extensions; returns for each "ok" or its faults, and the imported file, "" where there is none.

    Args:
        limit: seconds for each import.
    """
    running: set[subprocess.Popen[bytes]] = set()
    with tempfile.TemporaryDirectory(prefix="aiorts-") as folder, ThreadPoolExecutor(_AT_ONCE) as pool:
        try:
            requested = [
                pool.submit(_verdict, one, limit, Path(folder) / str(number), running)
                for number, one in enumerate(extensions)
            ]
            return [one.result() for one in requested]
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
            for child in tuple(running):  # after an interrupt no result is needed any more
                _end(child)


def _verdict(
    extension: Extension, limit: float, folder: Path, running: set[subprocess.Popen[bytes]]
) -> tuple[str, str]:
    folder.mkdir()
    requested = [extension.kind, extension.name, extension.target, extension.source, str(extension.folder or "")]
    child = subprocess.Popen(  # noqa: S603 - this interpreter; the user requested the import
        [sys.executable, "-P", "-m", "aiorts.cli.commands.plugin_child", json.dumps(requested), str(folder)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=os.name == "posix",  # a process group of its own, so that all its processes can be ended
    )
    running.add(child)
    try:
        status = _awaited(child, limit, folder / HOME)
    finally:
        _end(child)
        running.discard(child)
    late = f"still being imported after {limit:g} s"
    return late if status is None else _answer_of(folder / ANSWER, status), _read(folder / HOME)


def _awaited(child: subprocess.Popen[bytes], limit: float, begins: Path) -> int | None:
    """Wait for the exit status; None if the import does not end in time after the file `begins` was made."""
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
    """End the child and all processes that it has started."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        if os.name == "posix":
            os.killpg(child.pid, signal.SIGKILL)
        else:
            child.kill()
    child.wait()


def _answer_of(answer: Path, status: int) -> str:
    *faults, end = _read(answer).split("\0")
    if end == END:
        return "; ".join(faults) or "ok"
    if status >= 0:
        return f"ended the interpreter with status {status}"
    names = {number.value: number.name for number in signal.Signals}
    return f"ended the interpreter by {names.get(-status, f'signal {-status}')}"
