"""The tree of a profile as YAML, in the form that OpenRTM's tools read."""

from __future__ import annotations

import re
from typing import Any, Final

from aiorts.errors import MissingExtra
from aiorts_openrtm.markup.element import XMLNS, Attribute, Comment, Element
from aiorts_openrtm.markup.shapes import (
    BOOLEANS,
    CONDITIONS,
    DATE_PARTS,
    DATES,
    LISTS,
    NUMBERS,
    RTS,
    RTS_EXT,
    TYPES,
    WHOLE,
    XSI,
    key_of,
)
from aiorts_openrtm.notes import Note

_DATE: Final = re.compile(r"(\d{4})-(\d{2})-(\d{2})(?:T(\d{2}):(\d{2}):(\d{2}))?(.*)")
_WHOLE_NUMBER: Final = re.compile(r"-?(?:0|[1-9]\d{0,17})")


def yaml_of_element(root: Element, notes: list[Note]) -> str:
    """The text of a profile; `notes` gets a note on each thing that YAML cannot state.

    Raises:
        MissingExtra: PyYAML is not installed.
    """
    try:
        import yaml
    except ImportError:
        raise MissingExtra("YAML of OpenRTM", "pyyaml", "openrtm") from None
    dumper = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
    tree = {"rtsProfile": _Writer(notes).table(root)}
    text: str = yaml.dump(tree, Dumper=dumper, sort_keys=False, allow_unicode=True, width=1000)
    return text


class _Writer:
    """Makes tables and lists of elements."""

    def __init__(self, notes: list[Note]) -> None:
        self._notes = notes

    def table(self, element: Element) -> dict[str, Any]:
        """The table of an element's attributes and children."""
        found: dict[str, Any] = {}
        for one in element.attributes:
            if one.space == XMLNS or self._is_known_type(element, one):
                continue
            if one.space not in (RTS, RTS_EXT, ""):
                self._lost(element, f"the attribute {one.name}")
                continue
            found[self._key(element, one)] = self._value(element, one)
        for child in element.children:
            if isinstance(child, Comment):
                self._lost(element, "a comment")
            elif isinstance(child, str):
                if child.strip():
                    self._lost(element, f"the text {child.strip()[:40]!r}")
            else:
                self._add(found, element, child)
        return found

    def _add(self, found: dict[str, Any], element: Element, child: Element) -> None:
        if child.space not in (RTS, RTS_EXT, ""):
            self._lost(child, f"the element {child.name}")
            return
        key = key_of(child.local, ext=child.space == RTS_EXT)
        table: Any = self.table(child) if child.attributes or list(child.elements()) else child.text
        if element.local == "targets" and child.local in CONDITIONS:
            found["condition"] = {key: table or {}}
        elif child.local in LISTS:
            found.setdefault(key, []).append(table)
        elif key in found:
            before = found[key]
            found[key] = [*before, table] if isinstance(before, list) else [before, table]
        else:
            found[key] = table

    def _key(self, element: Element, one: Attribute) -> str:
        return key_of(one.local, ext=one.space == RTS_EXT and element.space != RTS_EXT)

    def _value(self, element: Element, one: Attribute) -> Any:
        text, word = one.value, one.local
        if word in BOOLEANS and text.lower() in ("true", "false"):
            return text.lower() == "true"
        if word in WHOLE and _WHOLE_NUMBER.fullmatch(text):
            return int(text)
        if word in NUMBERS:
            return self._number(text)
        if word in DATES and (date := _DATE.fullmatch(text)) is not None:
            if date[7]:
                self._lost(element, f"{date[7]!r} of {word}")
            return {name: int(part or 0) for name, part in zip(DATE_PARTS, date.groups(), strict=False)}
        return text.upper() if word == "direction" else text

    def _number(self, text: str) -> Any:
        try:
            number = float(text)
        except ValueError:
            return text
        return number if str(number) == text else text

    def _is_known_type(self, element: Element, one: Attribute) -> bool:
        return (one.space, one.local, one.value) == (XSI, "type", f"rtsExt:{TYPES.get(element.local)}")

    def _lost(self, element: Element, what: str) -> None:
        self._notes.append(Note(element.where, f"{what} cannot stand in YAML, and is left out"))
