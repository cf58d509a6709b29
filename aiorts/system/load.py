"""From a system file to classes: finds the type of each component and checks every parameter; it creates nothing.

A type written `file.py:Class` is loaded from a file below the system file's folder, under a module name of its own, so
that two systems can have an `odometry.py` each. All other types come from installed packages by their name.
"""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path
from types import ModuleType
from typing import Any

from aiorts.errors import ConfigurationError, PluginError, SystemFileError
from aiorts.kernel.catalogue import Catalogue
from aiorts.kernel.component import Component
from aiorts.kernel.plugins import load_extension, load_file
from aiorts.model.configuration import validate
from aiorts.system.parse import LARGEST, parse
from aiorts.system.values import ComponentEntry, SystemFile

__all__ = ("component_type", "load", "parameters")


def load(path: str | Path, overrides: Iterable[str] = ()) -> SystemFile:
    """The system file at `path`, read and checked; nothing is loaded or created yet.

    Args:
        overrides: parameters as "component.param=value", which win over those of the file.

    Raises:
        SystemFileError: it cannot be read, is no system file, or refers to something that is not there.
    """
    where = Path(path)
    try:
        with where.open("rb") as file:
            data = file.read(LARGEST + 1)
    except OSError as error:
        raise SystemFileError(f"{where}: cannot be read: {error.strerror or error}") from None
    except ValueError as error:
        raise SystemFileError(f"{str(where)!r}: cannot be read: {error}") from None
    if len(data) > LARGEST:
        raise SystemFileError(f"{where}: larger than {LARGEST} bytes; a system file is not")
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise SystemFileError(f"{where}, line {line}: not UTF-8; save the file with that encoding") from None
    return parse(text, where, overrides)


def component_type(system: SystemFile, entry: ComponentEntry, catalogue: Catalogue) -> type[Component]:
    """The class of a component.

    Raises:
        SystemFileError: there is no such file or class.
        PluginError: no package offers it, or its file cannot be loaded.
    """
    where = f"{system.path}: components.{entry.name}.type"
    if ":" not in entry.type:
        try:
            found = load_extension("components", entry.type, catalogue)
        except PluginError as error:
            raise PluginError(f"{where}: {error}") from error.__cause__
    else:
        name, _, attribute = entry.type.partition(":")
        module = _module(system, name, where)
        found = getattr(module, attribute, None)
        if found is None:
            raise SystemFileError(f"{where}: {name} has no class {attribute!r}{_hint(attribute, module)}")
    if not (isinstance(found, type) and issubclass(found, Component)):
        raise SystemFileError(f"{where}: {entry.type} is no class derived from Component")
    return found


def parameters(system: SystemFile, entry: ComponentEntry, cls: type[Component]) -> dict[str, Any]:
    """The parameters of a component, converted and checked; a relative path in the file is counted from its folder.

    Raises:
        ConfigurationError: names every one that does not exist or is not allowed.
    """
    specs = cls._rt_parameter_specs
    given: dict[str, Any] = dict(entry.params)
    for name, value in given.items():
        spec = specs.get(name)
        if spec is not None and spec.type is Path and isinstance(value, str) and value:
            given[name] = str(system.folder / value)
    for override in system.overrides:
        if override.component == entry.name:
            given[override.param] = override.value
    try:
        return validate(specs, given, owner=entry.name)
    except ConfigurationError as error:
        raise ConfigurationError(f"{system.path}: {error}") from None


def _module(system: SystemFile, name: str, where: str) -> ModuleType:
    path = _file(system, name, where)
    try:
        return load_file(path)
    except BaseException as error:  # a plugin's border: whatever its import does is reported as the plugin's
        if isinstance(error, KeyboardInterrupt):
            raise
        raise PluginError(
            f"{where}: {_place(error, path)} cannot be loaded: {type(error).__name__}: {error}"
        ) from error


def _file(system: SystemFile, name: str, where: str) -> Path:
    if not name.endswith(".py"):
        raise SystemFileError(f"{where}: {name!r}: expected FILE.py:Class, or the name of an installed type")
    root = system.folder.resolve()
    for folder in system.plugin_paths:
        path = (folder / name).resolve()
        if not path.is_relative_to(root):
            raise SystemFileError(f"{where}: {name!r} is outside the system file's folder; move the file below it")
        if path.is_file():
            return path
    near = get_close_matches(
        Path(name).name, sorted({file.name for folder in system.plugin_paths for file in folder.glob("*.py")}), n=1
    )
    raise SystemFileError(f"{where}: no file {name!r} below {root}{f'; did you mean {near[0]!r}?' if near else ''}")


def _place(error: BaseException, path: Path) -> str:
    """The file and the line of it that the error came from."""
    line = error.lineno if isinstance(error, SyntaxError) else None
    trace = error.__traceback__
    while trace is not None:
        if trace.tb_frame.f_code.co_filename == str(path):
            line = trace.tb_lineno
        trace = trace.tb_next
    return str(path) if line is None else f"{path}, line {line}"


def _hint(attribute: str, module: ModuleType) -> str:
    names = [name for name, value in vars(module).items() if isinstance(value, type) and issubclass(value, Component)]
    names = [name for name in names if name != "Component"]
    near = get_close_matches(attribute, names, n=1)
    return f"; did you mean {near[0]!r}?" if near else f"; it has {', '.join(names) or 'no component'}"
