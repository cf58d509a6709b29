"""A page as blocks, and its two writers: Markdown, and HTML in one file that loads nothing.

The text comes from outside aiorts: each writer escapes all of it.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from html import escape
from typing import Final

from aiorts.late import dataclass

_SPECIAL: Final = re.compile(r"[\\*_\[\]|~]|^[#+=-]|(?<=^\d)[.)](?=\s)|(?<=^\d\d)[.)](?=\s)")
"""The special characters of Markdown, and characters that begin a heading, a rule or a list at a text's start."""
_STYLE: Final = (
    "body{font-family:sans-serif;max-width:60em;margin:2em auto;padding:0 1em}table{border-collapse:collapse}"
    "td,th{border:1px solid #999;padding:.2em .6em;text-align:left;vertical-align:top}pre{overflow:auto}"
)


@dataclass(frozen=True, slots=True)
class Head:
    """A heading of level 1 to 6."""

    level: int
    text: str


@dataclass(frozen=True, slots=True)
class Text:
    """A paragraph."""

    text: str


@dataclass(frozen=True, slots=True)
class Code:
    """Text that is shown verbatim."""

    text: str
    language: str = ""


@dataclass(frozen=True, slots=True)
class Drawing:
    """A drawing, in the language of each kind of page."""

    mermaid: str
    svg: str


@dataclass(frozen=True, slots=True)
class Table:
    """Rows below a head; a column without text is left out."""

    head: Sequence[str]
    rows: Sequence[Sequence[str]]

    def shown(self) -> tuple[list[str], list[list[str]]]:
        """Head and rows without empty columns."""
        kept = [number for number in range(len(self.head)) if any(row[number] for row in self.rows)]
        return [self.head[number] for number in kept], [[row[number] for number in kept] for row in self.rows]


Block = Head | Text | Code | Drawing | Table


def markdown_of(blocks: Iterable[Block]) -> str:
    """The page as Markdown."""
    return "\n\n".join(map(_markdown, blocks)) + "\n"


def html_of(title: str, blocks: Iterable[Block]) -> str:
    """The page as one HTML document."""
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; style-src 'unsafe-inline'\">\n"
        f"<title>{escape(title)}</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n"
        + "\n".join(map(_html, blocks))
        + "\n</body>\n</html>\n"
    )


def _markdown(block: Block) -> str:
    match block:
        case Head(level, text):
            return f"{'#' * level} {_escaped(text)}"
        case Text(text):
            return _escaped(text)
        case Code(text, language):
            fence = "`" * max(3, 1 + max((len(one) for one in re.findall("`+", text)), default=0))
            return f"{fence}{language}\n{text.rstrip()}\n{fence}"
        case Drawing(mermaid):
            return _markdown(Code(mermaid, "mermaid"))
        case Table():
            head, rows = block.shown()
            lines = [head, ["---"] * len(head), *([_escaped(cell) for cell in row] for row in rows)]
            return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _escaped(text: str) -> str:
    """The text on one line, with the special characters of Markdown and HTML escaped; `code` stays code."""
    parts = " ".join(text.split()).split("`")
    if len(parts) % 2 == 0 or "" in parts[1::2]:
        return "\\`".join(map(_plain, parts))
    return "`".join(one.replace("|", "\\|") if number % 2 else _plain(one) for number, one in enumerate(parts))


def _plain(text: str) -> str:
    return _SPECIAL.sub(r"\\\g<0>", text.replace("&", "&amp;")).replace("<", "&lt;").replace(">", "&gt;")


def _html(block: Block) -> str:
    match block:
        case Head(level, text):
            return f"<h{level}>{escape(text)}</h{level}>"
        case Text(text):
            return f"<p>{escape(text)}</p>"
        case Code(text):
            return f"<pre><code>{escape(text)}</code></pre>"
        case Drawing(_, svg):
            return f"<figure>{svg[svg.index('<svg') :].rstrip()}</figure>"
        case Table():
            head, rows = block.shown()
            columns = "".join(f"<th>{escape(one)}</th>" for one in head)
            body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>\n" for row in rows)
            return f"<table>\n<thead><tr>{columns}</tr></thead>\n<tbody>\n{body}</tbody>\n</table>"
