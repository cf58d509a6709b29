"""Imports a recording of another system: decides which message becomes which sample.

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
from aiorts_log.recorder.port_state import PortState
from aiorts_log.recorder.writer import RecordingWriter

_LAST: Final = 2**32 * 10**9
"""The bound of records' time stamps: all are below it."""
_TURN: Final = 20_000
_TURN_BYTES: Final = 16 * 2**20
_LONGEST: Final = 90
_REASON: Final = 120
"""The most characters of a reason."""


@dataclass(slots=True)
class MessageCounts:
    """The counts of a topic's messages; when the import is over, read = taken + left_out + lost.

    Attributes:
        read: messages in the source.
        taken: messages of which at least one sample is in the new recording.
        left_out: messages of a kind that becomes no sample, or without fields.
        lost: messages of a kind that becomes samples, none of which is in the new recording.
    """

    read: int = 0
    taken: int = 0
    left_out: int = 0
    lost: int = 0


@dataclass(slots=True)
class ImportReport:
    """The result of an import.

    Attributes:
        samples: number written, by port.
        ports: for each port, its topic and field.
        messages: by topic, what became of its messages.
        left: by topic, or topic and field, the reason why its kind became no port.
        lost: messages or values that should have become samples, by topic and reason.
        not_closed: the files that were not closed, with the number of unusable bytes at the end of each.
    """

    samples: dict[str, int] = field(default_factory=dict)
    ports: dict[str, str] = field(default_factory=dict)
    messages: dict[str, MessageCounts] = field(default_factory=dict)
    left: dict[str, str] = field(default_factory=dict)
    lost: dict[str, dict[str, int]] = field(default_factory=dict)
    not_closed: tuple[tuple[str, int], ...] = ()

    def lose(self, topic: str, why: str, count: int = 1) -> None:
        """Count values that became no sample."""
        reasons = self.lost.setdefault(topic, {})
        reasons[why] = reasons.get(why, 0) + count

    @property
    def whole(self) -> bool:
        """Whether nothing is lost: no message, no value of a message, and no end of a file."""
        return not self.lost and not any(length for _, length in self.not_closed)


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
        whole: make one record of a message whose type has one in `aiorts.types.ros`; else split it, as all others.
        existing: what to do when the new file exists.
        limits: what a file may cost.

    Raises:
        RecordingError: a file cannot be opened, or the source is damaged or has nothing that can be imported;
            messages before the damage are in the target.
        MissingExtra: a library is needed that is not installed.
    """
    with open_bag(source, limits=limits) as bag:
        plans = _Plans(whole)
        for stream in bag.streams:
            plans.add(stream)
        if bag.streams and not plans.of:
            why = "; ".join(f"{topic}: {reason}" for topic, reason in list(plans.report.left.items())[:3])
            raise RecordingError(f"{source}: nothing in it can be imported: {why}")
        plans.report.not_closed = bag.not_closed
        known = {"imported from": Path(source).name, "imported by": f"aiorts {aiorts.__version__}"}
        # Flushed every _TURN messages or _TURN_BYTES, the queue needs no bounds of its own.
        options = RecordingOptions(existing=existing, queue=10_000_000, queue_bytes=2**32, min_free=None)
        with _Writer(target, options, metadata=known) as writer, progress("importing", bag.count) as step:
            turn = held = 0
            for time, stream, data in bag.samples():
                turn += plans.write(writer, time, stream, data)
                held += len(data)
                step(1)
                if turn >= _TURN or held >= _TURN_BYTES:
                    turn = held = 0
                    writer.flush()
                    plans.settle(writer)
                    if writer.failure is not None:
                        break
        return plans.finish(writer)


class _Message:
    """A message whose samples were given to the writer, which has not encoded all of them yet."""

    __slots__ = ("counts", "refused", "samples")

    def __init__(self, counts: MessageCounts) -> None:
        self.counts = counts
        self.samples = self.refused = 0


class _Writer(RecordingWriter):
    """A recording that knows the message of each sample that its encoding refuses."""

    def __init__(self, *args: Any, **options: Any) -> None:
        self.of: dict[int, _Message] = {}
        """The message of each waiting sample, by the sample's id, which is free again only when the thread is done."""
        self.refusals: list[tuple[_Message, str, str]] = []
        """Message, port and reason."""
        super().__init__(*args, **options)

    def refused(self, port: PortState, record: Any, why: str) -> None:
        super().refused(port, record, why)
        self.refusals.append((self.of[id(record)], port.name, why[:_REASON]))


class _Plan:
    """The ports of a topic."""

    def __init__(self, stream: Stream, messages: Messages | Documents) -> None:
        self.stream = stream
        self.messages = messages
        self.numbers: dict[str, int] = {}
        """The numbers of the writer's ports, by path."""
        self.frame: str | None = None


class _Plans:
    """Decides for each topic what its messages become, and counts what became of them."""

    def __init__(self, whole: bool) -> None:
        self._whole = whole
        self.report = ImportReport()
        self.of: dict[Stream, _Plan] = {}
        self._names: set[str] = set()
        self._waiting: list[_Message] = []

    def add(self, stream: Stream) -> None:
        """Decide what the messages of a topic become."""
        left = self.report.left
        self.report.messages.setdefault(stream.topic, MessageCounts())
        try:
            messages = _messages(stream, self._whole)
        except Unmapped as error:
            left[stream.topic] = str(error)
            return
        self.of[stream] = _Plan(stream, messages)

    def write(self, writer: _Writer, time: int, stream: Stream, data: bytes) -> int:
        """Write the samples of a message; returns how many."""
        counts = self.report.messages[stream.topic]
        counts.read += 1
        plan = self.of.get(stream)
        if plan is None:
            counts.left_out += 1
            return 0
        message = _Message(counts)
        is_lost = self._write(writer, plan, message, time, data)
        if message.samples:
            self._waiting.append(message)
        elif is_lost:
            counts.lost += 1
        else:
            counts.left_out += 1
        return message.samples

    def _write(self, writer: _Writer, plan: _Plan, counted: _Message, time: int, data: bytes) -> bool:
        """Write the parts of a message; return whether a part is lost."""
        topic = plan.stream.topic
        try:
            message = plan.messages.decode(data)
        except Unmapped as error:
            self.report.lose(topic, str(error))
            return True
        if not 0 <= time < _LAST:
            self.report.lose(topic, "log times outside 1970..2106")
            return True
        tm = plan.messages.time(message)
        if tm is None or not 0 <= tm < _LAST:
            if tm is not None:
                self.report.lose(topic, "time stamps outside 1970..2106; the log time stands in their place")
            tm = time
        self._follow_frame(plan, message)
        lost = 0

        def lose(where: str, why: str) -> None:
            nonlocal lost
            lost += 1
            self.report.lose(where, why)

        for path, cls, value in plan.messages.parts(message, lose, topic):
            try:
                one = value if type(value) is cls else cls(tm, value)
            except RecordError as error:
                lose(f"{topic} {path}".rstrip(), str(error)[:_REASON])
                continue
            number = plan.numbers.get(path)
            if number is None:
                number = plan.numbers[path] = self._port(writer, plan, path, cls)
            writer.of[id(one)] = counted
            if writer.write(number, one, time):
                counted.samples += 1
            else:
                lose(f"{topic} {path}".rstrip(), "the recording has ended")
        return lost > 0

    def settle(self, writer: _Writer) -> None:
        """Count the messages whose samples are all encoded or refused by now."""
        for message, port, why in writer.refusals:
            message.refused += 1
            self.report.lose(self.report.ports[port], why)
        for message in self._waiting:
            if message.refused < message.samples:
                message.counts.taken += 1
            else:
                message.counts.lost += 1
        self._waiting.clear()
        writer.refusals.clear()
        writer.of.clear()

    def finish(self, writer: _Writer) -> ImportReport:
        """Return the report, when the recording is closed. RecordingError when it is not whole."""
        if writer.failure is not None:
            raise writer.failure
        self.settle(writer)
        for plan in self.of.values():
            self._report_left(plan)
        with RecordingReader(writer.path) as reader:
            self.report.samples = {name: port.count for name, port in reader.ports.items()}
        return self.report

    def _report_left(self, plan: _Plan) -> None:
        topic, fields = plan.stream.topic, plan.messages.left
        counts = self.report.messages[topic]
        self.report.left |= {f"{topic} {path}": why for path, why in fields.items()}
        if counts.left_out:
            of = "it has" if counts.left_out == counts.read else f"{counts.left_out} of its messages have"
            self.report.left.setdefault(topic, f"{of} no fields{' that become samples' if fields else ''}")

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
