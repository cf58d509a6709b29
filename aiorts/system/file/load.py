"""Loads the classes of a system file: finds the type of each component and checks every parameter; it creates nothing.

A type is `FILE.py:Class`, of a file below the system file's folder, `package.module:Class` or a name that a plugin
offers (`kernel/extensions/type_names.py`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import partial
from itertools import islice
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, TypeAlias

from aiorts.errors import AiortsError, ConfigurationError, PluginError, SystemFileError
from aiorts.kernel.component import Component
from aiorts.kernel.declarations import declarations
from aiorts.kernel.execution.context import Context
from aiorts.kernel.extensions.catalogue import Catalogue, Extension
from aiorts.kernel.extensions.converters import converter_extension, converter_of
from aiorts.kernel.extensions.type_names import extension_of, shown
from aiorts.model.configuration.parameters import ParameterSpec, validate
from aiorts.model.configuration.sets import DEFAULT, ConfigurationState
from aiorts.model.converter import Converter
from aiorts.model.wanted.entries import ComponentEntry, ConnectionEntry
from aiorts.planning import ACTIVE, Setting
from aiorts.spelling import suggestion
from aiorts.system.expansion.choices import AS_WRITTEN, Choices
from aiorts.system.file.arguments import flag_of, parse_options
from aiorts.system.file.parse import parse
from aiorts.system.file.values import SystemFile
from aiorts.system.text.places import Key
from aiorts.system.text.toml import read_text

_MOST_FILES: Final = 10_000
Fault: TypeAlias = tuple[Key, str, AiortsError]
"""The key of a fault, its place as text if that is no key of the file, and the error."""


def load(path: str | Path, overrides: Iterable[str] = (), choices: Choices = AS_WRITTEN) -> SystemFile:
    """The system file at `path`, with all that it includes, read and checked; nothing is loaded or created yet.

    Args:
        overrides: parameters as "component.param=value", which win over those of the file.
        choices: variables, and ports in the place of others.

    Raises:
        SystemFileError: the file cannot be read, is no system file, or refers to something that is not there.
    """
    where = Path(path)
    return parse(read_text(where), where, overrides, choices)


def component_type(system: SystemFile, entry: ComponentEntry, catalogue: Catalogue) -> type[Component]:
    """The class of a component.

    Raises:
        SystemFileError: its file is not below the system file's folder.
        PluginError: there is no such file, module, class or offer, or it cannot be loaded.
    """
    places = system.folders(("components", entry.name, "type"))
    extension = extension_of(entry.type, catalogue, places, partial(_allow, system, entry.type))
    check_inside(system, extension)
    return extension.load_class(Component)


def converter(system: SystemFile, entry: ConnectionEntry, catalogue: Catalogue) -> Converter:
    """The converter that a connection names.

    Raises:
        SystemFileError: its file is not below the system file's folder.
        PluginError: there is no such file, module, function or offer, it cannot be loaded, or it is no converter.
    """
    text = str(entry.options["convert"]).strip()
    places = system.folders(("connections", entry.number - 1, "convert"))
    extension = converter_extension(text, catalogue, places, partial(_allow, system, text))
    check_inside(system, extension)
    return converter_of(text, extension, extension.load())


def context_type(system: SystemFile, kind: str, catalogue: Catalogue) -> type[Context]:
    """The class of a kind of context. SystemFileError: the kind is unknown. PluginError: the class cannot be loaded."""
    offers = catalogue.extensions("contexts")
    if kind not in offers:
        raise SystemFileError(f"unknown kind {kind[:80]!r}; {suggestion(kind, offers)}")
    extension = catalogue.find("contexts", kind)
    check_inside(system, extension)
    found = extension.load()
    if not (isinstance(found, type) and issubclass(found, Context)):
        raise PluginError(f"{kind} is no execution context")
    return found


def check_inside(system: SystemFile, extension: Extension) -> None:
    """Refuse a plugin with a link that leads out of the system file's folder: its code would come from elsewhere.

    Raises:
        SystemFileError: names the link.
    """
    if extension.folder is None or extension.folder not in _all_folders(system):
        return
    root = system.folder.resolve()
    module = extension.target.partition(":")[0]
    paths = iter((extension.folder / module,)) if module.endswith(".py") else extension.folder.rglob("*")
    for path in (extension.folder, *islice(paths, _MOST_FILES)):
        if path.is_symlink() and not path.resolve().is_relative_to(root):
            raise SystemFileError(f"{path} leads out of the system file's folder; put the files themselves below it")


def _all_folders(system: SystemFile) -> set[Path]:
    return {folder for named in system.plugin_paths for folder in (named, *_folders_in(named))}


def _folders_in(folder: Path) -> list[Path]:
    try:
        return [path for path in folder.iterdir() if path.is_dir()]
    except OSError:
        return []


def parameters(system: SystemFile, entry: ComponentEntry, cls: type[Component]) -> tuple[dict[str, Any], list[Fault]]:
    """The parameters of a component, converted and checked, and the faults.

    Values of the command line win over the file.
    """
    key: Key = ("components", entry.name)
    faults: list[Fault] = []
    try:
        of_options = parse_options(cls, entry.options)
    except ConfigurationError as error:
        faults.append(((*key, "options"), "", error))
        of_options = {}
    given: dict[str, tuple[Any, Key, str]] = {
        name: (value, (*key, "options"), "") for name, value in of_options.items()
    }
    for name, value in entry.params.items():
        if name in of_options:
            flag = flag_of(cls, name)
            what = f"options ({flag}) and params.{name} both set {name}; take one of them away"
            faults.append(((*key, "params", name), "", SystemFileError(what)))
        given[name] = (value, (*key, "params", name), "")
    specs = declarations(cls).parameters
    for name, (value, where, _) in given.items():
        given[name] = (in_folder(system, specs.get(name), value, where), where, "")
    for override in system.overrides:
        if override.component == entry.name and (override.param in specs or override.param != ACTIVE):
            given[override.param] = (override.value, (), f"--set {override.text[:80]}")
    checked: dict[str, Any] = {}
    for name, (value, where, said) in given.items():
        try:
            checked |= validate(specs, {name: value}, owner=entry.name)
        except ConfigurationError as error:
            faults.append((where, said, error))
    return checked, faults


def setting(
    system: SystemFile, entry: ComponentEntry, cls: type[Component], params: Mapping[str, Any]
) -> tuple[Setting, list[Fault]]:
    """The whole configuration of a component, and the faults of its sets; `params` have been checked."""
    key: Key = ("components", entry.name)
    faults: list[Fault] = []
    declared = declarations(cls).configuration
    sets: dict[str, Mapping[str, Any]] = {}
    for name, values in entry.sets.items():
        checked: dict[str, Any] = {}
        for parameter, value in values.items():
            where = (*key, "sets", name, parameter)
            try:
                value = in_folder(system, declared.specs.get(parameter), value, where)
                checked |= validate(declared.specs, {parameter: value}, owner=entry.name)
            except ConfigurationError as error:
                faults.append((where, "", error))
        sets[name] = checked
    active, said = entry.active, ""
    where = (*key, ACTIVE)
    for override in system.overrides:
        if override.component == entry.name and override.param == ACTIVE and ACTIVE not in declared.specs:
            active, where, said = override.value.strip(), (), f"--set {override.text[:80]}"
    known = {**declared.sets, **sets}
    if active and active not in known:
        try:
            ConfigurationState(declared.specs, MappingProxyType(known)).activated(active, entry.name)
        except ConfigurationError as error:
            faults.append((where, said, error))
            active = ""
    if active and active != DEFAULT:
        # Values of the command line win over those of the active set.
        by_hand = {one.param for one in system.overrides if one.component == entry.name}
        chosen = {name: params[name] for name in known[active] if name in by_hand and name in params}
        if chosen:
            sets[active] = {**known[active], **chosen}
    return Setting(params, MappingProxyType(sets), active or None), faults


def in_folder(system: SystemFile, spec: ParameterSpec | None, value: Any, key: Key) -> Any:
    """A value from a file; a relative path is joined to the folder of the file that has the key."""
    is_path = spec is not None and spec.type is Path and isinstance(value, str) and value
    return str(system.folder_of(key) / value) if is_path else value


def _allow(system: SystemFile, typed: str, path: Path) -> None:
    """Raise SystemFileError for a file outside the system file's folder: its code would come from elsewhere."""
    if path.resolve().is_relative_to(system.folder.resolve()):
        return
    link = next((one for one in (path, *path.parents) if one.is_symlink()), None)
    if link is not None:
        what = f"{link} is a link to {link.resolve()}, outside the system file's folder; put the file itself below it"
        raise SystemFileError(f"{shown(typed.rpartition(':')[0])}: {what}")
    raise SystemFileError(f"{shown(typed)} is outside the system file's folder; move the file below it")
