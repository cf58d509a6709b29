"""Imports one extension and says what is wrong with it, as a JSON list in a file: a child of `aiorts plugins --check`.

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
from types import FunctionType
from typing import Any, Final

import aiorts
from aiorts.errors import PluginError

__all__ = ("ANSWER", "main")

ANSWER: Final = "answer"
"""The file in the folder that was named; it is there when the import has come to an end."""
_VALUES: Final = (
    (sys, ("stdout", "stderr", "stdin", "excepthook", "displayhook", "argv", "modules")),
    (asyncio, ("sleep", "run", "create_task")),
    (builtins, ("print", "open", "__import__")),
    (time, ("sleep", "monotonic", "time")),
)
"""What an import must leave as it is, whatever else is looked at."""


def main(asked: str, folder: str) -> None:
    """Import what `asked` (kind, name, target, source, folder as JSON) names and write the faults into `folder`."""
    kind, name, target, source, home = json.loads(asked)
    extension = aiorts.Extension(kind, name, target, source, Path(home) if home else None)
    _ = (aiorts.Component, aiorts.Kernel, aiorts.EventContext)  # loaded before, so that a change of them is seen
    faults: list[str] = []
    with tempfile.TemporaryFile(dir=folder) as said:
        os.dup2(said.fileno(), 1)
        os.dup2(said.fileno(), 2)
        before, handlers, place, search = _callables(), _handlers(), os.getcwd(), list(sys.path)
        try:
            found = extension.load()
        except PluginError as error:
            faults.append(str(error) if error.__cause__ is None else _cause(error.__cause__))
        else:
            faults += _unfit(extension, found)
        faults += [f"changes {what}" for what in _changed(before)[:3]]
        if _handlers() != handlers:
            faults.append("takes signals")
        if os.getcwd() != place:
            faults.append("changes the working directory")
        if sys.path[: len(search)] != search:
            faults.append("puts itself before others in sys.path")
        for stream in (sys.stdout, sys.stderr):
            if stream is not None:
                stream.flush()
        if os.fstat(said.fileno()).st_size:
            faults.append("writes to standard output or error while it is imported")
    part = Path(folder, f"{ANSWER}.part")
    part.write_text(json.dumps(faults), encoding="utf-8")
    part.rename(Path(folder, ANSWER))
    os._exit(0)  # threads that the import has left must not keep us


def _cause(error: BaseException) -> str:
    where = f" ({error.filename}, line {error.lineno})" if isinstance(error, SyntaxError) and error.filename else ""
    text = error.msg if where and isinstance(error, SyntaxError) else str(error)
    return f"{type(error).__name__}: {text}{where}"


def _unfit(extension: aiorts.Extension, found: Any) -> list[str]:
    """What keeps it from being used as what it is offered for."""
    from aiorts.cli.plugin_kinds import fault_of

    fault = fault_of(extension, found)
    return [fault] if fault else []


def _callables() -> dict[str, object]:
    """Every function and class of every module that is loaded, and the methods of ours."""
    found: dict[str, object] = {
        f"{module.__name__}.{name}": getattr(module, name) for module, names in _VALUES for name in names
    }
    for module_name, module in tuple(sys.modules.items()):
        if module_name == __name__:
            continue
        for name, value in tuple(vars(module).items()):
            if not callable(value):
                continue
            found[f"{module_name}.{name}"] = value
            if isinstance(value, type) and value.__module__ == module_name and module_name.startswith("aiorts."):
                methods = [(key, one) for key, one in vars(value).items() if isinstance(one, FunctionType)]
                found.update({f"{module_name}.{name}.{key}": method for key, method in methods})
    return found


def _changed(before: dict[str, object]) -> list[str]:
    after = _callables()
    return [what for what, value in before.items() if what in after and after[what] is not value]


def _handlers() -> list[object]:
    return [signal.getsignal(number) for number in sorted(signal.valid_signals())]


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
