"""Finds the FlexiFilter that would join two unfit ports, as text for the file; FlexiFilter itself checks that."""

from __future__ import annotations

import json
from typing import Any

from aiorts.adapting import Between, between, filter_name, is_accepted
from aiorts.kernel.ports import InPort, OutPort
from aiorts.late import dataclass
from aiorts.model.wanted.entries import ConnectionEntry
from aiorts.system.file.survey import Survey


@dataclass(frozen=True, slots=True)
class Adaptation:
    """The FlexiFilter that would join the two ports: one line to read, and text for the file."""

    remedy: str
    text: str


def adaptation(found: Survey, connection: ConnectionEntry, out: OutPort[Any], in_: InPort[Any]) -> Adaptation | None:
    """The entry of a FlexiFilter between these two ports; None if no known filter joins them."""
    proposed = between(out, in_)
    if proposed is None or not proposed.entries or not is_accepted(found.catalogue, proposed):
        return None
    return _told(found, connection, out, in_, proposed)


def _told(
    found: Survey,
    connection: ConnectionEntry,
    out: OutPort[Any],
    in_: InPort[Any],
    proposed: Between,
) -> Adaptation:
    name = filter_name(out.path, in_.path, {*found.system.components, *found.system.composites})
    options = json.dumps(proposed.options)
    kept = "".join(
        f"{word} = {_toml(value)}\n" for word, value in connection.options.items() if word not in ("name", "stamp")
    )
    reader = in_.path.partition(".")[0]
    homes = (one.name for one in found.system.contexts.values() if reader in one.members)
    home = next((one for one in homes if one in found.contexts and not found.contexts[one].exclusive), "")
    place = f"contexts.{home}, before {reader!r}" if home else "an event context"
    guess = "".join(
        f"# {written} is a guess: {port.path} does not say how many elements it has\n"
        for port, written in ((out, proposed.source), (in_, proposed.target))
        if port.path in proposed.guessed
    )
    guess += "".join(
        f"# {what} is made of a text: one that is no value of it puts the filter into error\n"
        for what in proposed.texts
    )
    replaced = f"in place of connections[{connection.number}]"
    if len(connection.ports) > 2:
        replaced = f'and take "{in_.path}" out of connections[{connection.number}]'
    text = (
        f'{guess}[components.{name}]\ntype = "FlexiFilter"\noptions = {options}\n\n'
        f"# {replaced}\n"
        f'[[connections]]\nfrom = "{out.path}"\nto = "{name}.input0"\n{kept}\n'
        f'[[connections]]\nfrom = "{name}.output0"\nto = "{in_.path}"\n{kept}'
        f"# and in the members of {place}: {name!r}\n"
    )
    return Adaptation(f"put the FlexiFilter {name!r} between them, as below", text)


def _toml(value: Any) -> str:
    return "inf" if value is None else json.dumps(value)
