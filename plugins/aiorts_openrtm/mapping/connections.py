"""Options of a connector: OpenRTM's properties, and their names in `connect` and a system file."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

from aiorts_openrtm.mapping.extras import MARK, extra, extra_text, frozen
from aiorts_openrtm.mapping.names import is_name
from aiorts_openrtm.notes import Note
from aiorts_openrtm.profiles.rts_profile import RtsConnector

_DATAPORT: Final = "dataport."


class _Row(NamedTuple):
    """One option: its name in aiorts, the property written for it, and other properties with the same meaning."""

    ours: str
    theirs: str
    read: Callable[[str], Any]
    others: tuple[str, ...] = ()
    usual: Any = None
    """The value that is not written in a system file."""


def _word(*words: str, **renamed: str) -> Callable[[str], str]:
    def read(text: str) -> str:
        word = text.strip().lower()
        word = renamed.get(word, word)
        if word not in words:
            raise ValueError(f"expected {', '.join((*words, *renamed))}")
        return word

    return read


def _whole(least: int) -> Callable[[str], int]:
    def read(text: str) -> int:
        if not re.fullmatch(r"\d{1,7}", text.strip()) or not least <= int(text) <= 1_000_000:
            raise ValueError(f"expected a whole number from {least} to 1000000")
        return int(text)

    return read


def _number(text: str) -> float:
    try:
        number = float(text[:40])
    except ValueError:
        number = -1.0
    if not 0 <= number <= 1e6:
        raise ValueError("expected a number from 0 on")
    return number


_ROWS: Final = (
    _Row("dataflow", "dataflow_type", _word("push", "pull"), (), "push"),
    _Row("subscription", "subscription_type", _word("flush", "new", "periodic"), ("io_mode",), "flush"),
    _Row("push", "publisher.push_policy", _word("all", "fifo", "skip", "new"), ("push_policy",)),
    _Row("push_rate", "publisher.push_rate", _number, ("push_rate", "push_interval"), 0.0),
    _Row("skip", "publisher.skip_count", _whole(0), ("skip_count",), 0),
    _Row("length", "inport.buffer.length", _whole(1), ("buffer.length",), 8),
    _Row("out_length", "outport.buffer.length", _whole(1), (), 8),
    _Row(
        "full",
        "inport.buffer.write.full_policy",
        _word("overwrite", "reject", "block", do_nothing="reject"),
        ("buffer.write.full_policy",),
        "overwrite",
    ),
    _Row("timeout", "inport.buffer.write.timeout", _number, ("buffer.write.timeout",), 1.0),
    _Row(
        "empty",
        "inport.buffer.read.empty_policy",
        _word("readback", "do_nothing", "block"),
        ("buffer.read.empty_policy",),
        "readback",
    ),
    _Row(
        "stamp",
        "timestamp_policy",
        _word("send", "received", "read", "none", on_send="send", on_received="received", on_read="read"),
        (),
        "none",
    ),
)
_OUT_WORDS: Final = {"full": {"reject": "do_nothing"}, "stamp": {"send": "on_send", "received": "on_received"}}
_ATTRIBUTES: Final = {"dataflow": "dataflowType", "subscription": "subscriptionType", "push_rate": "pushInterval"}
"""Options that are attributes of the basic profile, too."""
_SAME: Final = frozenset({"data_type", "interface_type", "outport.data_type", "inport.data_type"})
"""Properties that the connector's attributes or the ports state, too."""


def options_of(one: RtsConnector, notes: list[Note]) -> dict[str, Any]:
    """The options of a connection in a system file, without those that have their default."""
    given = {key.removeprefix(_DATAPORT): value for key, value in one.properties.items()}
    kept = set(given) - _SAME - {key for key in given if key.startswith(MARK)}
    found: dict[str, Any] = {}
    for row in _ROWS if one.is_data else ():
        attribute = one.values.get(_ATTRIBUTES.get(row.ours, ""), "")
        keys = [key for key in (row.theirs, *row.others) if given.get(key)]
        kept -= {row.theirs, *row.others}
        text = given[keys[0]] if keys else attribute
        if not text:
            continue
        try:
            found[row.ours] = row.read(text)
        except ValueError as error:
            notes.append(Note(one.where, f"{row.theirs} = {text!r:.60}: {error}; it is left out"))
    if given.get("sync_readwrite", "").upper() in ("YES", "TRUE"):
        found["length"] = 0
        kept.discard("sync_readwrite")
    _without_effect(found)
    for key, text in one.properties.items():
        if key.startswith(MARK):
            value = extra({key: text}, key.removeprefix(MARK), object, one.where, notes)
            found.update({} if value is None else {key.removeprefix(MARK): frozen(value)})
    if kept:
        listed = ", ".join(sorted(kept)[:4]) + (f" and {len(kept) - 4} more" if len(kept) > 4 else "")
        notes.append(Note(one.where, f"{listed}: of OpenRTM's transports and tools; nothing here acts on them"))
    if is_name(one.name):
        found["name"] = one.name
    order = [*(row.ours for row in _ROWS), *sorted(found)]
    return {key: found[key] for key in dict.fromkeys(order) if key in found}


def _without_effect(found: dict[str, Any]) -> None:
    """Remove options that have their default, and options that have no effect given the others."""
    subscription = found.get("subscription", "flush")
    if subscription == "flush":
        for key in ("push", "push_rate", "skip", "out_length"):
            found.pop(key, None)
    if subscription != "periodic":
        found.pop("push_rate", None)
        found.pop("out_length", None)
    if found.get("push") != "skip":
        found.pop("skip", None)
    if found.get("full") != "block":
        found.pop("timeout", None)
    if found.get("push") == "new":
        del found["push"]
    for row in _ROWS:
        if row.usual is not None and found.get(row.ours) == row.usual:
            del found[row.ours]


def properties_of(options: Mapping[str, Any]) -> dict[str, str]:
    """The properties that state these options, by OpenRTM's names, or as extras."""
    rows = {row.ours: row for row in _ROWS}
    found = {}
    for key, value in options.items():
        if key == "name":
            continue
        if value is None:  # only a timeout may be None: it never ends
            value = math.inf
        if key == "length" and value == 0:
            found[f"{_DATAPORT}sync_readwrite"] = "YES"
        elif key in rows and isinstance(value, str | int | float) and value != math.inf:
            word = _OUT_WORDS.get(key, {}).get(str(value), str(value))
            found[f"{_DATAPORT}{rows[key].theirs}"] = word
        elif "." in key:
            found[key] = str(value)
        else:
            found[f"{MARK}{key}"] = extra_text(value)
    return found


def attributes_of(options: Mapping[str, Any]) -> dict[str, str | None]:
    """The attributes of a connector of data ports that state these options."""
    rate = options.get("push_rate")
    return {
        "dataflowType": str(options.get("dataflow", "push")),
        "subscriptionType": str(options.get("subscription", "flush")),
        "pushInterval": None if rate is None else str(float(rate)),
    }


def spellings(ours: str) -> tuple[str, ...]:
    """All properties that state one option."""
    row = next((row for row in _ROWS if row.ours == ours), None)
    if row is None:
        return (f"{MARK}{ours}", ours)
    words = (row.theirs, *row.others, *(("sync_readwrite",) if ours == "length" else ()))
    return (*words, *(f"{_DATAPORT}{word}" for word in words), f"{MARK}{ours}")
