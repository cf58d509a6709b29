"""Recordings of ports in MCAP files: written by a thread, read in order, replayed, and salvaged when damaged.

`mcap/` reads and writes the file format, `text/` the text formats; `recorder/` writes while a system runs, `playing/`
replays; `analysis/` converts, compares and draws; `foreign/` imports recordings of other systems; `commands/` is
`aiorts log`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from aiorts.late import late

if TYPE_CHECKING:
    from aiorts_log.analysis.info import RecordingInfo, info_of
    from aiorts_log.commands.moment import moment_ns
    from aiorts_log.errors import DamagedError, RecordingError
    from aiorts_log.mcap.encodings import encoder, schema_of
    from aiorts_log.mcap.reader import RecordedPort, RecordedSample, Recording, RecordingReader
    from aiorts_log.mcap.salvage import SalvageReport, salvage
    from aiorts_log.mcap.source import Limits
    from aiorts_log.mcap.survey import MISSED, Gap
    from aiorts_log.playing.player import Player, Playing
    from aiorts_log.playing.read_ahead import Reading
    from aiorts_log.playing.schedule import Pace
    from aiorts_log.recorder.about import about_system
    from aiorts_log.recorder.control import BackgroundRecording, MakeWriter, Notice
    from aiorts_log.recorder.options import RecordingOptions, RecordingStatistics
    from aiorts_log.recorder.target import check_parts, check_target
    from aiorts_log.recorder.writer import RecordingWriter
    from aiorts_log.text.opening import open_recording
    from aiorts_log.text.text_format import TextReader, TextWriter

__all__ = (
    "BackgroundRecording",
    "DamagedError",
    "Gap",
    "Limits",
    "MISSED",
    "MakeWriter",
    "Notice",
    "Pace",
    "Player",
    "Playing",
    "Reading",
    "RecordedPort",
    "RecordedSample",
    "Recording",
    "RecordingError",
    "RecordingInfo",
    "RecordingOptions",
    "RecordingReader",
    "RecordingStatistics",
    "RecordingWriter",
    "SalvageReport",
    "TextReader",
    "TextWriter",
    "about_system",
    "check_parts",
    "check_target",
    "encoder",
    "info_of",
    "moment_ns",
    "open_recording",
    "salvage",
    "schema_of",
)

late()
