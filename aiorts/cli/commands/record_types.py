"""Descriptions of record types for people and tools (fields, defaults, group, OpenRTM's name); `aiorts types`."""

from __future__ import annotations

import dataclasses
import inspect
from enum import Enum
from typing import Any, Final

import click

from aiorts import exits
from aiorts.cli.console.completion import type_names
from aiorts.cli.console.output import plain, say, say_json, table
from aiorts.cli.console.report import report
from aiorts.cli.console.subjects import load_declared
from aiorts.errors import UnknownTypeError
from aiorts.kernel.extensions.type_modules import import_types
from aiorts.spelling import meant
from aiorts.types import all_types, fields_of, full_name, has_tm, type_name, with_tm
from aiorts.wire import LineReader, line_of

GROUPS: Final = ("basic", "extended", "interface", "extra", "ros", "user")
_IDL: Final = {"basic": "BasicDataType.idl", "extended": "ExtendedDataTypes.idl", "interface": "InterfaceDataTypes.idl"}
_TM: Final = 1_700_000_000_000_000_000
_WIDEST: Final = 64


def group_of(cls: type) -> str:
    """The group of a type: basic, extended, interface (as in OpenRTM), extra (of aiorts), ros, or user."""
    package, _, group = cls.__module__.rpartition(".")
    if package == "aiorts.types.ros":
        return "ros"
    if full_name(cls).startswith("aiorts.types."):
        return group if package == "aiorts.types" and group in GROUPS else "extra"
    return "user"


def origin_of(cls: type) -> str:
    """The place in OpenRTM that defines the type, "" when there is none."""
    idl = _IDL.get(group_of(cls), "")
    return f"RTC::{cls.__name__} in {idl}" if idl else ""


def example_of(cls: type) -> str:
    """A line that filters read, made from the type's defaults; "" for a type that no line can carry."""
    if issubclass(cls, Enum):
        return ""
    try:
        sample: Any = cls()
        sample = with_tm(sample, _TM) if has_tm(cls) else sample
        line = line_of("input0", sample)
        LineReader({"input0": cls}).sample(line, 0)
    except Exception:  # noqa: BLE001 - a user's constructor may raise anything, or need fields without a default
        return ""
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
    fields = [
        {
            "name": field.name,
            "type": field.spelling,
            "default": _default(field),
            "required": not field.has_default,
            "unit": field.unit or ("ns" if field.name == "tm" and has_tm(cls) else ""),
            "doc": field.doc or (_TM_DOC if field.name == "tm" and has_tm(cls) else ""),
        }
        for field in fields_of(cls)
    ]
    return {**common, "kind": "record", "fields": fields, "example": example_of(cls)}


_TM_DOC: Final = "time stamp, since the epoch"


def _default(field: Any) -> Any:
    """The default as a class body has it; None when there is none."""
    value = field.default
    if value is dataclasses.MISSING:
        return None if field.factory is dataclasses.MISSING else "()"
    if hasattr(value, "utcoffset"):
        return value.isoformat()
    if hasattr(value, "tolist"):
        value = value.tolist()
    return f"{value}" if isinstance(value, Enum) else plain(value)


@click.command(short_help="List the record types that ports can have.")
@click.argument("pattern", default="", shell_complete=type_names)
@click.option("--group", type=click.Choice(GROUPS), help="Only those of this group.")
@click.option("--type-mod", "modules", multiple=True, metavar="MODULE", help="Import MODULE, which defines types.")
@click.option("--json", "as_json", is_flag=True, help="One JSON document.")
def types(pattern: str, group: str | None, modules: tuple[str, ...], as_json: bool) -> int:
    """List the record types whose name contains PATTERN, with their fields in short.

    PATTERN may have * and ?, as in "Timed*Seq"; upper and lower case are the same. All of one: `aiorts inspect NAME`.
    A line of JSON may leave out each field that has a default.
    """
    import aiorts.types.ros  # noqa: F401 - else loaded when a name of theirs is asked for

    import_types(modules)
    broken = load_declared(lambda name: _fits(name, pattern))
    listed = _listed(pattern, group)
    if not listed and not broken:
        load_declared()  # the type may be declared only as a field of another
        listed = _listed(pattern, group)
    if not listed and (pattern or group):
        names = {cls.__name__.lower(): cls.__name__ for cls in all_types().values()}
        reason = f": {broken[0]}" if broken else f"{_near(pattern, names)}; aiorts types lists all"
        raise UnknownTypeError(f"no type matches {pattern[:60]!r}{reason}")
    for fault in broken:
        report("E-PLUGIN", fault)
    listed.sort(key=lambda cls: GROUPS.index(group_of(cls)))
    if as_json:
        say_json([profile_of_type(cls) for cls in listed])
    else:
        say(table([(type_name(cls), group_of(cls), short_of(cls)) for cls in listed], indent=""))
    return exits.DONE


def _listed(pattern: str, group: str | None) -> list[type]:
    return [cls for cls in all_types().values() if _fits(full_name(cls), pattern) and group in (None, group_of(cls))]


def _fits(name: str, pattern: str) -> bool:
    """Whether a full name, or the class name at its end, matches the pattern."""
    from fnmatch import fnmatchcase

    wanted = pattern.lower()
    wanted = wanted if set(wanted) & set("*?[") else f"*{wanted}*"
    return any(fnmatchcase(one, wanted) for one in (name.lower(), name.lower().rpartition(".")[2]))


def _near(pattern: str, names: dict[str, str]) -> str:
    return meant(pattern.lower(), names, names.__getitem__, most=3)


def short_of(cls: type) -> str:
    """The fields, or the members of an enum, in one short line."""
    if issubclass(cls, Enum):
        text = f"enum {', '.join(member.name for member in cls)}"
    else:
        text = ", ".join(f"{field.name}: {field.spelling}" for field in fields_of(cls))
    return text if len(text) <= _WIDEST else f"{text[: _WIDEST - 3]}..."
