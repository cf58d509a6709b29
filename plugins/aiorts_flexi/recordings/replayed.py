"""Decides which ports of a recording are replayed, and their names and types.

A recording may come from anywhere: a type that is not loaded is refused by the port's name, and nothing that a file
names is ever imported.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from aiorts.errors import ConfigurationError
from aiorts.spelling import suggestion
from aiorts_log import RecordingError, open_recording

_UNFIT: Final = re.compile(r"[^A-Za-z0-9_-]+")
_LONGEST: Final = 100
"""Characters of a port's name."""
_MOST_NAMES: Final = 10


class RecordedAs(NamedTuple):
    """A port as a recording has it."""

    name: str
    keys: tuple[str, ...]
    """The port's channels: a port with records of a subclass has several."""
    types: tuple[Any, ...]
    """The type of each channel; None where it is not loaded."""
    unknown: str
    """The reason why one of the types is not loaded; "" when all types are."""
    unit: str


class Contents(NamedTuple):
    """The facts on a file that have to be known before it is replayed."""

    path: Path
    stamp: tuple[int, ...]
    """A value that differs when the file differs."""
    ports: tuple[RecordedAs, ...]
    start: int
    """The first log time, in ns."""


class Replayed(NamedTuple):
    """A port that is replayed."""

    type: type
    unit: str | None
    keys: tuple[str, ...]


def look_into(path: Path, known: Contents | None = None) -> Contents:
    """Read the content of a file; return `known` if the file is unchanged.

    Raises:
        ConfigurationError: the file cannot be read, or is no recording.
    """
    stamp = _stamp(path)
    if known is not None and known.path == path and stamp in (known.stamp, ()):
        return known
    try:
        with open_recording(path) as reader:
            return Contents(path, stamp, _grouped(reader.ports), reader.start)
    except RecordingError as error:
        raise ConfigurationError(str(error)) from error


def _stamp(path: Path) -> tuple[int, ...]:
    try:
        found = os.stat(path)
    except (OSError, ValueError):
        return ()
    return found.st_ino, found.st_size, found.st_mtime_ns


def _grouped(ports: Mapping[str, Any]) -> tuple[RecordedAs, ...]:
    """Ports by their names, each with all of its channels."""
    channels: dict[str, list[str]] = {}
    for key, port in ports.items():
        if port.count or not port.unknown:  # a port without samples may have an unknown type: it is left out
            channels.setdefault(port.name, []).append(key)
    return tuple(
        RecordedAs(
            name,
            tuple(keys),
            tuple(ports[key].type for key in keys),
            next((ports[key].unknown for key in keys if ports[key].unknown), ""),
            str(ports[keys[0]].metadata.get("unit", "")),
        )
        for name, keys in channels.items()
    )


def replayed_ports(
    contents: Contents, only: Sequence[str], skip: Sequence[str], remap: Sequence[str]
) -> dict[str, Replayed]:
    """The replayed out-ports by their names.

    Args:
        only: the wanted names in the recording; none is all.
        skip: names to leave out.
        remap: OLD=NEW: the name in the recording, and that of the out-port.

    Raises:
        ConfigurationError: a port does not exist, its type is not loaded, or its name is taken; the port is named.
    """
    there = {port.name: port for port in contents.ports}
    new_names = _remapped(remap)
    _check_names(contents.path, there, {"ports": only, "skip": skip, "remap": tuple(new_names)})
    wanted = [port for port in contents.ports if (not only or port.name in only) and port.name not in skip]
    if not there:
        raise ConfigurationError(f"{contents.path}: nothing was recorded in it: it has no port to replay")
    if not wanted:
        raise ConfigurationError(f"{contents.path}: ports and skip leave no port to replay; there are {_list(there)}")
    _check_types(contents.path, [port for port in wanted if port.unknown])
    found: dict[str, Replayed] = {}
    old_names: dict[str, str] = {}
    for port in wanted:
        name = new_names.get(port.name) or _fitting(port.name)
        if name in found:
            raise ConfigurationError(
                f"{contents.path}: ports {old_names[name][:60]!r} and {port.name[:60]!r} would both be {name!r}; "
                "give one of them another name with remap = OLD=NEW"
            )
        found[name] = Replayed(_common(contents.path, port), port.unit or None, port.keys)
        old_names[name] = port.name
    return found


def _remapped(remap: Sequence[str]) -> dict[str, str]:
    found: dict[str, str] = {}
    for text in remap:
        old, sign, new = text.rpartition("=")
        if not (old and sign and new) or _fitting(new) != new:
            raise ConfigurationError(f"remap: expected OLD=NEW with a port's name, got {text[:80]!r}").at(text, 0)
        if old in found:
            raise ConfigurationError(f"remap: port {old[:60]!r} is given two names; give it one")
        found[old] = new
    return found


def _check_names(path: Path, there: Mapping[str, RecordedAs], requested: Mapping[str, Sequence[str]]) -> None:
    for what, names in requested.items():
        for name in names:
            if name not in there:
                hint = suggestion(name, there, f"there are {_list(there)}")
                raise ConfigurationError(f"{what}: {path} has no port {name[:60]!r}; {hint}")


def _check_types(path: Path, unknown: Sequence[RecordedAs]) -> None:
    if unknown:
        first = unknown[0]
        raise ConfigurationError(
            f"{path}: port {first.name[:60]!r}: {first.unknown}, or leave it out: "
            f"--skip {','.join(port.name[:60] for port in unknown[:_MOST_NAMES])}"
        )


def _common(path: Path, port: RecordedAs) -> type:
    """The type that all samples of a port have in common."""
    for cls in port.types:
        if all(issubclass(other, cls) for other in port.types):
            return cls  # type: ignore[no-any-return]
    names = ", ".join(cls.__name__ for cls in port.types)
    raise ConfigurationError(
        f"{path}: port {port.name[:60]!r} has samples of several types: {names}; leave it out: --skip {port.name[:60]}"
    )


def _fitting(name: str) -> str:
    """The name, or a similar one that a port may have: `/imu/data` becomes `imu_data`."""
    fitting = _UNFIT.sub("_", name)
    if fitting != name:
        fitting = fitting.strip("_")
    return fitting.lstrip("-")[:_LONGEST] or "port"


def _list(names: Mapping[str, object]) -> str:
    more = f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
    return ", ".join([repr(name[:60]) for name in names][:_MOST_NAMES]) + more or "none"
