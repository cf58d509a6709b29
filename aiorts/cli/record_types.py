"""Record types as people and tools read them: fields, defaults, group, where OpenRTM has them; and `aiorts types`."""

from __future__ import annotations

import dataclasses
import inspect
from enum import Enum
from typing import Any, Final

import click

from aiorts.cli.completion import type_names
from aiorts.cli.output import plain, say, say_json, table
from aiorts.cli.type_modules import import_types
from aiorts.errors import RecordError, UnknownTypeError
from aiorts.types import all_types, fields_of, full_name, has_tm, type_name
from aiorts.wire import LineReader, line_of

__all__ = ("GROUPS", "example_of", "group_of", "profile_of_type", "types")

GROUPS: Final = ("basic", "extended", "interface", "extra", "user")
_IDL: Final = {
    "basic": "BasicDataType.idl",
    "extended": "ExtendedDataTypes.idl",
    "interface": "InterfaceDataTypes.idl",
}
_TM: Final = 1_700_000_000_000_000_000
_WIDEST: Final = 64


def group_of(cls: type) -> str:
    """basic, extended, interface (as in OpenRTM), extra (ours), or user."""
    package, _, group = cls.__module__.rpartition(".")
    if full_name(cls).startswith("aiorts.types."):
        return group if package == "aiorts.types" and group in GROUPS else "extra"
    return "user"


def origin_of(cls: type) -> str:
    """Where OpenRTM defines it, "" where it does not."""
    idl = _IDL.get(group_of(cls), "")
    return f"RTC::{cls.__name__} in {idl}" if idl else ""


def example_of(cls: type) -> str:
    """A line that the filters read, made of the type's defaults; "" for a type that no line can carry."""
    if issubclass(cls, Enum):
        return ""
    try:
        make: Any = cls
        sample = make(tm=_TM) if has_tm(cls) else make()
        line = line_of("input0", sample)
        LineReader({"input0": cls}).sample(line, 0)
    except (RecordError, TypeError, ValueError):
        return ""  # a dataclass of the user's may have fields without a default
    return line


def profile_of_type(cls: type) -> dict[str, Any]:
    """The type as plain data."""
    doc = inspect.cleandoc(cls.__doc__ or "")
    common = {
        "name": type_name(cls),
        "full_name": full_name(cls),
        "group": group_of(cls),
        "openrtm": origin_of(cls),
        "doc": "" if doc.startswith(f"{cls.__name__}(") else doc,
    }
    if issubclass(cls, Enum):
        return {**common, "kind": "enum", "members": {member.name: plain(member.value) for member in cls}}
    if not dataclasses.is_dataclass(cls):
        return {**common, "kind": "plain", "doc": f"A bare {cls.__name__}.", "example": example_of(cls)}
    notes: dict[str, Any] = {field.name: field.metadata for field in dataclasses.fields(cls)}
    fields = [
        {
            "name": field.name,
            "type": field.spelling,
            "default": _default(field),
            "unit": str(notes.get(field.name, {}).get("unit", "ns" if field.name == "tm" and has_tm(cls) else "")),
            "doc": str(notes.get(field.name, {}).get("doc", _TM_DOC if field.name == "tm" and has_tm(cls) else "")),
        }
        for field in fields_of(cls)
    ]
    return {**common, "kind": "record", "fields": fields, "example": example_of(cls)}


_TM_DOC: Final = "time stamp, since the epoch"


def _default(field: Any) -> Any:
    """The default as it stands in a class body; None is that there is none."""
    value = field.default
    if value is dataclasses.MISSING:
        return None if field.factory is dataclasses.MISSING else "()"
    return f"{value}" if isinstance(value, Enum) else plain(value)


@click.command(short_help="List the record types that ports can have.")
@click.argument("pattern", default="", shell_complete=type_names)
@click.option("--group", type=click.Choice(GROUPS), help="Only those of this group.")
@click.option("--type-mod", "modules", multiple=True, metavar="MODULE", help="Import MODULE, which defines types.")
@click.option("--json", "as_json", is_flag=True, help="One JSON document.")
def types(pattern: str, group: str | None, modules: tuple[str, ...], as_json: bool) -> int:
    """List the record types whose name contains PATTERN, with their fields in short.

    PATTERN may have * and ?, as in "Timed*Seq"; upper and lower case are the same. All of one: `aiorts inspect NAME`.
    """
    import_types(modules)
    listed = [cls for cls in all_types().values() if _matches(cls, pattern) and group in (None, group_of(cls))]
    if not listed and (pattern or group):
        names = {cls.__name__.lower(): cls.__name__ for cls in all_types().values()}
        raise UnknownTypeError(f"no type matches {pattern[:60]!r}{_near(pattern, names)}; aiorts types lists all")
    listed.sort(key=lambda cls: GROUPS.index(group_of(cls)))
    if as_json:
        say_json([profile_of_type(cls) for cls in listed])
    else:
        say(table([(type_name(cls), group_of(cls), short_of(cls)) for cls in listed], indent=""))
    return 0


def _matches(cls: type, pattern: str) -> bool:
    from fnmatch import fnmatchcase

    wanted = pattern.lower()
    wanted = wanted if set(wanted) & set("*?[") else f"*{wanted}*"
    return fnmatchcase(cls.__name__.lower(), wanted) or fnmatchcase(full_name(cls).lower(), wanted)


def _near(pattern: str, names: dict[str, str]) -> str:
    from difflib import get_close_matches

    near = get_close_matches(pattern[:100].lower(), names, n=3)
    return f"; did you mean {' or '.join(names[one] for one in near)}?" if near else ""


def short_of(cls: type) -> str:
    """The fields, or the members of an enumeration, in one short line."""
    if issubclass(cls, Enum):
        text = f"enum {', '.join(member.name for member in cls)}"
    else:
        text = ", ".join(f"{field.name}: {field.spelling}" for field in fields_of(cls))
    return text if len(text) <= _WIDEST else f"{text[: _WIDEST - 3]}..."
