"""The errors of recordings."""

from __future__ import annotations

from aiorts.errors import AiortsError


class RecordingError(AiortsError, ValueError):
    """A recording cannot be read, made or continued. The message names the file, the reason and what to do."""

    code = "E-RECORDING"


class UnwrittenError(RecordingError):
    """Output could not be written, and is not there: the disk is full, or a write failed."""


class DamagedError(RecordingError):
    """Bytes of a recording are not those that were written.

    Attributes:
        offset: the place in the file, in bytes.
    """

    code = "E-DAMAGED"

    def __init__(self, text: str, offset: int = 0) -> None:
        super().__init__(text)
        self.offset = offset
