"""The figures of a recording, taken from its index and, for the rates, from the first and last samples of its ports."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from aiorts_log.errors import DamagedError
from aiorts_log.mcap.survey import GAP, MISSED, Gap

if TYPE_CHECKING:
    from aiorts_log.mcap.reader import Recording


@dataclass(frozen=True, slots=True)
class PortInfo:
    """A port; `rate`: samples a second from its first to its last, None where it has fewer than two."""

    name: str
    type: str
    encoding: str
    count: int
    rate: float | None
    unknown: str
    """The reason why its samples cannot become records; "" when they can."""


@dataclass(frozen=True, slots=True)
class RecordingInfo:
    """The figures of a recording; times in nanoseconds.

    Attributes:
        size: bytes of the file.
        gaps: begin and end of each time of a second or more without samples.
        torn: the broken end of a recording that was not closed.
        fault: other damage, in words; "" when none is known.
        dropped: samples lost for lack of room: by port those that the writer dropped, by connector and reason those
            dropped on the way to it.
        refused: samples that the encoding refused, by port and reason.
    """

    path: str
    size: int
    made_by: str
    closed: bool
    count: int
    start: int
    end: int
    chunks: int
    ports: tuple[PortInfo, ...]
    gaps: tuple[tuple[int, int], ...]
    dropped: dict[str, int]
    refused: dict[str, dict[str, int]]
    torn: Gap | None
    fault: str
    skipped: int
    metadata: tuple[Any, ...]

    @property
    def duration(self) -> float:
        """Seconds from the first sample to the last."""
        return (self.end - self.start) / 1e9


def info_of(reader: Recording) -> RecordingInfo:
    """The figures of an open recording. DamagedError when its metadata are damaged."""
    try:
        spans = reader.spans()
    except DamagedError:  # its fault is reported, and a rate would be a guess
        spans = {}
    ports = tuple(
        PortInfo(
            name,
            port.type_name,
            port.encoding,
            port.count,
            _rate(port.count, *spans.get(port.id, (0, 0))),
            port.unknown,
        )
        for name, port in reader.ports.items()
    )
    dropped: dict[str, int] = {}
    for ending in reader.endings:
        found = ending.get("dropped") if isinstance(ending, dict) else None
        for name, count in found.items() if isinstance(found, dict) else ():
            dropped[name] = dropped.get(name, 0) + (count if isinstance(count, int) else 0)
        for name, count in _missed(ending):
            dropped[name] = dropped.get(name, 0) + count
    header = reader.header
    return RecordingInfo(
        str(reader.path),
        reader.size,
        header.library or header.profile,
        reader.clean,
        reader.count,
        reader.start,
        reader.end,
        len(reader.pieces),
        ports,
        _gaps(reader),
        dropped,
        _refused(reader.endings),
        reader.torn,
        reader.fault,
        reader.skipped,
        reader.metadata,
    )


def _missed(ending: Any) -> Iterator[tuple[str, int]]:
    """Drops of connectors on the way to the recorder, from an end report that may be of any program."""
    before = ending.get("dropped_before") if isinstance(ending, dict) else None
    for name, reasons in before.items() if isinstance(before, dict) else ():
        for why, count in reasons.items() if isinstance(reasons, dict) else ():
            if why in MISSED and isinstance(count, int):
                yield f"{name} ({why})", count


def _refused(endings: tuple[Any, ...]) -> dict[str, dict[str, int]]:
    """The refused samples by port and reason, from end reports of any program; old ones give no reasons."""
    found: dict[str, dict[str, int]] = {}
    for ending in endings:
        counts, reasons = (_table(ending, name) for name in ("refused", "reasons"))
        for name, count in counts.items():
            known = {why: n for why, n in _table(reasons, name).items() if isinstance(n, int)}
            for why, n in (known or {"": count}).items():
                if isinstance(n, int):
                    found.setdefault(name, {})[why] = found.get(name, {}).get(why, 0) + n
    return found


def _table(document: Any, name: str) -> dict[str, Any]:
    found = document.get(name) if isinstance(document, dict) else None
    return found if isinstance(found, dict) else {}


def _rate(count: int, first: int, last: int) -> float | None:
    return 1e9 * (count - 1) / (last - first) if count > 1 and last > first else None


def _gaps(reader: Recording) -> tuple[tuple[int, int], ...]:
    gaps = []
    last: int | None = None
    for piece in sorted(reader.pieces):
        if not piece.filled:
            continue  # definitions alone
        if last is not None and piece.start - last >= GAP:
            gaps.append((last, piece.start))
        last = piece.end if last is None else max(last, piece.end)
    return tuple(gaps)
