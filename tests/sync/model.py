"""What a synchroniser must do, said with whole lists: nothing is decided sample by sample, nothing is forgotten."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

Streams = Sequence[Sequence[int]]


def rising(stream: Sequence[int]) -> list[int]:
    """The stamps that are later than all before them."""
    taken: list[int] = []
    for tm in stream:
        if not taken or tm > taken[-1]:
            taken.append(tm)
    return taken


def exact(streams: Streams, _within: int | None = None) -> list[tuple[int, ...]]:
    """The stamps that all streams have."""
    common = set(streams[0]).intersection(*streams[1:])
    return [(tm,) * len(streams) for tm in sorted(common)]


def nearest(streams: Streams, within: int | None) -> list[tuple[int, ...]]:
    """For each stamp of the first stream the nearest of the others behind those used before, while it is known."""
    assert within is not None
    lead, *others = streams
    used = [-1] * len(others)
    matches = []
    for tm in lead:
        chosen: list[int | None] = []
        known = True
        for number, stream in enumerate(others):
            free = [one for one in stream if one > used[number] and abs(one - tm) <= within]
            known = known and (any(one >= tm for one in free) or any(one >= tm + within for one in stream))
            chosen.append(min(free, key=lambda one: (abs(one - tm), one), default=None))
        out_of_reach = any(
            one is None and stream and stream[-1] >= tm + within for one, stream in zip(chosen, others, strict=True)
        )
        if out_of_reach:
            continue
        if not known:
            break
        match = [one for one in chosen if one is not None]
        assert len(match) == len(others)
        used = match
        matches.append((tm, *match))
    return matches


def latest(streams: Streams, within: int | None) -> list[tuple[int, ...]]:
    """For each stamp of the first stream the last of the others that is not after it, while it is known."""
    lead, *others = streams
    matches = []
    for tm in lead:
        chosen = [max((one for one in stream if one <= tm), default=None) for stream in others]
        known = [bool(stream) and stream[-1] >= tm for stream in others]
        good = [one is not None and (within is None or tm - one <= within) for one in chosen]
        if any(sure and not fits for sure, fits in zip(known, good, strict=True)):
            continue
        if not all(known):
            break
        matches.append((tm, *(one for one in chosen if one is not None)))
    return matches


MODELS = {"exact": exact, "nearest": nearest, "latest": latest}


def check_order(matches: Sequence[tuple[int, ...]], *, reused: bool) -> None:
    """Each match is later than the one before; only what `reused` allows is in two."""
    for one, two in pairwise(matches):
        assert one[0] < two[0]
        assert all(
            before < after or (reused and before == after) for before, after in zip(one[1:], two[1:], strict=True)
        )
