"""The ends of a filter: the source of its in-ports and the sink of its out-ports, for JSON lines or frames."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TextIO

from aiorts.cli.console.report import report
from aiorts.errors import ConfigurationError
from aiorts.system import FrameInput, FrameOutput, LiveInput, StandardInput, StandardOutput
from aiorts.wire import find_codec

if TYPE_CHECKING:
    from aiorts.sessions import Stream
    from aiorts.wire import Codec

_SINGLY = 10
"""Bad lines of one reason that are reported one by one."""
_REASONS = 100
"""Reasons that are counted at the same time."""


class Ends:
    """Standard input and standard output in one form.

    Args:
        codec: the name of a codec; None is JSON lines. PluginError: there is no such codec.
    """

    def __init__(self, codec: str | None) -> None:
        self._codec: Codec | None = None if codec is None else find_codec(codec)

        self._is_live = False
        self.bad = False
        """Whether a line, frame or sample was bad."""
        self._told: dict[str, list[int]] = {}
        """The counts by reason: bad items, those that were reported, and the number of the last one."""

    def source(self, ports: Mapping[str, type], **how: Any) -> StandardInput | FrameInput:
        """Make the component that feeds these in-ports. ConfigurationError for frames from a terminal."""
        if self._codec is None:
            return StandardInput("stdin", ports, self._complain, **how)
        _check(sys.stdin, "input")
        return FrameInput("stdin", ports, self._codec, self._complain, **how)

    def live(self, ports: Mapping[str, type], stream: Stream, *, count: int | None) -> LiveInput:
        """Make the component that feeds this in-port with the samples of another process."""
        self._is_live = True
        return LiveInput("live", ports, stream, self._complain, -1, count=count)

    def _complain(self, number: int, why: str) -> None:
        """Report a bad item. Of many with one reason the first are reported, then only their growing number."""
        self.bad = True
        if len(self._told) >= _REASONS and why not in self._told:
            self.report_rest()
        told = self._told.setdefault(why, [0, 0, 0])
        told[0] += 1
        told[2] = number
        if told[0] <= _SINGLY:
            told[1] += 1
            self._report(f"{number}: {why}")
        elif told[0] >= 10 * told[1]:
            self._report_more(why, told)

    def report_rest(self) -> None:
        """Report the number of bad items that were not reported yet."""
        for why, told in self._told.items():
            if told[0] > told[1]:
                self._report_more(why, told)
        self._told.clear()

    def _report_more(self, why: str, told: list[int]) -> None:
        count, before, last = told
        told[1] = count
        self._report(f"{last}: and {count - before - 1} before it, {count} in all: {why}")

    def _report(self, what: str) -> None:
        if self._is_live:
            report("E-FRAME", f"--connect, sample {what}")
            return
        code, item = ("E-LINE", "line") if self._codec is None else ("E-FRAME", "frame")
        report(code, f"standard input, {item} {what}")

    def sink(self, ports: Mapping[str, type], **how: Any) -> StandardOutput | FrameOutput:
        """Make the component that takes from these out-ports. ConfigurationError for frames to a terminal."""
        if self._codec is None:
            return StandardOutput("stdout", ports, **how)
        _check(sys.stdout, "output")
        return FrameOutput("stdout", ports, self._codec, **how)


def _check(stream: TextIO | None, what: str) -> None:
    if stream is not None and stream.isatty():
        raise ConfigurationError(f"--codec: binary frames are nothing for a terminal; redirect standard {what}")
