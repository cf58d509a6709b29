"""The blocks of code of a page.

A block with `title="NAME"` behind its language is a file of this name, which the blocks after it use.
"""

from __future__ import annotations

import re
from typing import Final, NamedTuple

_BLOCK: Final = re.compile(r"^```(?P<about>[^`\n]*)\n(?P<text>.*?)^```$", re.DOTALL | re.MULTILINE)
_TITLE: Final = re.compile(r'title="([^"]*)"')


class Block(NamedTuple):
    """A block of code."""

    language: str
    title: str
    """The name of the file that it is; "" for one that is no file."""
    marks: frozenset[str]
    """The words that follow its language."""
    text: str
    line: int
    """The number of its first line in the page."""


def blocks(text: str) -> list[Block]:
    """The blocks of code of a Markdown text, in order."""
    return [_block(found, text) for found in _BLOCK.finditer(text)]


def _block(found: re.Match[str], text: str) -> Block:
    about = found["about"]
    title = _TITLE.search(about)
    language, *marks = _TITLE.sub("", about).split() or [""]
    line = text.count("\n", 0, found.start("text")) + 1
    return Block(language, title[1] if title else "", frozenset(marks), found["text"], line)
