"""Makes a ROS 2 bag of a recording: a topic for each port whose samples are records of ROS messages."""

from __future__ import annotations

import re
import sqlite3
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal, TypeAlias

from aiorts.errors import AiortsError
from aiorts.progress import Step, progress
from aiorts_log.analysis.convert import filled, refuse_damaged
from aiorts_log.errors import DamagedError, RecordingError, UnwrittenError
from aiorts_log.foreign.ros_records import MESSAGES, library, record_of, ros_name, standard_types, unmaker
from aiorts_log.mcap.reader import RecordedPort, Recording, counted, not_closed
from aiorts_log.mcap.source import Limits
from aiorts_log.text.opening import open_recording
from aiorts_log.whole import whole_folder

Storage: TypeAlias = Literal["mcap", "sqlite3"]
_TOPIC: Final = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+", re.ASCII)
_MESSAGES: Final = ", ".join(name.rpartition("/")[2] for name in MESSAGES)
_LONGEST: Final = 200


@dataclass(slots=True)
class ExportReport:
    """The result of an export.

    Attributes:
        messages: number written, by topic.
        topics: the port of each topic.
        left: ports that were left out, with the reason.
        not_closed: the recording, when it was not closed, with the number of unusable bytes at its end.
    """

    messages: dict[str, int] = field(default_factory=dict)
    topics: dict[str, str] = field(default_factory=dict)
    left: dict[str, str] = field(default_factory=dict)
    not_closed: tuple[tuple[str, int], ...] = ()


def export_ros2(
    source: Path,
    target: Path,
    *,
    ports: Collection[str] | None = None,
    skip_others: bool = False,
    storage: Storage = "mcap",
    limits: Limits | None = None,
) -> ExportReport:
    """Write a recording as a bag of ROS 2: a new folder with a file of messages and `metadata.yaml`.

    A port that was imported gets the topic that it came from, others get `/pid0/command` for `pid0.command`. Messages
    have the log times of their samples.

    Args:
        ports: the ports to export; None is all.
        skip_others: leave out ports whose samples are no messages of ROS 2, and report them.
        storage: the kind of file in the bag.

    Raises:
        RecordingError: one of the two cannot be used, the recording is damaged, or a port cannot be exported.
        MissingExtra: a library is needed that is not installed.
    """
    library()
    with open_recording(source, limits=limits) as reader:
        refuse_damaged(reader)
        wanted = filled(reader) if ports is None else reader.chosen(ports)
        left = {name: why for name, port in wanted.items() if (why := _why_not(port))}
        ours = {name: port for name, port in wanted.items() if name not in left}
        if wanted and not ours:
            raise RecordingError(f"{source}: no port has messages of ROS 2, which are {_MESSAGES}")
        if left and not skip_others:
            name, why = next(iter(left.items()))
            raise RecordingError(
                f"{source}: port {name[:60]!r} cannot be exported: {why}; --skip-others exports the others alone "
                f"({', '.join(list(ours)[:4])[:80]}{', ...' * (len(ours) > 4)}), --port some of them"
            )
        topics = _topics(source, ours)
        with whole_folder(target, [source]) as part, progress("exporting", reader.count) as step:
            bag = part / (target.name or "bag")  # files of a bag are named after its folder
            counts = _write(bag, reader, ours, topics, storage, step)
            for file in bag.iterdir():
                file.rename(part / file.name)
            bag.rmdir()
        found = {topics[name]: count for name, count in counts.items()}
        return ExportReport(found, {topic: name for name, topic in topics.items()}, left, tuple(not_closed([reader])))


def _why_not(port: RecordedPort) -> str:
    if record_of(port.type_name) is None:
        return f"its samples are {port.type_name[:80] or 'of no type'}, no message of ROS 2"
    return port.unknown


def _topics(source: Path, ports: Mapping[str, RecordedPort]) -> dict[str, str]:
    """The topic of each port. RecordingError when two would have the same."""
    found: dict[str, str] = {}
    owners: dict[str, str] = {}
    for name, port in ports.items():
        topic = port.metadata.get("topic", "")
        if not _TOPIC.fullmatch(topic) or len(topic) > _LONGEST:
            words = re.sub(r"[^A-Za-z0-9_.]", "_", port.name).split(".")
            topic = "".join(f"/_{word}" if word[:1].isdigit() else f"/{word or '_'}" for word in words)[:_LONGEST]
        if topic in owners:
            raise RecordingError(
                f"{source}: ports {owners[topic][:60]!r} and {name[:60]!r} would both be the topic {topic}; choose one "
                "of them with --port"
            )
        found[name] = topic
        owners[topic] = name
    return found


def _write(
    bag: Path,
    reader: Recording,
    ports: Mapping[str, RecordedPort],
    topics: Mapping[str, str],
    storage: Storage,
    step: Step,
) -> dict[str, int]:
    """Write the bag; returns the number of messages by port."""
    from rosbags.rosbag2 import StoragePlugin, Writer, WriterError  # type: ignore[import-not-found,unused-ignore]

    store = standard_types()
    counts = dict.fromkeys(ports, 0)
    try:
        with Writer(bag, version=9, storage_plugin=StoragePlugin[storage.upper()]) as writer:
            ways: dict[int, tuple[str, Any, Callable[[bytes], bytes]]] = {}
            for name, port in ports.items():
                connection = writer.add_connection(topics[name], ros_name(port.type), typestore=store)
                ways[id(port)] = name, connection, _encoder(port, store)
            for sample in counted(reader.samples(ports=ports), step):
                name, connection, encode = ways[id(sample.port)]
                try:
                    data = encode(sample.data)
                except AiortsError as error:
                    raise DamagedError(f"{reader.path}: port {name}: {error}") from None
                writer.write(connection, sample.log_time, data)
                counts[name] += 1
    except (WriterError, sqlite3.Error) as error:
        raise UnwrittenError(f"{bag}: cannot be written: {error}") from None
    return counts


def _encoder(port: RecordedPort, store: Any) -> Callable[[bytes], bytes]:
    decode, make, name = port.decode, unmaker(port.type, store), ros_name(port.type)
    return lambda data: bytes(store.serialize_cdr(make(decode(data)), name))
