"""`aiorts bench log`: samples into a file, which is then read and checked, next to bare writers of the same samples.

All writers of MCAP have chunks of 64 KiB with checksums and without compression; records become bytes by the same
codec. The recorder hands its samples to a thread: `loop` is the caller's time for the hand-over, the cost is the time
until all are written. `log_live.py` measures how the thread delays a context, and the opening of a large recording.
"""

from __future__ import annotations

import importlib
import pickle
import tempfile
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from itertools import repeat
from pathlib import Path
from time import perf_counter_ns
from typing import Any, Final

import numpy as np

from aiorts.errors import MissingExtra
from aiorts.types import TimedDouble, TimedDoubleSeq, TimedOctetSeq
from aiorts.wire import MsgpackCodec
from aiorts_bench.cases.log_live import large_cases, live_cases
from aiorts_bench.harness.bench import Bench, Options
from aiorts_bench.harness.case import COST, RATE, Aim, Case, Measure, Reading, Sense
from aiorts_bench.harness.report import Report

_CHUNK: Final = 65_536
_STEP: Final = 1_000
_LOOP: Final = Measure("loop", "ns")
"""Nanoseconds that the caller of `write` waits for one sample."""
_VOLUME: Final = Measure("volume", "MB/s", "more")
_COLUMNS: Final = (_LOOP, RATE, _VOLUME)
_QUEUE: Final = {"queue": 10_000_000, "queue_bytes": 2**32}
"""A queue that holds all samples of a round: the bench measures how fast they are written, without losses."""
PAYLOADS: Final[tuple[tuple[str, Any, int, int], ...]] = (
    ("float", TimedDouble(1, 1.5), 8, 20_000),
    ("6 doubles", TimedDoubleSeq(1, [0.5, 1.5, -2.5, 3.25, 4.0, 5.0]), 48, 15_000),
    ("1 MB array", TimedOctetSeq(1, np.arange(1_000_000, dtype=np.uint8).copy()), 1_000_000, 40),
)
"""Name, record, bytes of its data, and messages of one round."""

Write = Callable[[Path, Any, int], int]
"""Writes a record a number of times into a file; returns the nanoseconds until the last write returned."""


def _aiorts(path: Path, record: Any, count: int) -> int:
    recordings: Any = importlib.import_module("aiorts_log")
    with recordings.RecordingWriter(path, recordings.RecordingOptions(min_free=0, chunk=_CHUNK, **_QUEUE)) as writer:
        write, port = writer.write, writer.add_port("port", type(record))
        began = perf_counter_ns()
        for number in range(count):
            write(port, record, number * _STEP)
        given = perf_counter_ns() - began
    return given


def _bare(path: Path, record: Any, count: int) -> int:
    """Write as the recorder's thread does, but without a thread, queue, ages and counts."""
    outfile: Any = importlib.import_module("aiorts_log.mcap.outfile")
    encodings: Any = importlib.import_module("aiorts_log.mcap.encodings")
    encode = MsgpackCodec().encode
    file = outfile.OutFile(path, "refuse", 0)
    channel = file.channel_of("port", encodings.schema_of(0, type(record), "msgpack"), "msgpack", {}).id
    began, builder = perf_counter_ns(), file.builder
    for number in range(count):
        builder.add(channel, number, number * _STEP, number * _STEP, encode(record))
        if builder.size >= _CHUNK:
            file.end_chunk()
    file.finish()
    return perf_counter_ns() - began


def _mcap(path: Path, record: Any, count: int) -> int:
    library: Any = importlib.import_module("mcap.writer")
    encode = MsgpackCodec().encode
    with path.open("wb") as file:
        writer = library.Writer(file, chunk_size=_CHUNK, compression=library.CompressionType.NONE)
        writer.start()
        channel = writer.register_channel("port", "msgpack", writer.register_schema("x", "jsonschema", b"{}"))
        began = perf_counter_ns()
        for number in range(count):
            writer.add_message(channel, number * _STEP, encode(record), number * _STEP, number)
        writer.finish()
    return perf_counter_ns() - began


def _foxglove(path: Path, record: Any, count: int) -> int:
    library: Any = importlib.import_module("foxglove")
    options: Any = importlib.import_module("foxglove.mcap").MCAPWriteOptions
    encode, context = MsgpackCodec().encode, library.Context()
    how = options(compression=None, chunk_size=_CHUNK, calculate_data_section_crc=False)
    writer = library.open_mcap(str(path), context=context, writer_options=how)
    schema = library.Schema(name="x", encoding="jsonschema", data=b"{}")
    channel = library.Channel("port", message_encoding="msgpack", schema=schema, context=context)
    began = perf_counter_ns()
    for number in range(count):
        channel.log(encode(record), log_time=number * _STEP)
    writer.close()
    return perf_counter_ns() - began


def _original(path: Path, record: Any, count: int) -> int:
    """Write as FlexiLogger of OpenRTM-aist does: one dump for each sample, without checksum, index or flush."""
    fields = record.tm, record.data
    with path.open("wb") as file:
        began = perf_counter_ns()
        for _ in repeat(None, count):
            pickle.dump((0, "port", fields), file)
    return perf_counter_ns() - began


def _run(write: Write, folder: Path, record: Any, size: int, is_recording: bool, count: int) -> Reading:
    path = folder / "bench.mcap"
    began = perf_counter_ns()
    given = write(path, record, count)
    elapsed = perf_counter_ns() - began
    faults = _faults(path, record, count) if is_recording else ()
    path.unlink()
    reading = Reading.timed(count, elapsed, loop=given / count, volume=size * count * 1e3 / elapsed)
    return replace(reading, faults=faults)


def _faults(path: Path, record: Any, count: int) -> tuple[str, ...]:
    """The fault of a recording that lacks samples or has a wrong checksum."""
    recordings: Any = importlib.import_module("aiorts_log")
    with recordings.RecordingReader(path) as reader:
        found = deque(reader.samples(), 1)
        whole = reader.clean and reader.count == count and found[0].record == record
    return () if whole else (f"the recording has {reader.count} samples of {count}, or not those that were written",)


def cases(folder: Path) -> tuple[Case, ...]:
    """A case for each payload and each installed writer."""
    writers: list[tuple[str, str, Write, str, bool]] = [
        ("bare writer", "the same format from the same thread, without queue and counts", _bare, "", True),
        ("mcap", "the library of the format, in Python", _mcap, "mcap", False),
        ("foxglove-sdk", "its vendor's, in Rust; an open chunk is lost", _foxglove, "foxglove", False),
        ("pickle.dump", "the original's loop: no checksums, no index", _original, "", False),
        ("aiorts", "a recorder with its thread, until the file is closed", _aiorts, "", True),
    ]
    made = []
    for name, record, size, messages in PAYLOADS:
        for title, what, write, module, is_recording in writers:
            if module and find_spec(module) is None:
                continue
            others = [one for one, _, _, needs, _ in writers[1:-1] if not needs or find_spec(needs) is not None]
            aims = (
                Aim(f"bare writer, {name}", Sense.AT_LEAST, factor=0.7, measure=RATE),
                *(Aim(f"{one}, {name}", Sense.AT_LEAST, measure=RATE) for one in others),
            )
            run = partial(_run, write, folder, record, size, is_recording)
            own = aims if title == "aiorts" else ()
            made.append(Case(f"{title}, {name}", what, COST, run, messages, own, columns=_COLUMNS, peer=bool(module)))
    return tuple(made)


def report(options: Options) -> Report:
    """Measure every writer, a context next to a recorder, and a large recording."""
    with tempfile.TemporaryDirectory(prefix="aiorts-bench-") as folder:
        rows = options.rows((*cases(Path(folder)), *live_cases(Path(folder)), *large_cases(Path(folder))))
    missing = [
        str(MissingExtra(f"the baseline {package}", package, "bench"))
        for module, package in (("mcap", "mcap"), ("foxglove", "foxglove-sdk"))
        if find_spec(module) is None
    ]
    how = (
        "Cost is from the opening of the file to its closing, in a temporary folder; loop is what the writer waits. "
        "Lateness is that of a context of 100 Hz in the kernel that offers the samples. A million samples are opened "
        "by a new process each time; info and seek are its processor time."
    )
    return options.report("log", rows, notes=tuple(missing), how=how)


BENCH: Final = Bench(
    "log",
    "Recording: samples into a file, beside bare writers and the libraries of the format.",
    report,
    rounds=9,
    loops=False,
)
