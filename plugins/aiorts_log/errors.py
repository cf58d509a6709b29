"""What can be wrong with a recording: it cannot be had, or what stands in it is damaged."""

from __future__ import annotations

from aiorts.errors import AiortsError

__all__ = ("DamagedError", "RecordingError", "UnwrittenError")


class RecordingError(AiortsError, ValueError):
    """A recording cannot be read, made or continued: names the file, says why and what to do."""

    code = "E-RECORDING"


class UnwrittenError(RecordingError):
    """What was to be written could not be, and is not there: the disk is full, or it failed."""


class DamagedError(RecordingError):
    """Octets of a recording are not what was written.

    Attributes:
        offset: where in the file, in octets.
    """

    code = "E-DAMAGED"

    def __init__(self, text: str, offset: int = 0) -> None:
        super().__init__(text)
        self.offset = offset
