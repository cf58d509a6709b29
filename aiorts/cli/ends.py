"""The ends of a filter: what feeds its in-ports and takes from its out-ports, as JSON lines or as frames of a codec."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from typing import Any, TextIO

from aiorts.cli.report import report
from aiorts.errors import ConfigurationError
from aiorts.system import FrameInput, FrameOutput, StandardInput, StandardOutput
from aiorts.wire import Codec, find_codec

__all__ = ("Ends",)


class Ends:
    """Standard input and standard output in one form.

    Args:
        codec: the name of a codec; None is JSON lines. PluginError when there is no such codec.
    """

    def __init__(self, codec: str | None) -> None:
        self._codec: Codec | None = None if codec is None else find_codec(codec)

    def source(
        self, ports: Mapping[str, type], tell: Callable[[int, str], None], **how: Any
    ) -> StandardInput | FrameInput:
        """What feeds these in-ports. ConfigurationError for frames from a terminal."""
        if self._codec is None:
            return StandardInput("stdin", ports, tell, **how)
        _check(sys.stdin, "input")
        return FrameInput("stdin", ports, self._codec, _complain, **how)

    def sink(self, ports: Mapping[str, type], **how: Any) -> StandardOutput | FrameOutput:
        """What takes from these out-ports. ConfigurationError for frames to a terminal."""
        if self._codec is None:
            return StandardOutput("stdout", ports, **how)
        _check(sys.stdout, "output")
        return FrameOutput("stdout", ports, self._codec, **how)


def _check(stream: TextIO | None, what: str) -> None:
    if stream is not None and stream.isatty():
        raise ConfigurationError(f"--codec: binary frames are nothing for a terminal; redirect standard {what}")


def _complain(number: int, why: str) -> None:
    report("E-FRAME", f"standard input, frame {number}: {why}")
