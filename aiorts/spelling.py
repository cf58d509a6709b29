"""Words that a misspelt one may have meant, for the end of a message."""

from __future__ import annotations

from collections.abc import Iterable

__all__ = ("meant", "nearest", "suggestion")

_LONGEST = 200
"""Characters that are compared: a longer word is no mistake in spelling, and would take its time."""

_LISTED = 20
"""Words that a message lists."""


def nearest(word: object, known: Iterable[object], *, cutoff: float = 0.6) -> str:
    """The known word that is most like another one; "" where none is.

    Args:
        cutoff: how like it has to be, from 0 to 1.
    """
    from difflib import get_close_matches  # late: few words are misspelt

    return "".join(get_close_matches(str(word)[:_LONGEST], map(str, known), n=1, cutoff=cutoff))


def meant(word: object, known: Iterable[object]) -> str:
    """ "; did you mean 'word'?" with the nearest of these words; "" where none is near."""
    near = nearest(word, known)
    return f"; did you mean {near!r}?" if near else ""


def suggestion(word: object, known: Iterable[object]) -> str:
    """ "did you mean 'word'?" with the nearest of these words, else the first 20 that there are."""
    words = [str(one) for one in known]
    near = nearest(word, words)
    return f"did you mean {near!r}?" if near else f"there are {', '.join(words[:_LISTED]) or 'none'}"
