"""YAML of a profile to the tree that its XML would be. No tag makes an object, and aliases are bounded."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from aiorts.errors import MissingExtra
from aiorts_openrtm.errors import OpenRTMError
from aiorts_openrtm.markup.element import Attribute, Element
from aiorts_openrtm.markup.shapes import (
    BOOLEANS,
    DATE_PARTS,
    DATES,
    EXT_MARK,
    ROOT,
    attribute,
    in_order,
    made,
    made_root,
    of_key,
)
from aiorts_openrtm.markup.source import DEEPEST

MOST_ALIASES: Final = 100
_MOST_AGAIN: Final = 100_000
"""The most values that all aliases together repeat."""
_PLAIN_TAGS: Final = ("!", *(f"tag:yaml.org,2002:{kind}" for kind in ("str", "int", "float", "bool", "map", "seq")))
_WORD: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_.-]{0,99}")
_DIGITS: Final = re.compile(r"\d{1,4}")
_TRUE: Final = frozenset({"true", "yes", "on"})
_FALSE: Final = frozenset({"false", "no", "off"})
_NOTHING: Final = frozenset({"", "~", "null", "Null", "NULL"})


@dataclass(frozen=True, slots=True)
class _Node:
    """One value: a text, a table or a list."""

    where: str
    text: str | None = None
    plain: bool = False
    """Whether the text stands in the file without quotes."""
    pairs: tuple[tuple[str, _Node], ...] | None = None
    items: tuple[_Node, ...] | None = None
    size: int = 1

    @property
    def is_nothing(self) -> bool:
        """Whether it is null."""
        return self.text is not None and self.plain and self.text in _NOTHING


def element_of_yaml(text: str, path: Path | str) -> Element:
    """The root element of a profile.

    Raises:
        OpenRTMError: it is no YAML, or no profile; the message has the line.
        MissingExtra: PyYAML is not installed.
    """
    top = _Reader(text, path).document()
    found = dict(top.pairs or ())
    if "rtsProfile" not in found:
        raise OpenRTMError(f"{top.where}: not a profile of a system: expected rtsProfile at the top")
    if len(found) > 1:
        others = ", ".join(repr(key[:40]) for key in found if key != "rtsProfile")
        raise OpenRTMError(f"{top.where}: {others} beside rtsProfile has no place in a profile; take it away")
    root = _element(ROOT, found["rtsProfile"], ext=False)
    new = made_root(where=root.where)
    return replace(new, attributes=(*new.attributes, *root.attributes), children=root.children)


def _element(local: str, node: _Node, *, ext: bool) -> Element:
    if node.items is not None:
        raise OpenRTMError(f"{node.where}: {local}: expected a table, got a list")
    if node.pairs is None:
        return made(local, *([node.text] if node.text else []), ext=ext, where=node.where)
    attributes: list[Attribute] = []
    children: list[Element] = []
    for key, value in node.pairs:
        is_ext = ext or key.startswith(EXT_MARK)
        word = key.removeprefix(EXT_MARK)
        if not _WORD.fullmatch(word):
            raise OpenRTMError(f"{value.where}: {key[:80]!r} cannot be a name in a profile; write letters and digits")
        if value.is_nothing:
            continue
        if key == "condition" and local == "targets":
            children += [_element(of_key(inner)[0], one, ext=False) for inner, one in value.pairs or ()]
        elif value.text is not None:
            attributes.append(attribute(word, _scalar(word, value), ext=is_ext))
        elif key in DATES and value.pairs is not None:
            attributes.append(attribute(key, _date(value)))
        else:
            name, inner_ext = of_key(key)
            for one in value.items if value.items is not None else (value,):
                children.append(_element(name, one, ext=ext or inner_ext))
    element = made(local, ext=ext, where=node.where)
    return replace(element, attributes=(*element.attributes, *attributes), children=in_order(children))


def _scalar(word: str, node: _Node) -> str:
    """The text of a value as XML has it."""
    text = node.text or ""
    if word in BOOLEANS and text.lower() in _TRUE | _FALSE:
        return "true" if text.lower() in _TRUE else "false"
    return text.lower() if word == "direction" else text


def _date(node: _Node) -> str:
    parts = {key: one.text or "" for key, one in node.pairs or ()}
    if not all(_DIGITS.fullmatch(parts.get(name, "0")) for name in DATE_PARTS) or "year" not in parts:
        raise OpenRTMError(f"{node.where}: expected year, month, day, hour, minute and second, as numbers")
    year, *others = (int(parts.get(name, "0")) for name in DATE_PARTS)
    month, day, hour, minute, second = others
    return f"{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}"


class _Reader:
    """Reads the events of a safe loader, and makes values of them without any object."""

    def __init__(self, text: str, path: Path | str) -> None:
        self._text = text
        self._path = path
        self._anchors: dict[str, _Node | None] = {}
        self._aliases = self._again = 0

    def document(self) -> _Node:
        """The only document of the file."""
        try:
            import yaml
        except ImportError:
            raise MissingExtra("YAML of OpenRTM", "pyyaml", "openrtm") from None
        loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
        try:
            events = yaml.parse(self._text, Loader=loader)
            found = [self._node(event, events, 1) for event in events if isinstance(event, yaml.NodeEvent)]
        except yaml.YAMLError as error:
            mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
            line = 1 if mark is None else mark.line + 1
            what = getattr(error, "problem", None) or str(error).splitlines()[0]
            raise OpenRTMError(f"{self._path}:{line}: not valid YAML: {what}") from None
        if len(found) != 1:
            raise OpenRTMError(f"{self._path}:1: expected one document, got {len(found)}")
        return found[0]

    def _node(self, event: Any, events: Iterator[Any], depth: int) -> _Node:
        kind = type(event).__name__
        where = f"{self._path}:{event.start_mark.line + 1}"
        if depth > DEEPEST:
            raise OpenRTMError(f"{where}: more than {DEEPEST} values inside each other have no place in a profile")
        if kind == "AliasEvent":
            return self._alias(event.anchor, where)
        if event.tag is not None and event.tag not in _PLAIN_TAGS:
            raise OpenRTMError(f"{where}: the tag {event.tag[:80]!r} has no place in a profile; take it away")
        if event.anchor is not None:
            self._anchors[event.anchor] = None  # until it is whole
        if kind == "ScalarEvent":
            node = _Node(where, event.value, plain=bool(event.implicit[0]))
        elif kind == "SequenceStartEvent":
            items = tuple(self._inner(events, depth, "SequenceEndEvent"))
            node = _Node(where, items=items, size=1 + sum(one.size for one in items))
        else:
            node = self._table(tuple(self._inner(events, depth, "MappingEndEvent")), where)
        if event.anchor is not None:
            self._anchors[event.anchor] = node
        return node

    def _inner(self, events: Iterator[Any], depth: int, end: str) -> Iterator[_Node]:
        while type(event := next(events)).__name__ != end:
            yield self._node(event, events, depth + 1)

    def _table(self, inner: tuple[_Node, ...], where: str) -> _Node:
        pairs: dict[str, _Node] = {}
        for key, value in zip(inner[::2], inner[1::2], strict=True):
            if key.text is None:
                raise OpenRTMError(f"{key.where}: a key is a word, and no table or list")
            if key.plain and key.text == "<<":
                raise OpenRTMError(f"{key.where}: '<<' has no place in a profile; write out what it stands for")
            if key.text in pairs:
                raise OpenRTMError(f"{key.where}: {key.text[:80]!r} stands there twice; take one away")
            pairs[key.text] = value
        return _Node(where, pairs=tuple(pairs.items()), size=1 + sum(one.size for one in inner))

    def _alias(self, anchor: str, where: str) -> _Node:
        node = self._anchors.get(anchor)
        self._aliases += 1
        if node is None:
            raise OpenRTMError(f"{where}: the alias {anchor[:80]!r} stands for nothing, or for what it is in")
        self._again += node.size
        if self._aliases > MOST_ALIASES or self._again > _MOST_AGAIN:
            what = f"more than {MOST_ALIASES} aliases, or aliases for more than {_MOST_AGAIN} values"
            raise OpenRTMError(f"{where}: {what}, have no place in a profile; write out what they stand for")
        return node
