"""Words that a misspelt one may have meant, for the end of a message."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import islice

__all__ = ("meant", "nearest", "similar", "suggestion")

_LONGEST = 200
"""Characters that are compared: a longer word is no mistake in spelling, and would take its time."""

_COMPARED = 2000
"""Words that one is compared with."""

_LISTED = 20
"""Words that a message lists."""


def similar(word: object, known: Iterable[object], most: int = 3, *, cutoff: float = 0.6) -> list[str]:
    """The known words that are most like another one.

    Args:
        cutoff: how like they have to be, from 0 to 1.
    """
    from difflib import get_close_matches  # late: few words are misspelt

    there = [str(one) for one in islice(known, _COMPARED)]
    return get_close_matches(str(word)[:_LONGEST], there, n=most, cutoff=cutoff)


def nearest(word: object, known: Iterable[object], *, cutoff: float = 0.6) -> str:
    """The known word that is most like another one; "" where none is."""
    return "".join(similar(word, known, 1, cutoff=cutoff))


def meant(word: object, known: Iterable[object], shown: Callable[[str], str] = repr, *, most: int = 1) -> str:
    """ "; did you mean 'word'?" as `suggestion` says it; "" where none is near."""
    hint = suggestion(word, known, "", shown=shown, most=most)
    return f"; {hint}" if hint else ""


def suggestion(
    word: object,
    known: Iterable[object],
    otherwise: str | None = None,
    *,
    shown: Callable[[str], str] = repr,
    most: int = 1,
) -> str:
    """ "did you mean 'word'?" with the nearest of these words, else the first 20 that there are.

    Args:
        otherwise: what is said in place of those that there are.
        shown: a word as the message has it.
        most: how many near words are named.
    """
    words = [str(one) for one in known]
    if near := similar(word, words, most):
        return f"did you mean {' or '.join(map(shown, near))}?"
    listed = ", ".join([*words[:_LISTED], *(["..."] if len(words) > _LISTED else [])])
    return f"there are {listed or 'none'}" if otherwise is None else otherwise
