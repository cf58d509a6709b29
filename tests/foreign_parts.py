"""What the tests of foreign recordings share: bags of ROS 2, and MCAP files of others."""

from __future__ import annotations

import sqlite3
from functools import cache
from pathlib import Path
from typing import Any

import pytest

SECOND = 10**9
BEGIN = 1_700_000_000 * SECOND
Makers = dict[str, tuple[str, Any]]
"""Of each topic the type, and what makes its messages of their number."""


@cache
def store() -> Any:
    """The types of ROS 2, asked for by a test and not by all who collect it: to import them takes half a second."""
    typesys = pytest.importorskip("rosbags.typesys")
    return typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)


def ros(name: str, *values: Any) -> Any:
    """A message of ROS 2."""
    return store().types[name.replace("/", "/msg/")](*values)


def bag(path: Path, kind: str, makers: Makers, count: int = 4) -> Path:
    """A bag as ROS 2 Iron and later write it: a folder; messages of a topic 1 s apart, topics one after the other."""
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    plugin = rosbag2.StoragePlugin[kind]
    with rosbag2.Writer(path, version=9, storage_plugin=plugin) as writer:
        for topic, (short, make_one) in makers.items():
            name = short.replace("/", "/msg/")
            connection = writer.add_connection(topic, name, typestore=store())
            for i in range(count):
                writer.write(connection, BEGIN + i * SECOND, bytes(store().serialize_cdr(make_one(i), name)))
    return path


def old_bag(path: Path, rows: list[tuple[int, str, str, list[tuple[int, bytes]]]]) -> Path:
    """A .db3 file as ROS 2 up to Humble writes it: without definitions."""
    with sqlite3.connect(path) as database:
        database.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name, type, serialization_format, x)")
        database.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp INTEGER, data BLOB)")
        for number, topic, kind, messages in rows:
            database.execute("INSERT INTO topics VALUES(?, ?, ?, 'cdr', '')", (number, topic, kind))
            for when, data in messages:
                database.execute(
                    "INSERT INTO messages(topic_id, timestamp, data) VALUES(?, ?, ?)", (number, when, data)
                )
    database.close()
    return path


def float64(value: float) -> bytes:
    return bytes(store().serialize_cdr(ros("std_msgs/Float64", value), "std_msgs/msg/Float64"))


def mcap_file(path: Path, channels: list[tuple[str, str, str, str, str, list[tuple[int, bytes]]]]) -> Path:
    """A file of the mcap library: topic, message encoding, schema name, schema encoding, schema, messages."""
    with path.open("wb") as stream:
        writer = pytest.importorskip("mcap.writer").Writer(stream)
        writer.start()
        for topic, encoding, name, form, schema, messages in channels:
            number = writer.register_schema(name, form, schema.encode()) if form else 0
            channel = writer.register_channel(topic, encoding, number)
            for when, data in messages:
                writer.add_message(channel, when, data, when)
        writer.finish()
    return path
