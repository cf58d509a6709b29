"""The arguments of the class of a context, or of a service's settings, read from its signature; no instance is made.

Values that are given by name, in a system file or to `Kernel(services=...)`, are checked here one by one.
"""

from __future__ import annotations

import dataclasses
import inspect
import types
import typing
from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final, TypeVar

from aiorts.errors import AiortsError
from aiorts.model.annotations import alternatives
from aiorts.model.declared import Option, fault_of, hints_of, options_of, words_of
from aiorts.model.values import WORDS
from aiorts.spelling import suggestion

T = TypeVar("T")
OPTION_TYPES: Final = "bool, int, float, str, Path or a Literal of texts, each also with None, or tuple[str, ...]"
"""The types of a field of settings that is an option."""
_PLAIN: Final = (bool, int, float, str, Path)


def arguments_of(cls: type) -> dict[str, tuple[type, ...]]:
    """By the name of each argument that a system file may set: the kinds of value it takes; () is any.

    The `name` of a context is that of its table; settings of a service may have one.
    """
    init: Any = cls.__init__  # type: ignore[misc] # of this very class, as its signature is
    hints = hints_of(init)
    given = () if dataclasses.is_dataclass(cls) else ("name",)
    return {name: _kinds(hints.get(name)) for name in inspect.signature(cls).parameters if name not in given}


def needs_rate(cls: type) -> bool:
    """Whether it has a rate with a number as default.

    In a program an editor shows the default of a call; in a file a default that does not stand there is not seen.
    """
    rate = inspect.signature(cls).parameters.get("rate")
    return rate is not None and isinstance(rate.default, float)


def unfit(value: Any, kinds: tuple[type, ...]) -> str:
    """The expectation that a value misses; "" when it fits."""
    kind = list if type(value) is tuple else str if isinstance(value, Path) else type(value)
    if not kinds or kind in kinds or (kind is int and float in kinds):
        return ""
    return f"expected {' or '.join(WORDS[kind] for kind in kinds)}, got {value!r:.80}"


def settings_faults(cls: type, given: Mapping[str, Any], also: Collection[str] = ()) -> Iterator[tuple[str, str, bool]]:
    """The faults of `cls(**given)`: the key ("" is all of them), what is wrong, whether the key itself is.

    All are tried together first. An error is about the key that it begins with, "KEY: ", or that fails alike alone;
    that one is left out, and the others are tried again, so that each that is wrong is named.

    Args:
        also: keys that may have been meant by an unknown one, besides its own.
    """
    known = arguments_of(cls)
    rest = dict(given)
    for key, value in given.items():
        if key not in known:
            hint = suggestion(key, [*known, *also], f"there are {', '.join(known) or 'none'}")
            yield key, f"unknown key {key[:80]!r}; {hint}", True
        elif what := unfit(value, known[key]) or fault_of(cls, key, value):
            yield key, what, False
        else:
            continue
        del rest[key]
    while what := _refused(cls, rest):
        about = (key for key in rest if what.startswith(f"{key}: ") or _refused(cls, {key: rest[key]}) == what)
        key = next(about, "")
        if key or len(rest) == len(given):
            yield key, what.removeprefix(f"{key}: "), not key
        if not key:
            return
        del rest[key]


def settings_of(cls: type[T], given: Mapping[str, Any]) -> T:
    """The settings that `cls` makes of values that were found right.

    Lists, as a system file has them, become tuples, and texts paths where the settings have a path.
    """
    paths = path_settings(cls) if dataclasses.is_dataclass(cls) else ()
    return cls(**{key: _meant(value, path=key in paths) for key, value in given.items()})


def _meant(value: Any, *, path: bool) -> Any:
    if isinstance(value, list):
        return tuple(value)
    return Path(value) if path and value and isinstance(value, str) else value


def flags_of(settings: type) -> dict[str, type | tuple[str, ...] | None]:
    """By the name of each field that is an option: the type of its values, or the texts that it takes.

    `tuple` for one that is repeated, each a text; None for a field that cannot be an option (`OPTION_TYPES`).
    """
    hints = hints_of(settings)
    found: dict[str, type | tuple[str, ...] | None] = {}
    for name, one in options_of(settings).items():
        if one.flag is False:
            continue
        parts = _parts(hints.get(name, type(one.default)))
        kind = parts[0] if len(parts) == 1 else None
        words = words_of(kind)
        if kind == tuple[str, ...]:
            found[name] = tuple
        elif words and set(_types(kind)) == {str}:
            found[name] = words
        else:
            found[name] = kind if kind in _PLAIN else None
    return found


def path_settings(settings: type) -> frozenset[str]:
    """The fields of settings that are paths."""
    return frozenset(name for name, hint in hints_of(settings).items() if _parts(hint) == [Path])


def option_flag(service: str, name: str, one: Option) -> str:
    """The option of `aiorts run` that a field of a service's settings is."""
    word = one.flag
    if isinstance(word, str) and word.startswith("--"):
        return word
    parts = (service, name if word is True else str(word))
    return f"--{'-'.join(filter(None, parts))}".replace("_", "-")


def _refused(cls: type, given: Mapping[str, Any]) -> str:
    """Why it cannot be made of these values; "" when it can."""
    try:
        settings_of(cls, given)
    except AiortsError as error:
        return str(error)
    except Exception as error:  # noqa: BLE001 - a plugin's border
        return f"{type(error).__name__}: {error}"
    return ""


def _kinds(hint: Any) -> tuple[type, ...]:
    parts = [str if one is Path else one for part in _parts(hint) for one in _types(part)]
    known = [part if part in WORDS else list for part in parts if part in WORDS or typing.get_origin(part) is not None]
    return tuple(known) if len(known) == len(parts) else ()


def _parts(hint: Any) -> list[Any]:
    """The types of a value, without None."""
    return [part for part in alternatives(hint) if part is not types.NoneType]


def _types(part: Any) -> Iterable[Any]:
    """The part itself; of a Literal, the types of what it lists."""
    return dict.fromkeys(map(type, typing.get_args(part))) if typing.get_origin(part) is typing.Literal else (part,)
