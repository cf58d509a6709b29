"""What `aiorts run` is asked to run: a system file, or one component alone in a context that fits it.

Everything is loaded and checked here, before a kernel is opened.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Final

import click

from aiorts import Catalogue, Component, EventContext, InPort, Kernel, PeriodicContext
from aiorts.cli.plugins_option import catalogue_of
from aiorts.cli.single import component_class
from aiorts.errors import ComponentError, ConfigurationError, SystemFileError
from aiorts.model.options import doubts
from aiorts.system import ClockEntry, SystemFile, WatchEntry, build, construct, load, prepare
from aiorts.system.places import Key
from aiorts.system.whole import NOTHING_RUNS

__all__ = ("DEFAULT_RATE", "Target", "find_target")

_SYSTEM_CLOCK: Final = ClockEntry()
_WATCH: Final = WatchEntry()
DEFAULT_RATE: Final = 10.0
"""Hz of a component without in-ports that is run alone."""


@dataclass(frozen=True, slots=True)
class Target:
    """What is run: made in a kernel by `make`."""

    names: tuple[str, ...]
    """Of the components."""
    catalogue: Catalogue
    make: Callable[[Kernel], Any]
    clock: ClockEntry = _SYSTEM_CLOCK
    ready: tuple[str, ...] = ()
    """Who is active once it is ready."""
    watch_loop: WatchEntry = _WATCH
    unfed: str = ""
    """Of a component alone: what to do when it waits for data that cannot come."""
    doubts: tuple[str, ...] = ()
    """Of a system file: what it says that does nothing."""


def find_target(text: str, changes: Sequence[str], folders: Sequence[Path], rate: float | None) -> Target:
    """The system file or component that `text` names, loaded and checked.

    Args:
        changes: parameters as "component.param=value"; for a component alone also "param=value".
        folders: plugins that are not installed.
        rate: Hz, for a component alone.

    Raises:
        AiortsError: says what is wrong with it. click.UsageError: options that do not go together.
    """
    for folder in folders:
        if not folder.is_dir():
            raise ConfigurationError(f"--plugins {folder}: no such folder; name one with plugins in it")
    if text.endswith(".py") and Path(text).is_file():
        raise ConfigurationError(f"{text}: no system file; {_give_class(Path(text))}")
    if _is_file(text):
        if rate is not None:
            raise click.UsageError("--rate is for a component alone; a system file has rate under [contexts.NAME]")
        return _system(text, changes, folders)
    catalogue = catalogue_of(folders)
    catalogue.make_default()
    if ":" not in text and text not in catalogue.extensions("components"):
        raise ConfigurationError(f"{text[:80]!r}: {_no_such(text, catalogue)}")
    cls = component_class(text, catalogue)
    return _alone(cls, changes, catalogue, rate, _fed_by(text, cls, folders))


def _fed_by(text: str, cls: type[Component], folders: Sequence[Path]) -> str:
    """How this component gets data."""
    home, colon, _ = text.rpartition(":")
    if colon and not home.strip().endswith(".py"):
        return "connect it in a system file"
    where = [Path(home.strip()).parent] if colon else folders
    plugins = "".join(f"--plugins {shlex.quote(str(folder))} " for folder in where)
    return f"as a filter: aiorts {plugins}{cls.__name__.lower()}"


def _is_file(text: str) -> bool:
    if text.endswith(".toml") or not text:
        return True
    try:
        return ":" not in text and Path(text).is_file()
    except (OSError, ValueError):
        return False


def _give_class(path: Path) -> str:
    names = [one.name for one in Catalogue((path.parent,)).defined_in(path)]
    if not names:
        return f"give {path}:CLASS; it has no component"
    return f"give {path}:{names[0] if len(names) == 1 else 'CLASS'}; it has {', '.join(names[:10])}"


def _no_such(text: str, catalogue: Catalogue) -> str:
    components = catalogue.extensions("components")
    try:
        files = [path.name for path in Path().iterdir() if path.suffix == ".toml"]
    except OSError:
        files = []
    near = get_close_matches(text[:100], [*files, *components], n=1)
    if not near:  # `pid` for `pid.toml`, and `flexiconst` for `FlexiConst`
        near = [one for one in (*files, *components) if one.lower().removesuffix(".toml") == text.lower()]
    hint = f"did you mean {near[0]!r}?" if near else "give SYSTEM.toml, MODULE:COMPONENT or FILE.py:COMPONENT"
    return f"no system file and no installed component; {hint}"


def _system(text: str, changes: Sequence[str], folders: Sequence[Path]) -> Target:
    try:
        system = load(text, changes)
    except SystemFileError as error:
        if f"{text}: --set " in str(error):
            raise ConfigurationError(str(error)).like(error) from None
        if not Path(text).parent.is_dir() or Path(text).exists() or "cannot be read" not in str(error):
            raise
        near = get_close_matches(Path(text).name, [path.name for path in Path(text).parent.glob("*.toml")], n=1)
        hint = f"; did you mean {str(Path(text).parent / near[0])!r}?" if near else ""
        raise SystemFileError(f"{error}{hint}") from None
    if not system.components:
        raise SystemFileError(
            f"{text}: there are no components, and nothing to run; write [components.NAME] with a type"
        )
    catalogue = catalogue_of((*folders, *system.plugin_paths))
    plan = prepare(system, catalogue)
    if system.components and not any(context.members for context in system.contexts.values()):
        raise SystemFileError(f"{system.path}: {NOTHING_RUNS}")
    return Target(
        (*system.components, *system.composites),
        catalogue,
        lambda kernel: build(kernel, plan),
        system.clock,
        _activated(system),
        system.watch_loop,
        doubts=tuple(f"{system.at(*key, of_key=True)}: {text}" for key, text in _doubts(system)),
    )


def _doubts(system: SystemFile) -> Iterator[tuple[Key, str]]:
    for connection in system.connections:
        for option, text in doubts(connection.options):
            yield ("connections", connection.number - 1, *option.split(".")), f"{connection.place}: {text}"


def _activated(system: SystemFile) -> tuple[str, ...]:
    """Who is made active when the system is built."""
    members = [name for context in system.contexts.values() if context.activate for name in context.members]
    started = [entry.name for entry in system.components.values() if entry.start is not None]
    return tuple(dict.fromkeys((*members, *started)))


# -- one component -----------------------------------------------------------------------------------------------------


def _alone(
    cls: type[Component], changes: Iterable[str], catalogue: Catalogue, rate: float | None, unfed: str
) -> Target:
    name = cls.__name__.lower()
    params = _params(name, cls, changes)
    if rate is not None:
        _check_rate(rate)

    async def make(kernel: Kernel) -> None:
        try:
            component = await kernel.create(cls, name, **params)
        except BaseException as error:
            error.add_note(name)
            raise
        takes = any(isinstance(port, InPort) for port in component.ports.values())
        context = EventContext() if takes and rate is None else PeriodicContext(rate=rate or DEFAULT_RATE)
        try:
            await kernel.start(context, component, activate=True)
        except ComponentError:
            return  # its on_activated failed: it is in error, as it would be later on

    return Target((name,), catalogue, make, ready=(name,), unfed=unfed)


def _check_rate(rate: float) -> None:
    try:
        PeriodicContext(rate=rate)
    except ConfigurationError as error:
        raise ConfigurationError(f"--rate: {error}") from None


def _params(name: str, cls: type[Component], changes: Iterable[str]) -> Mapping[str, Any]:
    """What `--set` says of it, checked; ConfigurationError names every mistake."""
    params: dict[str, Any] = {}
    for text in changes:
        where, equals, value = text.partition("=")
        component, dot, param = where.strip().rpartition(".")
        if not equals or not param:
            raise ConfigurationError(f"--set {text[:80]!r}: expected PARAM=VALUE, such as gain=2.0")
        if dot and component != name:
            raise ConfigurationError(f"--set {text[:80]!r}: the component is called {name!r}; write {param}=VALUE")
        params[param] = value
    construct(cls, name).params.check(params)
    return params
