"""Imports one extension and says what is wrong with it, as a JSON list: a child of `aiorts plugins --check`.

A process of its own: an import may hang, end the interpreter, write to any stream, or change what others rely on.
"""

from __future__ import annotations

import asyncio
import builtins
import json
import os
import signal
import sys
import tempfile
import time
from pathlib import Path
from typing import Final

from aiorts.errors import PluginError

__all__ = ("main",)

_RELIED_ON: Final = (
    (builtins, ("print", "open", "input", "__import__")),
    (time, ("time", "time_ns", "monotonic", "monotonic_ns", "sleep")),
    (asyncio, ("sleep", "run", "create_task", "get_running_loop", "Task", "Future")),
    (os, ("read", "write", "_exit")),
    (sys, ("stdout", "stderr", "excepthook", "exit")),
)
"""What an import must leave as it is."""


def main(asked: str) -> None:
    """Import what `asked` (kind, name, target, source, folder as JSON) names and write the faults."""
    from aiorts import Extension

    kind, name, target, source, folder = json.loads(asked)
    answer = os.dup(1)
    with tempfile.TemporaryFile() as said:
        os.dup2(said.fileno(), 1)
        os.dup2(said.fileno(), 2)
        before, handlers = _state(), _handlers()
        faults = []
        try:
            Extension(kind, name, target, source, Path(folder) if folder else None).load()
        except PluginError as error:
            faults.append(str(error.__cause__ or error) if error.__cause__ is None else _cause(error.__cause__))
        faults += [f"changes {what}" for what, is_same in _compared(before).items() if not is_same]
        if _handlers() != handlers:
            faults.append("takes signals")
        if os.fstat(said.fileno()).st_size:
            faults.append("writes to standard output or error while it is imported")
    os.write(answer, json.dumps(faults).encode())
    os._exit(0)  # threads that the import has left must not keep us


def _cause(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}"


def _state() -> dict[str, object]:
    return {f"{module.__name__}.{name}": getattr(module, name) for module, names in _RELIED_ON for name in names}


def _compared(before: dict[str, object]) -> dict[str, bool]:
    return {what: value is before[what] for what, value in _state().items()}


def _handlers() -> list[object]:
    return [signal.getsignal(number) for number in sorted(signal.valid_signals())]


if __name__ == "__main__":
    main(sys.argv[1])
