"""XML to a tree: without document types, entities and references to anything outside; at most 64 elements deep."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final
from xml.sax import SAXParseException, handler, xmlreader

from aiorts.errors import MissingExtra
from aiorts_openrtm.errors import OpenRTMError
from aiorts_openrtm.markup.element import XMLNS, Attribute, Comment, Element
from aiorts_openrtm.markup.source import DEEPEST

_XML: Final = "http://www.w3.org/XML/1998/namespace"
_MOST_SPACES: Final = 64
_NO_SPACES: Final[Mapping[str, str]] = MappingProxyType({"xml": _XML, "": ""})


def element_of_xml(text: str, path: Path | str) -> Element:
    """The root element of a document.

    Raises:
        OpenRTMError: it is no XML, or has a document type; the message has the line.
        MissingExtra: defusedxml is not installed.
    """
    try:
        from defusedxml import DefusedXmlException
        from defusedxml.sax import make_parser
    except ImportError:
        raise MissingExtra("reading XML of OpenRTM", "defusedxml", "openrtm") from None
    builder = _Builder(path)
    parser = make_parser()
    parser.forbid_dtd = parser.forbid_entities = parser.forbid_external = True
    parser.setFeature(handler.feature_external_ges, False)
    parser.setFeature(handler.feature_external_pes, False)
    parser.setContentHandler(builder)
    parser.setProperty(handler.property_lexical_handler, builder)
    source = xmlreader.InputSource(str(path))
    source.setCharacterStream(io.StringIO(text))
    try:
        parser.parse(source)
    except SAXParseException as error:
        raise OpenRTMError(f"{path}:{error.getLineNumber()}: not valid XML: {error.getMessage()}") from None
    except DefusedXmlException as error:
        what = "a document type" if type(error).__name__ == "DTDForbidden" else "an entity"
        raise OpenRTMError(f"{builder.where}: {what} has no place in a profile; take it away") from None
    except OpenRTMError:
        raise
    except (ValueError, LookupError) as error:
        raise OpenRTMError(f"{builder.where}: not valid XML: {error}") from None
    return builder.root


class _Builder(handler.ContentHandler, handler.LexicalHandler):
    """Makes the tree while the parser reads; also handles comments."""

    def __init__(self, path: Path | str) -> None:
        super().__init__()
        self._path = path
        self._open: list[_Open] = []
        self._locator: Any = None
        self._root: Element | None = None

    @property
    def root(self) -> Element:
        """The whole document."""
        if self._root is None:
            raise OpenRTMError(f"{self._path}:1: not valid XML: there is no element")
        return self._root

    @property
    def where(self) -> str:
        """The line that is being read."""
        line = 1 if self._locator is None else self._locator.getLineNumber()
        return f"{self._path}:{line or 1}"

    def setDocumentLocator(self, locator: Any) -> None:  # noqa: N802 - as SAX calls it
        self._locator = locator

    def startElement(self, name: str, attrs: Any) -> None:  # noqa: N802 - as SAX calls it
        if len(self._open) == DEEPEST:
            raise OpenRTMError(
                f"{self.where}: more than {DEEPEST} elements inside each other have no place in a profile"
            )
        spaces = self._open[-1].spaces if self._open else _NO_SPACES
        given = list(attrs.items())
        declared = {key[6:]: value for key, value in given if key == "xmlns" or key.startswith("xmlns:")}
        if declared:
            spaces = {**spaces, **declared}
            if len(spaces) > _MOST_SPACES:
                raise OpenRTMError(f"{self.where}: more than {_MOST_SPACES} name spaces have no place in a profile")
        space, local = self._named(name, spaces)
        attributes = []
        for key, value in given:
            if key == "xmlns" or key.startswith("xmlns:"):
                attributes.append(Attribute(key, XMLNS, key[6:], value))
            else:
                inside, word = self._named(key, spaces) if ":" in key else ("", key)
                attributes.append(Attribute(key, inside, word, value))
        element = Element(name, space, local, tuple(attributes), (), self.where)
        self._open.append(_Open(element, spaces))

    def endElement(self, name: str) -> None:  # noqa: N802 - as SAX calls it
        done = self._open.pop()
        element = replace(done.element, children=tuple(_joined(done.children)))
        if self._open:
            self._open[-1].children.append(element)
        else:
            self._root = element

    def characters(self, content: str) -> None:
        self._open[-1].children.append(content)

    def ignorableWhitespace(self, whitespace: str) -> None:  # noqa: N802 - as SAX calls it
        self.characters(whitespace)

    def processingInstruction(self, target: str, data: str) -> None:  # noqa: N802 - as SAX calls it
        if self._open:
            self._open[-1].children.append(Comment(data, target))

    def comment(self, content: str) -> None:
        if self._open:
            self._open[-1].children.append(Comment(content))

    def startDTD(self, name: str, public_id: str | None, system_id: str | None) -> None:  # noqa: N802 - as SAX calls it
        raise OpenRTMError(f"{self.where}: a document type has no place in a profile; take it away")

    def _named(self, name: str, spaces: Mapping[str, str]) -> tuple[str, str]:
        prefix, _, local = name.rpartition(":")
        if prefix not in spaces:
            raise OpenRTMError(
                f"{self.where}: the prefix of {name!r:.80} is not declared; write xmlns:{prefix:.40}=..."
            )
        return spaces[prefix], local


class _Open:
    """An element whose end was not read yet."""

    __slots__ = ("children", "element", "spaces")

    def __init__(self, element: Element, spaces: Mapping[str, str]) -> None:
        self.element = element
        self.spaces = spaces
        self.children: list[Element | Comment | str] = []


def _joined(children: list[Element | Comment | str]) -> Iterator[Element | Comment | str]:
    """Join texts that follow each other."""
    for are_texts, several in groupby(children, lambda child: isinstance(child, str)):
        if are_texts:
            yield "".join(one for one in several if isinstance(one, str))
        else:
            yield from several
