"""Find what installed packages offer, by kind and name, without importing anything; load one when it is first used.

Every extension is an entry point of the group `aiorts.<kind>` (`aiorts.components`, `aiorts.contexts`), aiorts' own
included.
"""

from __future__ import annotations

from difflib import get_close_matches
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from aiorts.errors import PluginError

__all__ = ("extensions", "load_extension")


def extensions(kind: str) -> dict[str, tuple[EntryPoint, ...]]:
    """What is offered under `kind`, by name; a name that several packages offer has several entries."""
    found: dict[str, list[EntryPoint]] = {}
    for entry in entry_points(group=f"aiorts.{kind}"):
        offers = found.setdefault(entry.name, [])
        if all(other.value != entry.value for other in offers):
            offers.append(entry)
    return {name: tuple(offers) for name, offers in sorted(found.items())}


def load_extension(kind: str, name: str) -> Any:
    """The object that a package offers as `name`.

    Raises:
        PluginError: nobody offers it (near names are given), several do (all are named), or it cannot be imported.
    """
    offers = extensions(kind)
    found = list(offers.get(name, ()))
    word = kind.removesuffix("s")
    if not found:
        near = get_close_matches(name, offers, n=3)
        hint = f"did you mean {' or '.join(near)}?" if near else f"installed: {', '.join(offers) or 'none'}"
        raise PluginError(f"no {word} named {name!r}; {hint}")
    if len(found) > 1:
        sources = " and ".join(f"{entry.value} ({_package(entry)})" for entry in found)
        raise PluginError(f"{word} {name!r} is offered twice, by {sources}; uninstall one")
    try:
        return found[0].load()
    except BaseException as error:  # a plugin's border: whatever its import does is reported as the plugin's
        if isinstance(error, KeyboardInterrupt):
            raise
        raise PluginError(
            f"{word} {name!r} of {_package(found[0])} ({found[0].value}) cannot be loaded: "
            f"{type(error).__name__}: {error}"
        ) from error


def _package(entry: EntryPoint) -> str:
    return f"package {entry.dist.name} {entry.dist.version}" if entry.dist is not None else "unknown package"
