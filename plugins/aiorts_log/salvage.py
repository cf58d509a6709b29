"""Makes a whole recording of a damaged one: what is in chunks that are whole goes over; what is lost is told."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from aiorts_log.errors import RecordingError
from aiorts_log.form import BadOctets
from aiorts_log.index import read_index
from aiorts_log.outfile import OutFile
from aiorts_log.source import Limits, Piece, Source
from aiorts_log.summary import Summary
from aiorts_log.survey import Gap, Survey, survey

__all__ = ("SalvageReport", "salvage")


@dataclass(frozen=True, slots=True)
class SalvageReport:
    """What came out of a damaged recording.

    Attributes:
        samples: that are in the new file, by port.
        lost: octets of the old file of which nothing could be had.
        missing: samples that are known to be lost, by port.
        closed: whether the old file was closed by its writer; when not, samples may be missing at its end, too.
        attachments: names of the files within the file that went over.
    """

    samples: dict[str, int] = field(default_factory=dict)
    lost: tuple[Gap, ...] = ()
    missing: dict[str, int] = field(default_factory=dict)
    closed: bool = False
    attachments: tuple[str, ...] = ()


def salvage(
    source: str | os.PathLike[str],
    target: str | os.PathLike[str],
    *,
    existing: Literal["refuse", "overwrite"] = "refuse",
    limits: Limits | None = None,
) -> SalvageReport:
    """Write what is whole of a recording into a new one, and say what is lost.

    Args:
        existing: what is to happen when the new file is there.

    Raises:
        RecordingError: one of the files cannot be had, or the new one cannot be written whole.
    """
    old = Source(source, limits or Limits())
    try:
        if Path(target).exists() and Path(target).samefile(old.path):
            raise RecordingError(f"{target}: is the recording itself; name another file for what is whole of it")
        new = OutFile(Path(target), existing, 0)
        try:
            return _Salvage(old, new).run()
        except OSError as error:
            raise RecordingError(f"{target}: cannot be written: {error.strerror or error}") from None
        finally:
            new.abandon()
    finally:
        old.close()


class _Salvage:
    """One way from an old file to a new one."""

    def __init__(self, old: Source, new: OutFile) -> None:
        self._old = old
        self._new = new
        self._gaps: list[Gap] = []
        self._next: dict[int, int] = {}
        self._skipped: dict[int, int] = {}
        self._number: dict[int, int] = {}

    def run(self) -> SalvageReport:
        old, new = self._old, self._new
        found = survey(old)
        index = self._defined(found)
        self._gaps += [*found.damage, *([found.torn] if found.torn is not None else [])]
        new.take_definitions(found.summary.schemas, found.summary.channels)
        attached = []
        for at, length, _ in found.summary.attachments:
            one = old.attachment(at, length)
            attached.append(one.name)
            new.attach(one)
        for piece in found.pieces:
            self._copy(piece, found.summary)
        new.finish()
        names = {number: channel.topic for number, channel in found.summary.channels.items()}
        counted = {n: c - new.counts.get(n, 0) for n, c in index.counts.items()} if index is not None else self._skipped
        missing = {names.get(number, f"channel {number}"): count for number, count in counted.items() if count > 0}
        samples = {names[number]: count for number, count in new.counts.items()}
        return SalvageReport(samples, tuple(self._gaps), missing, found.ended, tuple(attached))

    def _defined(self, found: Survey) -> Summary | None:
        """Take the definitions of the index, if that is whole: the chunk that had them may not be."""
        try:
            index = read_index(self._old)
            if index is None:
                return None
            for schema in index[0].schemas.values():
                found.summary.define(schema)
            for channel in index[0].channels.values():
                found.summary.define(channel=channel)
        except BadOctets:
            return None
        return index[0] if index[0].counted is not None else None

    def _copy(self, piece: Piece, summary: Summary) -> None:
        messages = self._old.load(piece).messages
        messages.sort(key=lambda message: message.log_time)
        numbered, builder = self._old.header.profile == "aiorts", self._new.builder
        unknown = 0
        for channel, sequence, log_time, publish_time, data in messages:
            if channel not in summary.channels:
                unknown += 1
                continue
            if numbered:  # anew: what is missing is told now, and the new file is whole in itself
                self._skipped[channel] = self._skipped.get(channel, 0) + max(0, sequence - self._next.get(channel, 0))
                self._next[channel] = sequence + 1
                sequence = self._number[channel] = self._number.get(channel, -1) + 1
            builder.add(channel, sequence, log_time, publish_time, data)
        if unknown:
            self._gaps.append(Gap(piece.offset, piece.length, f"{unknown} samples of ports that nothing defines"))
        self._new.end_chunk()
