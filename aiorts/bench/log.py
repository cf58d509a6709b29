"""`aiorts bench log`: samples into a file, checked when it is read again, beside bare writers of the same samples.

Everything that writes MCAP has chunks of 64 KiB with their sums and compresses nothing; records become octets by the
same codec. The recorder gives its samples to a thread, so its loop pays `loop` alone; the cost is until all is written.
What that thread costs its neighbours, and what a large recording costs to open, is in `log_live.py`.
"""

from __future__ import annotations

import importlib
import pickle
import tempfile
from collections import deque
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from itertools import repeat
from pathlib import Path
from time import perf_counter_ns
from typing import Any, Final

import numpy as np

from aiorts.bench import machine
from aiorts.bench.case import COST, RATE, Aim, Case, Measure, Reading, Sense
from aiorts.bench.log_live import large_cases, live_cases
from aiorts.bench.registry import Bench, Options
from aiorts.bench.report import Report
from aiorts.errors import MissingExtra
from aiorts.types import TimedDouble, TimedDoubleSeq, TimedOctetSeq
from aiorts.wire import MsgpackCodec

__all__ = ("BENCH", "PAYLOADS", "cases")

_CHUNK: Final = 65_536
_STEP: Final = 1_000
_LOOP: Final = Measure("loop", "ns")
"""Nanoseconds of the thread that gives a sample away."""
_VOLUME: Final = Measure("volume", "MB/s", "more")
_COLUMNS: Final = (_LOOP, RATE, _VOLUME)
_QUEUE: Final = {"queue": 10_000_000, "queue_octets": 2**32}
"""All of a round may wait: what is measured is how fast it is written, not what is dropped."""
PAYLOADS: Final[tuple[tuple[str, Any, int, int], ...]] = (
    ("float", TimedDouble(1, 1.5), 8, 20_000),
    ("6 doubles", TimedDoubleSeq(1, [0.5, 1.5, -2.5, 3.25, 4.0, 5.0]), 48, 15_000),
    ("1 MB array", TimedOctetSeq(1, np.arange(1_000_000, dtype=np.uint8).copy()), 1_000_000, 40),
)
"""Name, record, octets of its data, and how many."""

Write = Callable[[Path, Any, int], int]
"""Writes a record so many times; nanoseconds until the last was given away."""


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
    """What the recorder's thread does, without a thread, queue, ages and counts."""
    outfile: Any = importlib.import_module("aiorts_log.outfile")
    forms: Any = importlib.import_module("aiorts_log.forms")
    encode = MsgpackCodec().encode
    file = outfile.OutFile(path, "refuse", 0)
    channel = file.channel_of("port", forms.schema_of(0, type(record), "msgpack"), "msgpack", {}).id
    began, builder = perf_counter_ns(), file.builder
    for number in range(count):
        builder.add(channel, number, number * _STEP, number * _STEP, encode(record))
        if builder.octets >= _CHUNK:
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
    """As OpenRTM-aist's FlexiLogger: one dump for each sample, no sum, no index, nothing flushed."""
    fields = record.tm, record.data
    with path.open("wb") as file:
        began = perf_counter_ns()
        for _ in repeat(None, count):
            pickle.dump((0, "port", fields), file)
    return perf_counter_ns() - began


def _run(write: Write, folder: Path, record: Any, octets: int, is_recording: bool, count: int) -> Reading:
    path = folder / "bench.mcap"
    began = perf_counter_ns()
    given = write(path, record, count)
    elapsed = perf_counter_ns() - began
    faults = _faults(path, record, count) if is_recording else ()
    path.unlink()
    timed = Reading.timed(count, elapsed)
    values = {**timed.values, "loop": given / count, "volume": octets * count * 1e3 / elapsed}
    return Reading(values, count, faults=faults)


def _faults(path: Path, record: Any, count: int) -> tuple[str, ...]:
    """What is wrong with a recording: every sample is in it, every sum is right."""
    recordings: Any = importlib.import_module("aiorts_log")
    with recordings.RecordingReader(path) as reader:
        found = deque(reader.samples(), 1)
        whole = reader.clean and reader.count == count and found[0].record == record
    return () if whole else (f"the recording has {reader.count} samples of {count}, or others than were written",)


def cases(folder: Path) -> tuple[Case, ...]:
    """Every payload through every writer that is installed."""
    writers: list[tuple[str, str, Write, str, bool]] = [
        ("bare writer", "the same form from the same thread: nothing waits, nothing is counted", _bare, "", True),
        ("mcap", "the library of the format, in Python", _mcap, "mcap", False),
        ("foxglove-sdk", "its vendor's, in Rust; an open chunk is lost", _foxglove, "foxglove", False),
        ("pickle.dump", "the original's loop: no sums, no index", _original, "", False),
        ("aiorts", "a recorder with its thread, until the file is closed", _aiorts, "", True),
    ]
    made = []
    for name, record, octets, messages in PAYLOADS:
        for who, what, write, module, is_recording in writers:
            if module and find_spec(module) is None:
                continue
            others = [one for one, _, _, needs, _ in writers[1:-1] if not needs or find_spec(needs) is not None]
            aims = (
                Aim(f"bare writer, {name}", Sense.AT_LEAST, factor=0.7, measure=RATE),
                *(Aim(f"{one}, {name}", Sense.AT_LEAST, measure=RATE) for one in others),
            )
            run = partial(_run, write, folder, record, octets, is_recording)
            own = aims if who == "aiorts" else ()
            made.append(Case(f"{who}, {name}", what, COST, run, messages, own, columns=_COLUMNS, peer=bool(module)))
    return tuple(made)


def report(options: Options) -> Report:
    """The bench."""
    described = machine.describe()
    with tempfile.TemporaryDirectory(prefix="aiorts-bench-") as folder:
        all_cases = (*cases(Path(folder)), *live_cases(Path(folder)), *large_cases(Path(folder)))
        rows = options.rows(all_cases)
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
    return options.report("log", rows, described, notes=tuple(missing), how=how)


BENCH: Final = Bench(
    "log",
    "Recording: samples into a file, beside bare writers and the libraries of the format.",
    report,
    quick_rounds=7,
    rounds=9,
    full_scale=3.0,
    loops=False,
)
