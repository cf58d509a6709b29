"""Makes a recording of one that another system made: which message becomes which sample, and what is left out, and why.

Nothing is dropped in silence: every topic, field and message that does not become samples is in the report, with the
reason.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal

import aiorts
from aiorts.errors import RecordError
from aiorts_log.bags import Stream, open_bag
from aiorts_log.errors import RecordingError
from aiorts_log.foreign_json import Documents
from aiorts_log.options import RecordingOptions
from aiorts_log.reader import RecordingReader
from aiorts_log.ros import Messages, Unmapped
from aiorts_log.writer import RecordingWriter

__all__ = ("ImportReport", "import_recording")

_LAST: Final = 2**32 * 10**9
"""Time stamps of records are below it."""
_TURN: Final = 20_000
_TURN_OCTETS: Final = 16 * 2**20
_LONGEST: Final = 90


@dataclass(slots=True)
class ImportReport:
    """What became of a recording of another system.

    Attributes:
        samples: that were written, by port.
        ports: for each port, the topic and field that it has.
        left: by topic or topic and field: why it became no port.
        lost: by topic, messages or values that became no samples, by reason.
        notes: what else is to be known.
    """

    samples: dict[str, int] = field(default_factory=dict)
    ports: dict[str, str] = field(default_factory=dict)
    left: dict[str, str] = field(default_factory=dict)
    lost: dict[str, dict[str, int]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def lose(self, topic: str, why: str, count: int = 1) -> None:
        """Count what became no sample."""
        reasons = self.lost.setdefault(topic, {})
        reasons[why] = reasons.get(why, 0) + count


def import_recording(
    source: str | os.PathLike[str],
    target: str | os.PathLike[str],
    *,
    existing: Literal["refuse", "overwrite"] = "refuse",
    progress: Callable[[int, int], None] | None = None,
) -> ImportReport:
    """Write a recording of what another system recorded: an MCAP file, a ROS 2 bag (.db3), or a folder of them.

    Args:
        existing: what is to happen when the new file is there.
        progress: called now and then with how many messages were read, and how many there are.

    Raises:
        RecordingError: one of the two cannot be had, the old one holds nothing that can be read, or is damaged: what
            stood before the damage is in the new one.
        MissingExtra: a library is needed that is not installed.
    """
    with open_bag(source) as bag:
        plans = _Plans()
        for stream in bag.streams:
            plans.add(stream)
        if bag.streams and not plans.of:
            why = "; ".join(f"{topic}: {reason}" for topic, reason in list(plans.report.left.items())[:3])
            raise RecordingError(f"{source}: nothing in it can be imported: {why}")
        plans.report.notes += bag.notes
        known = {"imported from": Path(source).name, "imported by": f"aiorts {aiorts.__version__}"}
        options = RecordingOptions(existing=existing, queue=10_000_000, queue_octets=2**32, min_free=None)
        with RecordingWriter(target, options, metadata=known) as writer:
            turn = octets = 0
            for done, (time, stream, data) in enumerate(bag.samples()):
                turn += plans.write(writer, time, stream, data)
                octets += len(data)
                if turn >= _TURN or octets >= _TURN_OCTETS:
                    turn = octets = 0
                    writer.flush()
                    if writer.failure is not None:
                        break
                    if progress is not None:
                        progress(done + 1, bag.count)
        return plans.finish(writer)


class _Plan:
    """The ports of a topic."""

    def __init__(self, stream: Stream, messages: Messages | Documents) -> None:
        self.stream = stream
        self.messages = messages
        self.numbers: dict[str, int] = {}
        """Of the writer's ports, by path."""
        self.frame: str | None = None


class _Plans:
    """What is to be done with the messages of every topic, and what was done."""

    def __init__(self) -> None:
        self.report = ImportReport()
        self.of: dict[Stream, _Plan] = {}
        self._names: set[str] = set()

    def add(self, stream: Stream) -> None:
        """Find out what the messages of a topic become."""
        left = self.report.left
        try:
            messages = _messages(stream)
        except Unmapped as error:
            left[stream.topic] = str(error)
            return
        for path, why in messages.left.items():
            left[f"{stream.topic} {path}"] = why
        self.of[stream] = _Plan(stream, messages)

    def write(self, writer: RecordingWriter, time: int, stream: Stream, data: bytes) -> int:
        """Write what a message becomes; returns how many samples."""
        topic = stream.topic
        plan = self.of.get(stream)
        if plan is None:
            self.report.lose(topic, self.report.left[topic])
            return 0
        try:
            message = plan.messages.decode(data)
        except Unmapped as error:
            self.report.lose(topic, str(error))
            return 0
        tm = plan.messages.time(message)
        if tm is None or not 0 <= tm < _LAST:
            if tm is not None:
                self.report.lose(topic, "time stamps outside 1970..2106; the log time stands in their place")
            tm = time
        if not 0 <= time < _LAST:
            self.report.lose(topic, "log times outside 1970..2106")
            return 0
        self._follow_frame(plan, message)
        count = 0
        for path, cls, value in plan.messages.parts(message, self.report.lose, topic):
            try:
                one = cls(tm, value)
            except RecordError as error:
                self.report.lose(f"{topic} {path}".rstrip(), str(error)[:120])
                continue
            number = plan.numbers.get(path)
            if number is None:
                number = plan.numbers[path] = self._port(writer, plan, path, cls)
            if not writer.write(number, one, time):
                self.report.lose(f"{topic} {path}".rstrip(), "samples that could not be written")
            count += 1
        return count

    def finish(self, writer: RecordingWriter) -> ImportReport:
        """The report, when the recording is closed. RecordingError when it is not whole."""
        if writer.failure is not None:
            raise writer.failure
        found = writer.statistics
        with RecordingReader(writer.path) as reader:
            self.report.samples = {name: port.count for name, port in reader.ports.items()}
        for name, count in found.refused.items():
            self.report.lose(self.report.ports[name], "samples that could not be written", count)
        return self.report

    def _follow_frame(self, plan: _Plan, message: Any) -> None:
        frame = plan.messages.frame(message)
        if plan.frame is None:
            plan.frame = frame
        elif frame != plan.frame:
            self.report.lose(f"{plan.stream.topic} header.frame_id", f"names other than {plan.frame!r}")

    def _port(self, writer: RecordingWriter, plan: _Plan, path: str, cls: type) -> int:
        stream = plan.stream
        name = self._name(f"{stream.topic}.{path}")
        metadata = {"topic": stream.topic, "type": stream.type, "field": path}
        if plan.frame:
            metadata["frame_id"] = plan.frame
        self.report.ports[name] = f"{stream.topic} {path}".rstrip()
        return writer.add_port(name, cls, metadata)

    def _name(self, text: str) -> str:
        """What a port may be called that has this topic and field, and none before it is."""
        base = re.sub(r"[^A-Za-z0-9_-]+", "_", text).strip("_-")[:_LONGEST] or "port"
        name, number = base, 2
        while name in self._names:
            name, number = f"{base}_{number}", number + 1
        self._names.add(name)
        return name


def _messages(stream: Stream) -> Messages | Documents:
    """What reads the messages of a topic. Unmapped when nothing does."""
    if stream.encoding == "cdr":
        return Messages(stream.type, stream.form, stream.definition)
    if stream.encoding == "json":
        return Documents(stream.form, stream.definition)
    raise Unmapped(f"its messages are {stream.encoding[:30] or 'of no encoding'}; only ROS 2 and JSON are read")
