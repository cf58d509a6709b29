"""Finds the places of the guide that answer a question."""

from __future__ import annotations

import re
from functools import cache
from typing import Final, NamedTuple

from aiorts.guide.contents import Page, pages

_WORD: Final = re.compile(r"[a-z0-9]+(?:[-_.][a-z0-9]+)*")
_HEADING: Final = re.compile(r"^#{1,4} ")
_LINK: Final = re.compile(r"!?\[([^\]]+)\]\([^)\s]+\)")
_NO_PROSE: Final = re.compile(r"^```.*?^```$|^\|.*?$|^<!--.*?-->$", re.DOTALL | re.MULTILINE)
_NEXT_PARAGRAPH: Final = re.compile(r"\n(?:\s*\n|(?=\s*(?:[-*]|\d+\.) ))")
_NEXT_SENTENCE: Final = re.compile(r"(?<=[.?!])\s+(?=[A-Z`\[*])")
_DOUBLED: Final = re.compile(r"([bgmnprt])\1$")
"""What an ending doubled: dropped, running."""
_COMMON: Final = frozenset(
    (
        *(
            "a",
            "an",
            "and",
            "are",
            "as",
            "at",
            "be",
            "by",
            "can",
            "do",
            "does",
            "for",
            "from",
            "get",
            "have",
            "how",
            "i",
        ),
        *("if", "in", "is", "it", "its", "my", "not", "of", "on", "or", "that", "the", "this", "to", "use", "using"),
        *("want", "was", "were", "what", "when", "where", "which", "who", "why", "will", "with"),
    )
)
_IN_TITLE: Final = 8.0
_IN_HEADING: Final = 4.0
_MOST: Final = 8.0
"""A word counts so often in one place at most."""


class Hit(NamedTuple):
    """A place of the guide: a page, a heading in it, and the first sentence below that has a word of the question."""

    page: Page
    heading: str
    line: str
    score: float


def search(question: str) -> list[Hit]:
    """The best place of each page that has words of the question, best first.

    A place is what stands below one heading. Words in headings weigh more, and a place that has half of the words
    counts a quarter of what it would with all of them.
    """
    wanted = {_stem(word) for word in _WORD.findall(question.lower())}
    wanted = wanted - _COMMON or wanted
    hits = [max(found, key=lambda hit: hit.score) for one in pages() if (found := _hits(one, wanted))]
    return sorted(hits, key=lambda hit: -hit.score)


def _hits(one: Page, wanted: set[str]) -> list[Hit]:
    lines = one.text.splitlines()
    in_title = _words(f"{one.title} {one.name}")
    hits, heading, place, fenced = [], one.title, list[str](), False
    for line in [*lines[1:], "# "]:
        fenced ^= line.startswith("```")
        if fenced or not _HEADING.match(line):
            place.append(line)
            continue
        counts = dict.fromkeys(wanted, 0.0)
        for text in place:
            for word in _words(text):
                if word in counts:
                    counts[word] = min(counts[word] + 1, _MOST)
        for word in counts:
            counts[word] += _IN_TITLE * (word in in_title) + _IN_HEADING * (word in _words(heading))
        found = [count for count in counts.values() if count]
        if found and any(word in _words(" ".join([heading, *place])) for word in wanted):
            hits.append(Hit(one, heading, _excerpt(place, wanted), sum(found) * (len(found) / len(wanted)) ** 2))
        heading, place = line.lstrip("# "), []
    return hits


def _excerpt(place: list[str], wanted: set[str]) -> str:
    """The first sentence with a word of the question, or the first one: links as their words, no tables and code."""
    paragraphs = _NEXT_PARAGRAPH.split(_NO_PROSE.sub("", "\n".join(place)))
    sentences = [
        " ".join(_LINK.sub(r"\1", sentence).split())
        for paragraph in paragraphs
        for sentence in _NEXT_SENTENCE.split(paragraph)
    ]
    return next((one for one in sentences if wanted.intersection(_words(one))), next(filter(None, sentences), ""))


def _words(text: str) -> list[str]:
    found = _WORD.findall(text.lower())
    return [
        _stem(word) for word in [*found, *(part for word in found for part in re.split(r"[-_.]", word) if part != word)]
    ]


@cache
def _stem(word: str) -> str:
    """The word without the endings that a plural or a verb has."""
    if len(word) > 3 and word.endswith("s") and not word.endswith("ss"):
        word = f"{word[:-3]}y" if word.endswith("ies") else word[:-1]
    for ending in ("ing", "ed"):
        if word.endswith(ending) and len(word) - len(ending) >= 3:
            word = _DOUBLED.sub(r"\1", word.removesuffix(ending))
    return word.removesuffix("e") if len(word) > 4 else word
