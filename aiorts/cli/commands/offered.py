"""Commands of plugins: click commands by their own name, and every component, in lower case, as a filter.

A command of aiorts comes first, then a plugin's command, then a component; a name in two plugins cannot be used.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator

import click

from aiorts import Catalogue, Extension
from aiorts.errors import PluginError


def offered(catalogue: Catalogue, kind: str) -> dict[str, tuple[Extension, ...]]:
    """The extensions of a kind, "commands" or "components", by the word to type."""
    found: dict[str, tuple[Extension, ...]] = {}
    for name, several in catalogue.extensions(kind).items():
        typed = name.lower() if kind == "components" else name
        if _can_be_typed(typed):
            found[typed] = (*found.get(typed, ()), *several)
    return found


def command_named(name: str, catalogue: Catalogue) -> tuple[click.Command, Extension] | None:
    """Find the command of a plugin, or the filter of a component, installed or as text, and its source; or None.

    Raises:
        PluginError: several plugins offer the name (all are listed), or it cannot be loaded.
    """
    if ":" in name or name.endswith(".py"):
        from aiorts.kernel.extensions.type_names import extension_of

        extension = extension_of(name, catalogue)
        return _command(name, extension), extension
    return _among(name, catalogue, ("commands", "components"))


def filter_named(name: str, catalogue: Catalogue) -> click.Command | None:
    """Find the filter of a component, installed or as text, even where a command has its name; None without one.

    Raises:
        PluginError: several plugins offer the name (all are listed), or it cannot be loaded.
    """
    as_text = ":" in name or name.endswith(".py")
    found = command_named(name, catalogue) if as_text else _among(name, catalogue, ("components",))
    return None if found is None else found[0]


def _among(name: str, catalogue: Catalogue, kinds: Collection[str]) -> tuple[click.Command, Extension] | None:
    for kind in kinds:
        if several := offered(catalogue, kind).get(name):
            first, *others = several
            if others:
                raise _twice(name, several)
            return _command(name, first), first
    return None


def clashes(catalogue: Catalogue, taken: Collection[str]) -> Iterator[tuple[str, str]]:
    """The source and the fault of each name that cannot be used, or only in part; `taken` are aiorts' own commands."""
    for kind in catalogue.KINDS:
        for name in catalogue.extensions(kind):
            try:
                catalogue.find(kind, name)
            except PluginError as error:
                yield "plugins", str(error)
    commands, components = offered(catalogue, "commands"), offered(catalogue, "components")
    for name, several in components.items():
        if len({one.name for one in several}) > 1:
            yield "plugins", str(_twice(name, several))
    for name in catalogue.extensions("commands").keys() - commands.keys():
        yield catalogue.extensions("commands")[name][0].source, f"command {name!r}: such a name cannot be typed"
    for name, several in (*commands.items(), *components.items()):
        if name in taken:
            reason = f"{_called(several[0])}: `aiorts {name}` is a command of aiorts, which comes first; rename yours"
            if several[0].kind == "components":
                reason += f", or write `aiorts filter {name}`"
            yield several[0].source, reason
    for name in commands.keys() & components.keys() - set(taken):
        command, component = commands[name][0], components[name][0]
        if command.project != component.project:
            yield component.source, f"{_called(component)}: `aiorts {name}` is the command of {command.source}"


def _command(name: str, extension: Extension) -> click.Command:
    if extension.kind == "components":
        from aiorts import Component
        from aiorts.cli.commands.filter import command_of

        return command_of(name, extension.load_class(Component))
    found = extension.load()
    if not isinstance(found, click.Command):
        raise PluginError(
            f"{_called(extension)} of {extension.source}: expected a click.Command, got {type(found).__name__}"
        )
    return found


def _can_be_typed(name: str) -> bool:
    return bool(name) and name.isprintable() and not name.startswith("-") and not any(c.isspace() for c in name)


def _twice(name: str, several: tuple[Extension, ...]) -> PluginError:
    from aiorts.kernel.extensions.origins import told_apart

    return PluginError(f"`aiorts {name}` is offered twice, by {told_apart(several)}")


def _called(extension: Extension) -> str:
    return f"{'command' if extension.kind == 'commands' else 'component'} {extension.name!r}"
