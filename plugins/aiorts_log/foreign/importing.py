"""Makes a recording from another system's: decides which message becomes which sample.

The report has every topic, field and message that does not become samples, with the reason.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal

import aiorts
from aiorts.errors import RecordError
from aiorts.progress import progress
from aiorts_log.errors import RecordingError
from aiorts_log.foreign.bags import Stream, open_bag
from aiorts_log.foreign.foreign_json import Documents
from aiorts_log.foreign.ros import Messages, Unmapped
from aiorts_log.mcap.reader import RecordingReader
from aiorts_log.mcap.source import Limits
from aiorts_log.recorder.options import RecordingOptions
from aiorts_log.recorder.writer import RecordingWriter

_LAST: Final = 2**32 * 10**9
"""Time stamps of records are below it."""
_TURN: Final = 20_000
_TURN_BYTES: Final = 16 * 2**20
_LONGEST: Final = 90


@dataclass(slots=True)
class ImportReport:
    """The result of an import.

    Attributes:
        samples: written, by port.
        ports: for each port, its topic and field.
        left: by topic, or topic and field: why it became no port.
        lost: by topic, messages or values that became no samples, by reason.
        notes: further remarks.
    """

    samples: dict[str, int] = field(default_factory=dict)
    ports: dict[str, str] = field(default_factory=dict)
    left: dict[str, str] = field(default_factory=dict)
    lost: dict[str, dict[str, int]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def lose(self, topic: str, why: str, count: int = 1) -> None:
        """Count values that became no sample."""
        reasons = self.lost.setdefault(topic, {})
        reasons[why] = reasons.get(why, 0) + count


def import_recording(
    source: str | os.PathLike[str],
    target: str | os.PathLike[str],
    *,
    whole: bool = True,
    existing: Literal["refuse", "overwrite"] = "refuse",
    limits: Limits | None = None,
) -> ImportReport:
    """Import a recording of another system: an MCAP file, a ROS 2 bag (.db3), or a folder of them.

    Args:
        whole: take messages of types that have a record in `aiorts.types.ros` as such; else in parts, as all others.
        existing: what to do when the new file exists.
        limits: what a file may cost.

    Raises:
        RecordingError: one of the two cannot be opened, the old one has nothing that can be imported, or is damaged;
            messages before the damage are in the new one.
        MissingExtra: a library is needed that is not installed.
    """
    with open_bag(source, limits=limits) as bag:
        plans = _Plans(whole)
        for stream in bag.streams:
            plans.add(stream)
        if bag.streams and not plans.of:
            why = "; ".join(f"{topic}: {reason}" for topic, reason in list(plans.report.left.items())[:3])
            raise RecordingError(f"{source}: nothing in it can be imported: {why}")
        plans.report.notes += bag.notes
        known = {"imported from": Path(source).name, "imported by": f"aiorts {aiorts.__version__}"}
        # Flushed every _TURN messages or _TURN_BYTES, the queue needs no bounds of its own.
        options = RecordingOptions(existing=existing, queue=10_000_000, queue_bytes=2**32, min_free=None)
        with RecordingWriter(target, options, metadata=known) as writer, progress("importing", bag.count) as step:
            turn = held = 0
            for time, stream, data in bag.samples():
                turn += plans.write(writer, time, stream, data)
                held += len(data)
                step(1)
                if turn >= _TURN or held >= _TURN_BYTES:
                    turn = held = 0
                    writer.flush()
                    if writer.failure is not None:
                        break
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
    """Decides for each topic what its messages become, and counts what became of them."""

    def __init__(self, whole: bool) -> None:
        self._whole = whole
        self.report = ImportReport()
        self.of: dict[Stream, _Plan] = {}
        self._names: set[str] = set()

    def add(self, stream: Stream) -> None:
        """Decide what the messages of a topic become."""
        left = self.report.left
        try:
            messages = _messages(stream, self._whole)
        except Unmapped as error:
            left[stream.topic] = str(error)
            return
        for path, why in messages.left.items():
            left[f"{stream.topic} {path}"] = why
        self.of[stream] = _Plan(stream, messages)

    def write(self, writer: RecordingWriter, time: int, stream: Stream, data: bytes) -> int:
        """Write the samples of a message; returns how many."""
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
                one = value if type(value) is cls else cls(tm, value)
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
        """A valid and unused port name for this topic and field."""
        base = re.sub(r"[^A-Za-z0-9_-]+", "_", text).strip("_-")[:_LONGEST] or "port"
        name, number = base, 2
        while name in self._names:
            name, number = f"{base}_{number}", number + 1
        self._names.add(name)
        return name


def _messages(stream: Stream, whole: bool) -> Messages | Documents:
    """The decoder for the messages of a topic. Unmapped when there is none."""
    if stream.encoding == "cdr":
        return Messages(stream.type, stream.schema_format, stream.definition, whole)
    if stream.encoding == "json":
        return Documents(stream.schema_format, stream.definition)
    raise Unmapped(f"its messages are {stream.encoding[:30] or 'of no encoding'}; only ROS 2 and JSON are read")
