"""Names of record types: found by short name, or by `module.Name` when two modules define the same one.

A record enters when it is defined, a user's dataclass when it is first described. A name that somebody typed and
nobody knows is looked for where plugins offer types; for a name that came in a frame nothing is imported.
"""

from __future__ import annotations

import difflib
from enum import Enum
from types import MappingProxyType
from typing import TYPE_CHECKING, TypeVar

from aiorts.errors import UnknownTypeError
from aiorts.model.elsewhere import finder

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

T = TypeVar("T", bound=type)

__all__ = ("all_types", "find_type", "full_name", "is_known", "register", "type_name", "wire_name", "wire_type")

_BUILTIN = "aiorts.types."
_by_full_name: dict[str, type] = {}
_by_short_name: dict[str, dict[str, type]] = {}
_plain: dict[str, type] = {cls.__name__: cls for cls in (bool, int, float, str, bytes)}


def full_name(cls: type) -> str:
    """`module.Name`.

    The records that come with aiorts are all `aiorts.types.Name`. A class of a function: `module.function.Name`.
    """
    if cls in _plain.values():
        return cls.__name__
    qualname = cls.__qualname__.replace("<locals>.", "")
    return _BUILTIN + qualname if cls.__module__.startswith(_BUILTIN) else f"{cls.__module__}.{qualname}"


def register(cls: T) -> T:
    """Make `cls` findable.

    A class defined again in the same place (a notebook cell run twice) replaces the older one.
    """
    name = full_name(cls)
    if _by_full_name.get(name) is not cls:
        _by_full_name[name] = cls
        _by_short_name.setdefault(cls.__name__, {})[name] = cls
    return cls


def find_type(name: str) -> type:
    """The record type (or enumeration, or bool, int, float, str, bytes) of that name.

    `name` is `Name` or `module.Name`. One that no loaded module defines is loaded from the plugin that offers it.
    UnknownTypeError with near names if there is none, with the full names if there are several.
    """
    found = _known(name)
    if found is not None:
        return found
    offered: Iterable[str] = ()
    if isinstance(name, str):  # imports what offers the type, if anything does, and gives the names that are offered
        offered = finder("types")(name)
        found = _known(name)
        if found is not None:
            return found
    raise UnknownTypeError(f"unknown type {name!r}{_hint(name, offered)}")


def _known(name: str) -> type | None:
    if name in _plain:
        return _plain[name]
    if name in _by_full_name:
        return _by_full_name[name]
    found = _by_short_name.get(name, {})
    if len(found) > 1:
        names = " and ".join(sorted(found))
        raise UnknownTypeError(f"type {name!r} is defined more than once: {names}; write the full name")
    return next(iter(found.values()), None)


def is_known(name: str) -> bool:
    """Whether a module that is loaded defines the name, once or more often."""
    return name in _plain or name in _by_full_name or bool(_by_short_name.get(name))


def _hint(name: str, offered: Iterable[str]) -> str:
    if not isinstance(name, str):
        return "; a type name is text"
    lowered = {known.lower(): known for known in (*offered, *_by_short_name, *_by_full_name, *_plain)}
    near = difflib.get_close_matches(name[:200].lower(), lowered, n=3, cutoff=0.7)
    if near:
        return f"; did you mean {' or '.join(lowered[match] for match in near)}?"
    return "; import the module that defines it, or see aiorts.types.all_types()"


def type_name(cls: type) -> str:
    """The shortest name by which `find_type` finds `cls` at present."""
    full = full_name(cls)
    return cls.__name__ if len(_by_short_name.get(cls.__name__, ())) <= 1 else full


def all_types() -> Mapping[str, type]:
    """Every known type by its full name, in order of definition; enumerations included."""
    return MappingProxyType(_by_full_name)


def wire_name(cls: type) -> str:
    """The name that stands in frames.

    Bare for the records that come with aiorts, full for all others, the same for ever.
    """
    return full_name(cls).removeprefix(_BUILTIN)


def wire_type(name: str) -> type | None:
    """The type a frame names, or None; what is not registered does not exist."""
    return _plain.get(name) or _by_full_name.get(_BUILTIN + name) or _by_full_name.get(name)


def is_enum(cls: object) -> bool:
    return isinstance(cls, type) and issubclass(cls, Enum)
