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
    """The stamps of the first stream that have a partner in each of the others."""
    assert within is not None
    lead, *others = streams
    partners = [pairs(lead, stream, within) for stream in others]
    return [(tm, *(one[tm] for one in partners)) for tm in lead if all(tm in one for one in partners)]


def pairs(leads: Sequence[int], others: Sequence[int], within: int) -> dict[int, int]:
    """The two that are nearest to each other, then the same with those before both, and with those after both."""
    apart = [(abs(lead - other), lead, other) for lead in leads for other in others if abs(lead - other) <= within]
    if not apart:
        return {}
    _, lead, other = min(apart)
    before = pairs([one for one in leads if one < lead], [one for one in others if one < other], within)
    after = pairs([one for one in leads if one > lead], [one for one in others if one > other], within)
    return {**before, lead: other, **after}


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
