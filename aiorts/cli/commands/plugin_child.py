"""Import one extension and write its faults into a file: a child process of `aiorts plugins --check`.

An import may hang, end the interpreter, write to any stream, or change shared state; here it harms nothing else.
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
from importlib.machinery import PathFinder
from pathlib import Path
from typing import Final

import aiorts
from aiorts.errors import PluginError
from aiorts.kernel.extensions.loading import cause_of

ANSWER: Final = "answer"
"""The file in the given folder with the faults and `END`, separated by NUL characters."""
END: Final = "."
HOME: Final = "home"
"""The file in the given folder that names the module's file; it is written before the import begins."""
_VALUES: Final = (
    (sys, ("stdout", "stderr", "stdin", "excepthook", "displayhook", "argv", "modules")),
    (asyncio, ("sleep", "run", "create_task")),
    (builtins, ("print", "open", "__import__")),
    (time, ("sleep", "monotonic", "time")),
)
"""Values that an import must not change."""


def main(requested: str, folder: str) -> None:
    """Import the extension in `requested` (JSON: kind, name, target, source, folder); write its faults to `folder`."""
    kind, name, target, source, home = json.loads(requested)
    extension = aiorts.Extension(kind, name, target, source, Path(home) if home else None)
    _ = (aiorts.Component, aiorts.Kernel, aiorts.EventContext)  # loaded first, so that changes to them are noticed
    Path(folder, HOME).write_text(_home(extension), encoding="utf-8", errors="backslashreplace")
    answer = os.open(Path(folder, ANSWER), os.O_WRONLY | os.O_CREAT)
    write, leave = os.write, os._exit  # bound now, since the import may replace them
    faults: list[str] = []
    with tempfile.TemporaryFile(dir=folder) as printed:
        os.dup2(printed.fileno(), 1)
        os.dup2(printed.fileno(), 2)
        before, handlers, place, search = _callables(), _handlers(), os.getcwd(), list(sys.path)
        try:
            found = extension.load()
        except PluginError as error:
            faults.append(str(error) if error.__cause__ is None else cause_of(error.__cause__))
        else:
            from aiorts.cli.commands.plugin_kinds import fault_of

            faults += filter(None, [fault_of(extension, found)])
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
        if os.fstat(printed.fileno()).st_size:
            faults.append("writes to standard output or error while it is imported")
    write(answer, "\0".join((*faults, END)).encode("utf-8", "backslashreplace"))
    leave(0)  # at once: threads of the import must not keep the process alive


def _home(extension: aiorts.Extension) -> str:
    """The file that will be imported, as far as known without an import; "" when unknown."""
    module = extension.target.partition(":")[0].strip()
    if extension.folder is not None and module.endswith(".py"):
        return str(extension.folder / module)
    top, *below = module.split(".")
    folders = [] if extension.folder is None else [str(extension.folder / "src"), str(extension.folder)]
    try:
        spec = PathFinder.find_spec(top, [*folders, *sys.path])
        origin = Path(spec.origin) if spec is not None and spec.origin else None
    except (ImportError, ValueError, OSError):
        return ""
    if origin is None or not below:
        return str(origin or "")
    place = origin.parent.joinpath(*below)
    return next((str(file) for file in (place.with_suffix(".py"), place / "__init__.py") if file.exists()), str(origin))


_METHODS: Final = (property, classmethod, staticmethod)


def _callables() -> dict[str, object]:
    """Every function and class of every loaded module, and the methods of aiorts' classes."""
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
                _ = value.__init__  # type: ignore[misc] # lets a late dataclass make its methods now
                methods = [(key, one) for key, one in vars(value).items() if callable(one) or isinstance(one, _METHODS)]
                found.update({f"{module_name}.{name}.{key}": method for key, method in methods})
    return found


def _changed(before: dict[str, object]) -> list[str]:
    after = _callables()
    changed = [what for what, value in before.items() if what in after and after[what] is not value]
    return changed + [what for what in after.keys() - before.keys() if what.rpartition(".")[0] in before]


def _handlers() -> list[object]:
    return [signal.getsignal(number) for number in sorted(signal.valid_signals())]


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
