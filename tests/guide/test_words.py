"""The words of what a user reads: no riddles, where the field has a term. What to say instead stands beside each."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from aiorts.guide.contents import FOLDER
from trees import parse

ROOT = Path(__file__).parents[2]
WORDS = {
    "anybody, everybody, nobody, somebody, whoever": "name the caller, the reader, no component, each observer",
    "armed, rung": "notify-enabled, notified",
    "beware": "warning",
    "bulkhead": "isolation of failures",
    "changeover, comeback, heir, succession": "swap, recovery, replacement",
    "crossing, crossings": "lock-free connector",
    "deadman": "deadline monitor",
    "for ever": "forever, or: without a limit",
    "happening": "event",
    "left behind": "abandoned",
    "life cycle": "lifecycle",
    "roster": "registry",
    "told": "reported, notified, shown; a callback is called with",
    "verdict": "result, decision",
    "wish, wished, wishes": "request",
    "witness": "stack sampler",
}
"""Words that must not come back, and what to say instead."""
PATTERN = re.compile(rf"\b({'|'.join(words.replace(', ', '|') for words in WORDS)})\b(?! apart)", re.IGNORECASE)
INSTEAD = {word: instead for words, instead in WORDS.items() for word in words.split(", ")}


def texts(path: Path) -> Iterator[tuple[int, str]]:
    """Line and text of each string of a module that is no docstring: messages, help texts of options, templates."""
    tree = parse(path)
    docstrings = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docstrings:
            yield node.lineno, node.value


def riddles(place: str, line: int, text: str) -> list[str]:
    return [
        f"{place}:{line + text[: found.start()].count(chr(10))}: {found[0]!r}: say {INSTEAD[found[0].lower()]}"
        for found in PATTERN.finditer(text)
    ]


def sources() -> list[Path]:
    return [path for top in ("aiorts", "plugins") for path in sorted((ROOT / top).rglob("*.py"))]


def documents() -> list[Path]:
    """The pages of the guide, which have the docstrings of public names and the help of commands, and the rest."""
    found = [ROOT / "CONTRIBUTING.md", *FOLDER.rglob("*.md")]
    found += [path for top in ("plugins", "examples") for path in (ROOT / top).rglob("*.md")]
    return sorted(found)


@pytest.mark.slow(kept_by="test_documents_use_the_words_of_the_field")
def test_messages_and_help_texts_use_the_words_of_the_field() -> None:
    found = [
        riddle
        for path in sources()
        if any(word in path.read_text(encoding="utf-8").lower() for word in INSTEAD)
        for line, text in texts(path)
        if any(word in text.lower() for word in INSTEAD)
        for riddle in riddles(str(path.relative_to(ROOT)), line, text)
    ]
    assert found == []


@pytest.mark.parametrize("path", documents(), ids=lambda path: str(path.relative_to(ROOT)))
def test_documents_use_the_words_of_the_field(path: Path) -> None:
    """A page of reference is written from docstrings and help texts: correct those, and run tests/reference.py."""
    assert riddles(str(path.relative_to(ROOT)), 1, path.read_text(encoding="utf-8")) == []


def test_a_word_is_found_with_its_place_and_what_to_say_instead() -> None:
    assert riddles("a.py", 3, "This\nit was left behind.") == ["a.py:4: 'left behind': say abandoned"]
    assert riddles("a.py", 3, "Untold; they cannot be told apart.") == []
