"""A tree as the text of an XML document."""

from __future__ import annotations

import re
from typing import Final

from aiorts_openrtm.errors import OpenRTMError
from aiorts_openrtm.markup.element import Comment, Element

_BEGIN: Final = '<?xml version="1.0" encoding="UTF-8" standalone="yes"?>\n'
_REFUSED: Final = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_IN_TEXT: Final = {ord("&"): "&amp;", ord("<"): "&lt;", ord(">"): "&gt;", ord("\r"): "&#13;"}
_IN_VALUE: Final = {**_IN_TEXT, ord('"'): "&quot;", ord("\n"): "&#10;", ord("\t"): "&#9;"}


def xml_of_element(root: Element) -> str:
    """The XML document of a tree.

    Raises:
        OpenRTMError: the tree has a character that XML cannot have.
    """
    parts = [_BEGIN]
    _write(root, parts)
    parts.append("\n")
    text = "".join(parts)
    if (found := _REFUSED.search(text)) is not None:
        part = text[max(0, found.start() - 40) : found.start()].rpartition("\n")[2]
        raise OpenRTMError(f"the character {found[0]!r} after {part!r} cannot be in XML; take it away")
    return text


def _write(element: Element, parts: list[str]) -> None:
    parts.append(f"<{element.name}")
    parts += [f' {one.name}="{one.value.translate(_IN_VALUE)}"' for one in element.attributes]
    if not element.children:
        parts.append("/>")
        return
    parts.append(">")
    for child in element.children:
        if isinstance(child, Element):
            _write(child, parts)
        elif isinstance(child, Comment):
            parts.append(f"<?{child.target} {child.text}?>" if child.target else f"<!--{child.text}-->")
        else:
            parts.append(child.translate(_IN_TEXT))
    parts.append(f"</{element.name}>")
