"""Recordings: ports written into an MCAP file by a thread of their own, read back in order, salvaged when damaged."""

from __future__ import annotations

from aiorts_log.errors import DamagedError, RecordingError
from aiorts_log.info import RecordingInfo, info_of
from aiorts_log.opening import Recording, open_recording
from aiorts_log.options import RecordingOptions, RecordingStatistics
from aiorts_log.reader import RecordedPort, RecordedSample, RecordingReader
from aiorts_log.salvage import SalvageReport, salvage
from aiorts_log.source import Limits
from aiorts_log.survey import Gap
from aiorts_log.text_form import TextReader, TextWriter
from aiorts_log.writer import RecordingWriter

__all__ = (
    "DamagedError",
    "Gap",
    "Limits",
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
    "info_of",
    "open_recording",
    "salvage",
)
