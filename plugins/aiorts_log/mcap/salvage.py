"""Makes a whole recording from a damaged one: copies every whole chunk, and reports what is lost."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from aiorts.progress import Step
from aiorts_log.mcap.format import BadBytes
from aiorts_log.mcap.index import read_index
from aiorts_log.mcap.outfile import OutFile
from aiorts_log.mcap.source import Limits, Piece, Source
from aiorts_log.mcap.summary import Summary
from aiorts_log.mcap.survey import Gap, Survey, survey
from aiorts_log.whole import whole_file


@dataclass(frozen=True, slots=True)
class SalvageReport:
    """The result of a salvage: the content that was copied, and the losses.

    Attributes:
        samples: number copied, by port.
        lost: ranges of the old file from which nothing could be read.
        missing: samples known to be lost, by port.
        closed: whether the old file was closed by its writer; when not, samples may be missing at its end, too.
        attachments: names of the files within the file that were copied.
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
    step: Step | None = None,
) -> SalvageReport:
    """Copy the whole chunks of a recording into a new file, which appears when it is complete; report the losses.

    Args:
        existing: what to do when the new file exists.
        step: called with the bytes of each chunk that was copied, in the end with those that were not.

    Raises:
        RecordingError: one of the files cannot be opened, or the new one cannot be written whole.
    """
    old = Source(source, limits or Limits())
    try:
        with whole_file(Path(target), [old.path], existing == "overwrite") as part:
            new = OutFile(part, "refuse", 0)
            try:
                return _Salvage(old, new).run(step)
            finally:
                new.abandon()
    finally:
        old.close()


class _Salvage:
    """Copies one old file into one new file."""

    def __init__(self, old: Source, new: OutFile) -> None:
        self._old = old
        self._new = new
        self._gaps: list[Gap] = []
        self._next: dict[int, int] = {}
        self._skipped: dict[int, int] = {}
        self._number: dict[int, int] = {}

    def run(self, step: Step | None) -> SalvageReport:
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
        rest = old.size
        for piece in found.pieces:
            self._copy(piece, found.summary)
            if step is not None:
                step(piece.length)
                rest -= piece.length
        if step is not None:
            step(rest)
        new.finish()
        names = {number: channel.topic for number, channel in found.summary.channels.items()}
        counted = {n: c - new.counts.get(n, 0) for n, c in index.counts.items()} if index is not None else self._skipped
        missing = {names.get(number, f"channel {number}"): count for number, count in counted.items() if count > 0}
        samples = {names[number]: count for number, count in new.counts.items()}
        return SalvageReport(samples, tuple(self._gaps), missing, found.ended, tuple(attached))

    def _defined(self, found: Survey) -> Summary | None:
        """Take the definitions from the index if that is whole: the chunk that had them may be damaged."""
        try:
            index = read_index(self._old)
            if index is None:
                return None
            for schema in index[0].schemas.values():
                found.summary.define(schema)
            for channel in index[0].channels.values():
                found.summary.define(channel=channel)
        except BadBytes:
            return None
        return index[0] if index[0].counted is not None else None

    def _copy(self, piece: Piece, summary: Summary) -> None:
        messages = self._old.load(piece).messages
        # Chunks of other programs need not be in order, and `builder.add` demands it.
        messages.sort(key=lambda message: message.log_time)
        numbered, builder = self._old.header.profile == "aiorts", self._new.builder
        unknown = 0
        for channel, sequence, log_time, publish_time, data in messages:
            if channel not in summary.channels:
                unknown += 1
                continue
            if numbered:  # renumbered without gaps: missing samples are in the report
                self._skipped[channel] = self._skipped.get(channel, 0) + max(0, sequence - self._next.get(channel, 0))
                self._next[channel] = sequence + 1
                sequence = self._number[channel] = self._number.get(channel, -1) + 1
            builder.add(channel, sequence, log_time, publish_time, data)
        if unknown:
            self._gaps.append(Gap(piece.offset, piece.length, f"{unknown} samples of ports that nothing defines"))
        self._new.end_chunk()
