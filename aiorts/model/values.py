"""The values of parameters, and their conversion from text: this file converts exactly or refuses, it never rounds.

Options and variables read texts by the same words and numbers. Files of other formats (YAML, XML, CSV) and samples that
are converted go by the rules of their formats.

    bool    true false yes no on off enable disable 1 0 as text, in any case; no number
    int     decimal, 0x, 0o or 0b as text; no float, not even 2.0
    float   any number; a whole number only when a float holds it exactly
    str     text
    Path    text or a path, not empty
    Enum    a member, its name, or its value
    tuple   a list or tuple; as text "1, 2", "[1, 2]" or a JSON list (whose texts may hold commas)
    Mapping a mapping from text; as text "{k0: 1, k1: 2}" or a JSON object; held read-only, in the order given
    X|None  None, or "none" as text where X is not text; all else as X

ValueError and TypeError carry a message for the reader of a parameter's error ("must be a float").
"""

from __future__ import annotations

import enum
import operator
import os
import types
import typing
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final, cast

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

_SHOWN_LENGTH: Final = 80
_LONGEST_PATH: Final = 4096
TRUTH: Final[Mapping[str, bool]] = types.MappingProxyType(
    {
        **dict.fromkeys(("true", "yes", "on", "enable", "1"), True),
        **dict.fromkeys(("false", "no", "off", "disable", "0"), False),
    }
)
"""The words of truth values; they are read in any case, with blanks round them."""
WORDS: Final[Mapping[type, str]] = types.MappingProxyType(
    {bool: "true or false", int: "a whole number", float: "a number", str: "text", list: "a list"}
)
"""The names of the types of plain values in messages."""
WHOLE: Final = r"[+-]?([0-9](_?[0-9])*|0[xX](_?[0-9a-fA-F])+|0[oO](_?[0-7])+|0[bB](_?[01])+)"
"""The pattern of a whole number, which JSON Schema has, too."""


def truth_of(text: str) -> bool | None:
    """The truth value of a text; None: the text has none."""
    return TRUTH.get(text.strip().lower())


def whole_of(text: str) -> int:
    """The whole number of a text: decimal, or 0x, 0o or 0b. ValueError: the text is none."""
    try:
        return int(text)
    except ValueError:
        return int(text, 0)


def shown(value: object) -> str:
    """The value as it stands in a message: cut to a line, but a path is whole."""
    longest = _SHOWN_LENGTH
    try:
        if issubclass(type(value), cast("type", os.PathLike)):
            longest = _LONGEST_PATH
        text = str.__str__(str(value) if issubclass(type(value), cast("type", os.PathLike)) else repr(value))
    except ValueError:  # a whole number with thousands of digits
        text = f"<{type(value).__name__} too long to be shown>"
    except BaseException:  # noqa: BLE001 - the border of a user's own `__repr__`
        text = f"<{type(value).__name__} that cannot be shown>"
    return text if len(text) <= longest else f"{text[:longest]}..."


def type_text(kind: Any) -> str:
    """A parameter's type as it is written in annotations."""
    inner, optional = _without_none(kind)
    if optional:
        return f"{type_text(inner)} | None"
    if (item := value_type(kind)) is not None:
        return f"Mapping[str, {type_text(item)}]"
    if typing.get_origin(kind) is tuple:
        parts = ("..." if part is Ellipsis else type_text(part) for part in typing.get_args(kind))
        return f"tuple[{', '.join(parts)}]"
    return str(getattr(kind, "__name__", kind))


def infer_type(default: object) -> Any:
    """The type of a default; raises TypeError when the default does not show it (None, an empty tuple)."""
    if isinstance(default, enum.Enum):
        return type(default)
    if isinstance(default, os.PathLike):
        return _path()
    for kind in (bool, int, float, str):
        if isinstance(default, kind):
            return kind
    if isinstance(default, tuple | list):
        return _infer_tuple(default)
    if isinstance(default, Mapping) and default:
        items = {infer_type(item) for item in default.values()}
        items = {float} if items == {int, float} else items
        if len(items) == 1:
            return types.GenericAlias(Mapping, (str, items.pop()))
    raise TypeError(f"default {shown(default)}: give type=; the default does not show it")


def _infer_tuple(default: tuple[object, ...] | list[object]) -> Any:
    if len(default) == 0:
        raise TypeError(f"default {default!r}: give type= (such as tuple[float, ...]), () says nothing of its elements")
    kinds = [infer_type(item) for item in default]
    if set(kinds) == {int, float}:
        kinds = [float]
    if len(set(kinds)) == 1:
        return types.GenericAlias(tuple, (kinds[0], Ellipsis))
    return types.GenericAlias(tuple, tuple(kinds))


def is_optional(kind: Any) -> bool:
    """Whether None is a value of the type."""
    return _without_none(kind)[1]


def parse_type(text: str) -> Any:
    """The type that `type_text` writes so; ValueError for an Enum and for text that is no parameter's type."""
    found = _parse_type(text.strip()) if len(text) <= _LONGEST_TYPE else None
    if found is None:
        raise ValueError(
            f"type {shown(text)}: expected bool, int, float, str, Path, tuple[...] or Mapping[str, ...] of them, or | "
            "None"
        )
    return found


def _parse_type(text: str) -> Any:
    if text.endswith("| None"):
        inner = _parse_type(text[:-6].strip())
        return None if inner is None or is_optional(inner) else inner | None
    if text in _BY_NAME:
        return _BY_NAME[text]
    if text == "Path":
        return _path()
    if text.startswith("Mapping[str,") and text.endswith("]"):
        item = _parse_type(text[12:-1].strip())
        return None if item is None else types.GenericAlias(Mapping, (str, item))
    if not (text.startswith("tuple[") and text.endswith("]")):
        return None
    parts = _split(text[6:-1])
    if len(parts) == 2 and parts[1] == "...":
        item = _parse_type(parts[0])
        return None if item is None else types.GenericAlias(tuple, (item, Ellipsis))
    items = [_parse_type(part) for part in parts]
    return None if None in items or not items else types.GenericAlias(tuple, tuple(items))


def _split(text: str) -> list[str]:
    """The parts between commas outside brackets."""
    parts, depth = [""], 0
    for character in text:
        depth += (character == "[") - (character == "]")
        if character == "," and depth == 0:
            parts.append("")
        else:
            parts[-1] += character
    return [part.strip() for part in parts]


def value_type(kind: Any) -> Any:
    """X of Mapping[str, X], also of an optional mapping; None for another type."""
    inner, _ = _without_none(kind)
    if typing.get_origin(inner) not in (Mapping, dict):
        return None
    key, item = typing.get_args(inner)
    return item if key is str else None


def element_types(kind: Any, count: int) -> tuple[Any, ...] | None:
    """The element types of a tuple (or optional tuple) of length `count`; None for a type without such tuples."""
    inner, _ = _without_none(kind)
    parts = typing.get_args(inner)
    if typing.get_origin(inner) is not tuple:
        return None
    if len(parts) == 2 and parts[1] is Ellipsis:
        return (parts[0],) * count
    return parts if len(parts) == count else None


def leaf_types(kind: Any) -> tuple[Any, ...]:
    """The scalar types inside a parameter's type; raises TypeError for one that no parameter can have."""
    inner, optional = _without_none(kind)
    if optional:
        return leaf_types(inner)
    if (item := value_type(kind)) is not None:
        return leaf_types(item)
    if typing.get_origin(kind) is tuple:
        arguments = typing.get_args(kind)
        if not arguments or arguments == (Ellipsis,):
            raise TypeError(f"type {kind!r}: say what the elements are, such as tuple[float, ...]")
        return tuple(leaf for part in arguments if part is not Ellipsis for leaf in leaf_types(part))
    if kind in _SCALARS or is_path(kind) or (isinstance(kind, type) and issubclass(kind, enum.Enum)):
        return (kind,)
    raise TypeError(
        f"type {type_text(kind)}: a parameter is bool, int, float, str, Path, an Enum, a tuple[...] or "
        "Mapping[str, ...] of them, or | None"
    )


def leaves(value: object) -> Iterator[object]:
    """The scalars inside a converted value."""
    if isinstance(value, tuple):
        for item in value:
            yield from leaves(item)
    elif isinstance(value, Mapping):
        for item in value.values():
            yield from leaves(item)
    else:
        yield value


def convert_value(value: object, kind: Any) -> Any:
    """Convert a value to `kind`; raises ValueError or TypeError with a message that says what it must be."""
    convert = _to_path if is_path(kind) else _SCALARS.get(kind)
    if convert is not None:
        return convert(_plain(value))
    inner, optional = _without_none(kind)
    if optional:
        if value is None or (inner is not str and isinstance(value, str) and value.strip().lower() == "none"):
            return None
        return convert_value(value, inner)
    if typing.get_origin(kind) is tuple:
        return _to_tuple(value, kind)
    if (item := value_type(kind)) is not None:
        return _to_mapping(value, item)
    return _to_enum(value, kind)


def _without_none(kind: Any) -> tuple[Any, bool]:
    """X of `X | None` and True; the type itself and False otherwise."""
    if typing.get_origin(kind) not in (typing.Union, types.UnionType):
        return kind, False
    others = [part for part in typing.get_args(kind) if part is not types.NoneType]
    if len(others) != 1 or len(typing.get_args(kind)) != 2:
        raise TypeError(f"type {kind!r}: of unions only X | None can be a parameter's type")
    return others[0], True


def _plain(value: object) -> object:
    """A number of an array package as Python's own, without importing that package."""
    item: Callable[[], object] | None = getattr(value, "item", None)
    return item() if item is not None and getattr(value, "shape", None) == () else value


def _to_bool(value: object) -> bool:
    found = truth_of(value) if isinstance(value, str) else value
    if isinstance(found, bool):
        return found
    raise TypeError("must be true or false")


def _to_int(value: object) -> int:
    if isinstance(value, str):
        return _int_from_text(value)
    if isinstance(value, bool | float) or not hasattr(value, "__index__"):
        raise TypeError(f"must be an int, got {_kind(value)}")
    return operator.index(typing.cast("typing.SupportsIndex", value))


def _int_from_text(text: str) -> int:
    try:
        return whole_of(text)
    except ValueError:
        raise ValueError("must be an int") from None


def _to_float(value: object) -> float:
    if isinstance(value, str):
        try:
            return float(value)
        except ValueError:
            raise ValueError("must be a float") from None
    if isinstance(value, float):
        return float(value)
    if isinstance(value, bool) or not hasattr(value, "__index__"):
        raise TypeError(f"must be a float, got {_kind(value)}")
    whole = operator.index(typing.cast("typing.SupportsIndex", value))
    try:
        result = float(whole)
    except OverflowError:
        raise ValueError("must be a float, the number is too large for one") from None
    if result != whole:
        raise ValueError(f"must be a float, and none holds this whole number exactly (nearest {result!r})")
    return result


def _to_str(value: object) -> str:
    if isinstance(value, str) and not isinstance(value, enum.Enum):
        return str(value)
    raise TypeError(f"must be text, got {_kind(value)}")


def is_path(kind: object) -> bool:
    """Whether `kind` is `pathlib.Path`, without importing that: it takes 4 ms, and few parameters are paths."""
    return getattr(kind, "__name__", "") == "Path" and kind is _path()


def _path() -> type[Path]:
    from pathlib import Path

    return Path


def _to_path(value: object) -> Path:
    path = _path()
    if isinstance(value, path):
        return value
    if not isinstance(value, str) and not hasattr(value, "__fspath__"):
        raise TypeError(f"must be a path, got {_kind(value)}")
    if value == "" or "\0" in str(value):
        raise ValueError("must be a path: not empty, without NUL")
    return path(typing.cast("str", value))


def _to_enum(value: object, kind: type[enum.Enum]) -> enum.Enum:
    if isinstance(value, kind):
        return value
    if isinstance(value, str) and value in kind.__members__:
        return kind.__members__[value]
    for member in kind:
        if type(member.value) is type(value) and member.value == value:
            return member
    raise ValueError(f"must be one of {', '.join(kind.__members__)}")


def _to_tuple(value: object, kind: Any) -> tuple[Any, ...]:
    items = items_of(value)
    parts = typing.get_args(kind)
    if len(parts) == 2 and parts[1] is Ellipsis:
        parts = (parts[0],) * len(items)
    if len(items) != len(parts):
        raise ValueError(f"must have {len(parts)} elements, got {len(items)}")
    converted = []
    for index, (item, part) in enumerate(zip(items, parts, strict=True)):
        try:
            converted.append(convert_value(item, part))
        except (TypeError, ValueError) as error:
            raise ValueError(f"element {index} ({shown(item)}) {error}") from None
    return tuple(converted)


def _to_mapping(value: object, kind: Any) -> Mapping[str, Any]:
    pairs = value if isinstance(value, Mapping) else pairs_of(value)
    converted = {}
    for key, item in pairs.items():
        if not isinstance(key, str):
            raise TypeError(f"must have texts as keys, got {shown(key)}")
        try:
            converted[key] = convert_value(item, kind)
        except (TypeError, ValueError) as error:
            raise ValueError(f"{shown(key)} ({shown(item)}) {error}") from None
    return types.MappingProxyType(converted)


def pairs_of(value: object) -> Mapping[str, object]:
    if not isinstance(value, str):
        raise TypeError(f"must be a mapping, got {_kind(value)}")
    from json import loads

    text = value.strip()
    try:
        found = loads(text)
    except RecursionError:
        raise ValueError("must be a mapping not nested too deeply") from None
    except ValueError:
        pass  # not JSON: read as bare words below
    else:
        if isinstance(found, dict):
            return found
    if text[:1] + text[-1:] == "{}":
        text = text[1:-1]
    pairs: dict[str, object] = {}
    for part in text.split(",") if text.strip() else ():
        key, colon, item = part.partition(":")
        if not colon or key.strip() in pairs:
            raise ValueError(f"must be a mapping such as {{a: 1, b: 2}}, got {shown(part.strip())}")
        pairs[key.strip()] = item.strip()
    return pairs


def items_of(value: object) -> list[object]:
    to_list: Callable[[], object] | None = getattr(value, "tolist", None)
    if to_list is not None and getattr(value, "shape", ()) != ():
        value = to_list()
    if isinstance(value, list | tuple):
        return list(value)
    if not isinstance(value, str):
        raise TypeError(f"must be a list or tuple, got {_kind(value)}")
    text = value.strip()
    if text.startswith("["):
        from json import loads

        try:
            return list(loads(text))
        except RecursionError:
            raise ValueError("must be a list, this one is nested too deeply") from None
        except ValueError:
            pass  # not JSON: read as a list of bare words below
    if text[:1] + text[-1:] in ("[]", "()"):
        text = text[1:-1]
    items: list[object] = [part.strip() for part in text.split(",")]
    return items[:-1] if items[-1] == "" else items


def _kind(value: object) -> str:
    return type(value).__name__


_SCALARS: Final[dict[Any, Callable[[object], Any]]] = {
    bool: _to_bool,
    int: _to_int,
    float: _to_float,
    str: _to_str,
}
_BY_NAME: Final = {kind.__name__: kind for kind in _SCALARS}
_LONGEST_TYPE: Final = 500
