"""From `package.module:Class`, `file.py:Class` or an installed name to the class, or to what may have been meant."""

from __future__ import annotations

import importlib
import os
import pkgutil
import sys
from difflib import get_close_matches
from pathlib import Path

from aiorts import Catalogue, Component, Extension
from aiorts.errors import PluginError

__all__ = ("component_class",)


def component_class(text: str, catalogue: Catalogue) -> type[Component]:
    """The class that `text` names.

    Raises:
        PluginError: there is none, or its module cannot be loaded; near names are given.
    """
    if ":" not in text:
        return catalogue.find("components", text).load_class(Component)
    home, _, name = (part.strip() for part in text.rpartition(":"))
    if not home or not name.isidentifier():
        raise PluginError(f"{text[:80]!r}: expected MODULE:COMPONENT or FILE.py:COMPONENT, such as parts.py:Counter")
    folder, target = _place(home)
    extension = Extension("components", name, f"{target}:{name}", "the command line", folder)
    try:
        found = extension.load()
    except PluginError as error:
        raise PluginError(_why(text, home, target, name, error)) from error.__cause__
    if not (isinstance(found, type) and issubclass(found, Component)):
        raise PluginError(f"{text[:80]}: {name} is no class derived from Component; {_offers(found, home, target)}")
    return found


def _place(home: str) -> tuple[Path | None, str]:
    """The folder of a file and its name; or the module, to be looked for in the current folder, too, and there last."""
    if home.endswith(".py"):
        path = Path(home)
        if not path.is_file():
            near = get_close_matches(path.name, [other.name for other in path.parent.glob("*.py")], n=1)
            hint = f"did you mean {str(path.parent / near[0])!r}?" if near else "it is counted from the current folder"
            raise PluginError(f"no file {home[:120]!r}; {hint}")
        path = path.resolve()
        return path.parent, path.name
    try:
        here = os.getcwd()
    except OSError:  # it was deleted
        return None, home
    if here not in sys.path and "" not in sys.path:
        sys.path.append(here)
    return None, home


def _why(text: str, home: str, target: str, name: str, error: PluginError) -> str:
    cause = error.__cause__
    if isinstance(cause, ModuleNotFoundError) and cause.name and f"{home}.".startswith(f"{cause.name}."):
        return f"{text[:80]}: no module named {cause.name[:80]!r}; {_near_module(cause.name)}"
    if isinstance(cause, AttributeError) and getattr(cause, "name", None) == name:
        return f"{text[:80]}: {home} has no {name!r}; {_offers(cause.obj, home, target, name)}"
    if cause is None:
        return f"{text[:80]}: {error}"
    reason = f"{type(cause).__name__}: {cause}" if str(cause) else type(cause).__name__
    return f"{text[:80]}: {_line_in(cause, home)} cannot be loaded: {reason}"


def _near_module(name: str) -> str:
    parent, _, last = name.rpartition(".")
    try:
        paths = list(importlib.import_module(parent).__path__) if parent else None
    except (ImportError, AttributeError):
        paths = None
    if parent and paths is None:
        return f"{parent!r} is no package"
    known = {module.name for module in pkgutil.iter_modules(paths)}
    near = get_close_matches(last, known, n=1)
    prefix = f"{parent}." if parent else ""
    return f"did you mean {prefix}{near[0]}?" if near else "install it, or go to the folder that it lies in"


def _offers(found: object, home: str, target: str, wanted: str = "") -> str:
    """What may have been meant, among the components of the module."""
    module = found if hasattr(found, "__spec__") else sys.modules.get(target)
    values = {} if module is None else vars(module)
    names = [
        name
        for name, value in values.items()
        if isinstance(value, type) and issubclass(value, Component) and value is not Component
    ]
    near = get_close_matches(wanted, names, n=1)
    return f"did you mean {near[0]!r}?" if near else f"it has {', '.join(names[:10]) or 'no component'}"


def _line_in(error: BaseException, home: str) -> str:
    """The file, and the line of it that the error came from."""
    line = error.lineno if isinstance(error, SyntaxError) else None
    trace = error.__traceback__
    while trace is not None:
        file = trace.tb_frame.f_code.co_filename
        if os.path.basename(file) == os.path.basename(home) or file.endswith(f"{home.replace('.', os.sep)}.py"):
            line = trace.tb_lineno
        trace = trace.tb_next
    return home if line is None else f"{home}, line {line}"
