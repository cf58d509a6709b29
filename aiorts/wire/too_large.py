"""Finds types whose samples may be too large for a frame, from their fields, before there is any sample."""

from __future__ import annotations

from aiorts.types import fields_of
from aiorts.wire.arrays import ELEMENTS
from aiorts.wire.limits import DATA, MIB, Limits

_MAPS = ("map", "dict")


def excess(cls: type, limits: Limits = DATA) -> str:
    """The parts of this type's samples that a frame may refuse: "a text above 1 MiB"; "" where every sample fits.

    Arrays of numbers are left out: only the size of the whole frame bounds them.
    """
    spellings = [one.removeprefix("optional[") for one in _spellings(cls, set())]
    said = []
    if any("str" in one for one in spellings):
        said.append(f"a text above {limits.string / MIB:g} MiB")
    if any(_is_list(one) for one in spellings):
        said.append(f"{limits.values:,} values or more")
    return " or ".join(said)


def _spellings(cls: type, seen: set[type]) -> list[str]:
    """The kinds of all fields, those of records within included."""
    if cls is str:
        return ["str"]
    if not hasattr(cls, "__dataclass_fields__") or cls in seen:
        return []
    seen.add(cls)
    found = []
    for field in fields_of(cls):
        found.append(field.spelling)
        if field.record is not None:
            found += _spellings(field.record, seen)
    return found


def _is_list(spelling: str) -> bool:
    if spelling.startswith(_MAPS):
        return True
    return spelling.startswith("seq[") and spelling.removeprefix("seq[").rstrip("]") not in ELEMENTS
