"""The state of a recorded port: how its samples are encoded, their channels, and their counts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from aiorts.types import describe, has_tm
from aiorts_log.recorder.options import RecordingStatistics
from aiorts_log.recorder.weight import weigher

_REASONS: Final = 8
_LONGEST: Final = 200
_OTHERS: Final = "other reasons"


@dataclass(slots=True, eq=False)
class PortState:
    """A recorded port with one channel, or more when there are records of subclasses."""

    name: str
    cls: type
    metadata: Mapping[str, str]
    weigh: Callable[[Any], int] | None
    stamped: bool = field(kw_only=True)
    mutable: bool = field(kw_only=True)
    """Whether a sample can still change: it is of a dataclass that is no record, frozen or not."""
    kind: type | None = None
    encode: Callable[[Any], bytes] = bytes
    """A function that encodes records of the class `kind`."""
    split: Callable[[Any], tuple[bytes, bytes]] | None = None
    """A function that encodes large records in two parts; None where two parts are no gain."""
    seen: type | None = None
    """The class of the last sample; channel and sequence belong to samples of this class."""
    channel: int = 0
    sequence: int = 0
    next: dict[int, int] = field(default_factory=dict)
    """The next sequence number of the other channels."""
    offered: int = 0
    dropped: int = 0
    refused: dict[str, int] = field(default_factory=dict)
    """Samples that the encoding refused, by reason."""
    unfit: dict[str, int] = field(default_factory=dict)
    """Samples refused at once, in the thread that offered them, by reason."""
    stored: int = 0

    @classmethod
    def of(cls, name: str, kind: type, metadata: Mapping[str, str]) -> PortState:
        """The state of a port whose samples are of a type."""
        mutable = hasattr(kind, "__dataclass_fields__") and not describe(kind).checked
        return cls(name, kind, metadata, weigher(kind), stamped=has_tm(kind), mutable=mutable)


def refuse(reasons: dict[str, int], why: str) -> None:
    """Count a refused sample. Only the first reasons have counts of their own, since each may name a value."""
    why = why[:_LONGEST] if why[:_LONGEST] in reasons or len(reasons) < _REASONS else _OTHERS
    reasons[why] = reasons.get(why, 0) + 1


def tally(
    ports: Sequence[PortState], ended: bool, durable: int, clamped: int, size: int, files: int
) -> RecordingStatistics:
    """The counts of all ports; once the recording has `ended`, samples that are not stored were dropped."""
    stored = sum(port.stored for port in ports)
    reasons = {port.name: found for port in ports if (found := _added(port.refused, port.unfit))}
    refused = {name: sum(found.values()) for name, found in reasons.items()}
    dropped = {p.name: p.offered - refused.get(p.name, 0) - p.stored if ended else p.dropped for p in ports}
    return RecordingStatistics(
        sum(port.offered for port in ports),
        stored,
        min(durable, stored),
        {name: count for name, count in dropped.items() if count},
        refused,
        reasons,
        clamped,
        size,
        files,
    )


def _added(first: Mapping[str, int], second: Mapping[str, int]) -> dict[str, int]:
    return {why: first.get(why, 0) + second.get(why, 0) for why in {**first, **second}}


def end_report(found: RecordingStatistics) -> dict[str, object]:
    """The counts that a recording has in its end report."""
    known = {"stored": found.stored, "dropped": dict(found.dropped), "refused": dict(found.refused)}
    reasons = {name: dict(why) for name, why in found.reasons.items()}
    return {**known, **({"reasons": reasons} if reasons else {}), "clamped": found.clamped}
