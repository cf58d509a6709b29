"""Names of record types: found by short name, or by `module.Name` when two modules define the same one.

A record is registered when it is defined, a user's dataclass when it is first described. An unknown name that a user
typed is looked for among the types that plugins offer. A name from a frame or a file imports only a class that a
plugin declares under exactly that name, or a record of ROS that comes with aiorts. ROS records have no short name:
`sensor_msgs/Imu` is the only name of its record.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING, TypeVar

from aiorts.errors import UnknownTypeError
from aiorts.late import finder
from aiorts.spelling import similar

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

__all__ = ("all_types", "find_type", "full_name", "type_name", "wire_name", "wire_type")

T = TypeVar("T", bound=type)

_BUILTIN = "aiorts.types."
_ROS = f"{_BUILTIN}ros."
_by_full_name: dict[str, type] = {}
_by_short_name: dict[str, dict[str, type]] = {}
_plain: dict[str, type] = {cls.__name__: cls for cls in (bool, int, float, str, bytes)}


def full_name(cls: type) -> str:
    """`module.Name`.

    The records that come with aiorts are all `aiorts.types.Name`, those of ROS `package/Name`. A class of a function:
    `module.function.Name`.
    """
    if cls in _plain.values():
        return cls.__name__
    if cls.__module__.startswith(_ROS):
        return f"{cls.__module__.removeprefix(_ROS)}/{cls.__qualname__}"
    qualname = cls.__qualname__.replace("<locals>.", "")
    return _BUILTIN + qualname if cls.__module__.startswith(_BUILTIN) else f"{cls.__module__}.{qualname}"


def register(cls: T) -> T:
    """Make `cls` findable.

    A class defined again in the same place (a notebook cell run twice) replaces the older one.
    """
    name = full_name(cls)
    if _by_full_name.get(name) is not cls:
        _by_full_name[name] = cls
        if "/" not in name:
            _by_short_name.setdefault(cls.__name__, {})[name] = cls
    return cls


def find_type(name: str) -> type:
    """The record type (or enumeration, or bool, int, float, str, bytes) of that name.

    `name` is `Name` or `module.Name`, or, for ROS, `package/Name` or `package/msg/Name`. A type that no loaded module
    defines is loaded from the plugin that offers it. UnknownTypeError with near names if there is none, with the full
    names if there are several.
    """
    found = _known(name)
    if found is not None:
        return found
    offered: Iterable[str] = ()
    if isinstance(name, str):  # imports the plugin that offers the type, if any, and gives the names that are offered
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
    if isinstance(name, str) and "/" in name:
        return _of_ros(name.replace("/msg/", "/"))
    found = _by_short_name.get(name, {})
    if len(found) > 1:
        names = " and ".join(sorted(found))
        raise UnknownTypeError(f"type {name!r} is defined more than once: {names}; write the full name")
    return next(iter(found.values()), None)


def _of_ros(name: str) -> type | None:
    """The record of ROS's type `package/Name`; loads the records of ROS if they are not loaded yet."""
    return _by_full_name.get(name) if name in finder("ros")(name) else None


def is_known(name: str) -> bool:
    """Whether loaded modules define at least one type of this name."""
    return name in _plain or name in _by_full_name or bool(_by_short_name.get(name))


def _hint(name: str, offered: Iterable[str]) -> str:
    if not isinstance(name, str):
        return "; a type name is text"
    of_ros = [known for known in finder("ros")(name) if known.lower().endswith(f"/{name.lower()}")]
    lowered = {known.lower(): known for known in (*offered, *_by_short_name, *_by_full_name, *_plain)}
    near = [lowered[match] for match in similar(name.lower(), lowered, cutoff=0.7)]
    if of_ros or near:
        return f"; did you mean {' or '.join([*of_ros, *near][:3])}?"
    return "; import the module that defines it, or see aiorts.types.all_types()"


def type_name(cls: type) -> str:
    """The shortest name by which `find_type` finds `cls` at present."""
    full = full_name(cls)
    return cls.__name__ if "/" not in full and len(_by_short_name.get(cls.__name__, ())) <= 1 else full


def all_types() -> Mapping[str, type]:
    """Every known type by its full name, in order of definition; enumerations included."""
    return MappingProxyType(_by_full_name)


def wire_name(cls: type) -> str:
    """The name of a type in frames.

    It is the bare name for records that come with aiorts, the full name for all others. It never changes.
    """
    return full_name(cls).removeprefix(_BUILTIN)


def wire_type(name: str, *, bare: bool = False) -> type | None:
    """The type that a frame or a recording names; None if it is neither registered nor declared by a plugin.

    Args:
        bare: whether a user's type is also found by its class name without a module, as in lines of JSON.

    Raises:
        UnknownTypeError: the plugin that declares the type is broken, or several types have this bare name.
    """
    found = _named(name, bare)
    if found is None and "/" in name:
        return _of_ros(name)
    if found is None and (bare or "." in name) and finder("declared types")(name):
        found = _named(name, bare)
    return found


def _named(name: str, bare: bool) -> type | None:
    found = _plain.get(name) or _by_full_name.get(_BUILTIN + name) or _by_full_name.get(name)
    return _known(name) if found is None and bare else found
