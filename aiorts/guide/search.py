"""Finds the places of the guide that answer a question."""

from __future__ import annotations

import re
from collections import Counter
from functools import cache
from typing import Final, NamedTuple

from aiorts.guide.contents import Page, pages
from aiorts.guide.newcomers import ASKED
from aiorts.tiers import tier_of_page

_WORD: Final = re.compile(r"[a-z0-9]+(?:[-_.][a-z0-9]+)*")
_HEADING: Final = re.compile(r"^#{1,4} ")
_LINK: Final = re.compile(r"!?\[([^\]]+)\]\([^)\s]+\)")
_NO_PROSE: Final = re.compile(r"^```.*?^```$|^\|.*?$|^<!--.*?-->$", re.DOTALL | re.MULTILINE)
_NEXT_PARAGRAPH: Final = re.compile(r"\n(?:\s*\n|(?=\s*(?:[-*]|\d+\.) ))")
_NEXT_SENTENCE: Final = re.compile(r"(?<=[.?!])\s+(?=[A-Z`\[*])")
_DOUBLED: Final = re.compile(r"([bgmnprt])\1$")
"""A consonant that an ending doubled: dropped, running."""
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
        *(
            "if",
            "in",
            "is",
            "it",
            "its",
            "my",
            "not",
            "of",
            "on",
            "or",
            "that",
            "the",
            "there",
            "this",
            "to",
            "use",
            "using",
        ),
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
    counts a quarter of what it would with all of them. A page that newcomers ask for by half of the words or more, as
    `newcomers` has it, comes before all others.
    """
    wanted = _wanted(question)
    asked = {one.name: share for one in pages() if (share := _asked(one, wanted)) >= 0.5}
    found = [hits for one in pages() if (hits := _hits(one, wanted, asked=one.name in asked))]
    best = [max(hits, key=lambda hit: hit.score) for hits in found]
    return sorted(best, key=lambda hit: (-asked.get(hit.page.name, 0.0), -hit.score))


def _wanted(question: str) -> set[str]:
    """The words that count of a question, without their endings."""
    words = _WORD.findall(question.lower())
    return {_stem(word) for word in words if word not in _COMMON} or {_stem(word) for word in words}


def _asked(one: Page, wanted: set[str]) -> float:
    """The share of the question that is words by which newcomers ask for this page."""
    phrases = [_wanted(phrase) for phrase in ASKED.get(one.name, ())]
    return len({word for phrase in phrases if phrase <= wanted for word in phrase}) / len(wanted) if wanted else 0.0


def _hits(one: Page, wanted: set[str], *, asked: bool) -> list[Hit]:
    in_title = _words(f"{one.title} {one.name}")
    hits: list[Hit] = []
    for heading, in_heading, text, in_text in _places(one):
        counts = {
            word: min(in_text[word], _MOST) + _IN_TITLE * (word in in_title) + _IN_HEADING * (word in in_heading)
            for word in wanted
        }
        found = [count for count in counts.values() if count]
        if any(word in in_text or word in in_heading for word in wanted) or (asked and not hits):
            hits.append(Hit(one, heading, _excerpt(text, wanted), sum(found) * (len(found) / len(wanted)) ** 2))
    return hits


class _Place(NamedTuple):
    heading: str
    in_heading: list[str]
    text: list[str]
    in_text: Counter[str]


@cache
def _places(one: Page) -> list[_Place]:
    """The text below each heading of a page, without the line of its tier, which answers nothing."""
    tier = tier_of_page(one.name)
    lines = [line for line in one.text.splitlines()[1:] if tier is None or line != tier.note]
    places, heading, text, fenced = [], one.title, list[str](), False
    for line in [*lines, "# "]:
        fenced ^= line.startswith("```")
        if fenced or not _HEADING.match(line):
            text.append(line)
            continue
        places.append(_Place(heading, _words(heading), text, Counter(word for each in text for word in _words(each))))
        heading, text = line.lstrip("# "), []
    return places


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
