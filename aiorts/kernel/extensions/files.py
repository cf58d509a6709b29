"""Loads a Python file once, whether it was named as a file or as a module, so that each class in it exists once.

A file that lies in a package is that module of it. Any other one has a name of its own: two folders may have an
`odometry.py` each. Modules in its folder can be imported.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import sys
import threading
import zlib
from types import FunctionType, ModuleType
from typing import TYPE_CHECKING, Any, Final

from aiorts.errors import PluginError

if TYPE_CHECKING:
    from pathlib import Path

INSTALL: Final = "install it, or go to the folder that it lies in"
"""The remedy where a module is not found."""
_FILES: Final[dict[str, str]] = {}
"""The name of the module that each file was loaded as."""
_MADE: Final[set[str]] = set()
"""Folders that were made importable here."""
_ALONE: Final = "aiorts_system."
"""The beginning of the name of a module that is a file by itself."""
_LOCK: Final = threading.Lock()
_LOCKS: Final[dict[str, threading.RLock]] = {}
"""A lock for each file: an import that never ends holds up no other."""


def load_file(path: Path, root: Path | None = None) -> ModuleType:
    """The module of a file.

    Args:
        root: the folder that may be made importable for it, and none above; its own by default.

    Raises:
        PluginError: a module that it took for one of its folder is one of another folder. BaseException: as its
            import.
    """
    path = path.resolve()
    with _lock_of(str(path)):  # one that is being imported by another thread is waited for, not taken half done
        module = _loaded(str(path))
        if module is None:
            module = _of_package(path, path.parent if root is None else root.resolve()) or _by_itself(path)
            _FILES[str(path)] = module.__name__
        return module


def load_module(name: str) -> ModuleType:
    """The module of this name; if its file was loaded as a file before, that.

    Raises:
        BaseException: whatever its import does.
    """
    file = file_of_module(name)
    if not file:
        return importlib.import_module(name)
    with _lock_of(file):
        module = _loaded(file) or importlib.import_module(name)
        _FILES[file] = module.__name__
        return module


def package_of(path: Path) -> tuple[str, Path]:
    """The name of a file as a module of the packages that it lies in, and the folder in which the outermost one is."""
    names = [] if path.stem == "__init__" else [path.stem]
    folder = path.parent
    while folder.name.isidentifier() and (folder / "__init__.py").is_file():
        names.insert(0, folder.name)
        folder = folder.parent
    return ".".join(names), folder


def is_importable(top: str) -> bool:
    """Whether Python finds a module of this name, which has no dot in it."""
    try:
        return importlib.util.find_spec(top) is not None
    except (ImportError, ValueError):
        return top in sys.modules


def is_found_by_python(module: ModuleType) -> bool:
    """Whether Python imports this module by its name, without a folder that was made importable here."""
    file = _real(getattr(module, "__file__", None))
    if not file or module.__name__.startswith(_ALONE):
        return False
    home = os.path.dirname(file)
    for _ in range(module.__name__.count(".") + (os.path.basename(file) == "__init__.py")):
        home = os.path.dirname(home)
    return all(os.path.realpath(made) != home for made in _MADE)


def make_importable(folder: Path) -> None:
    """Add a folder to the end of Python's path: a plugin's `json.py` must not take the place of Python's."""
    for place in (folder.absolute() / "src", folder.absolute()):
        if place.is_dir() and str(place) not in sys.path:
            sys.path.append(str(place))
            _MADE.add(str(place))


def is_loaded(path: Path) -> bool:
    """Whether a file was loaded as a module already."""
    return _loaded(_real(str(path))) is not None


def _loaded(file: str) -> ModuleType | None:
    """The module that a file was loaded as, unless that has another file by now."""
    module = sys.modules.get(_FILES.get(file, ""))
    return module if module is not None and _real(getattr(module, "__file__", None)) == file else None


def file_of_module(name: str) -> str:
    """The Python file of a module; "" where there is none. It imports the packages above it."""
    try:
        spec = importlib.util.find_spec(name)
    except (ImportError, ValueError):  # a package above it is missing; it is there, without a specification
        return ""
    return "" if spec is None or not spec.has_location else _real(spec.origin)


def _real(file: Any) -> str:
    return os.path.realpath(file) if isinstance(file, str) and file.endswith(".py") else ""


def _of_package(path: Path, root: Path) -> ModuleType | None:
    """The module of a package, as which Python finds this very file; None for a file by itself."""
    name, home = package_of(path)
    if home == path.parent:
        return None
    if home.is_relative_to(root) and not is_importable(name.partition(".")[0]):
        make_importable(home)
    if not is_importable(name.partition(".")[0]) or file_of_module(name) != str(path):
        return None  # out of reach, or another package of this name comes first
    return importlib.import_module(name)


def _by_itself(path: Path) -> ModuleType:
    make_importable(path.parent)
    # A folder's name may be any bytes; that of a module goes into recordings and messages, which are UTF-8.
    name = os.fsencode(f"{_ALONE}{path.parent.name}.{path.stem}").decode(errors="replace")
    for taken in (name, f"{name}_{zlib.crc32(os.fsencode(path)):08x}"):
        loaded = sys.modules.get(taken)
        if loaded is None:
            return _executed(taken, path)
        if loaded.__file__ == str(path):
            return loaded
    raise ImportError(f"{path}: another module has its name {name}")


def _executed(name: str, path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ImportError(f"{path} is no Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # before it runs: dataclasses look themselves up there
    try:
        spec.loader.exec_module(module)
        _check_beside(module, path.parent)
    except BaseException:
        del sys.modules[name]
        raise
    return module


def _check_beside(module: ModuleType, folder: Path) -> None:
    """Refuse a module of another such folder, where one of that name lies in the folder of the file."""
    taken = [value for value in vars(module).values() if isinstance(value, ModuleType | FunctionType | type)]
    names = {value.__name__ if isinstance(value, ModuleType) else value.__module__ for value in taken}
    for name in names:
        file = _real(getattr(sys.modules.get(name), "__file__", None))
        beside = folder / os.path.basename(file)
        if file and file != str(beside) and os.path.dirname(file) in _MADE and beside.is_file() and "." not in name:
            raise PluginError(f"its module {name!r} comes from {file}, loaded before; load {beside} in another process")


def _lock_of(file: str) -> threading.RLock:
    with _LOCK:
        return _LOCKS.setdefault(file, threading.RLock())
