"""What is recorded is read back, bit for bit and in order; one file has one recorder; nothing is lost uncounted."""

from __future__ import annotations

import dataclasses
import fcntl
import json
import os
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import aiorts.types.ros  # noqa: F401 - records like others
from aiorts.types import (
    MultiCameraImages,
    NDArray,
    TimedDouble,
    TimedLong,
    TimedPoint3D,
    TimedString,
    all_types,
    record,
    wire_name,
)
from aiorts_log import (
    DamagedError,
    RecordingError,
    RecordingOptions,
    RecordingReader,
    RecordingWriter,
    info_of,
    salvage,
)
from aiorts_log.mcap.encodings import encoder, schema_of, taker
from aiorts_log.mcap.locked_file import held_by
from aiorts_log.mcap.merge import merged
from aiorts_log.mcap.source import Piece
from campaign import cases
from log_parts import BEGIN, MS, make, read
from wire.test_codec import bits, records_of

TYPES = [cls for cls in all_types().values() if cls.__module__.startswith("aiorts.types") and hasattr(cls, "__slots__")]
RECORDS = [cls for cls in TYPES if dataclasses.is_dataclass(cls)]


@pytest.mark.slow(kept_by="first")
@pytest.mark.fault("D16")
@settings(max_examples=cases(4000), deadline=None)
@given(data=st.data())
@pytest.mark.parametrize("encoding", ["msgpack", "json"])
def test_every_type_comes_back_bit_for_bit(encoding: Any, data: st.DataObject) -> None:
    cls = data.draw(st.sampled_from(RECORDS))
    sample = data.draw(records_of(cls))
    raw = encoder(encoding, type(sample))(sample)
    back = taker(cls, encoding)(raw)
    assert encoder(encoding, type(back))(back) == raw
    if encoding == "msgpack":  # JSON has one NaN; every other bit survives in it, too
        assert bits(back) == bits(sample)
    else:
        assert back == sample


@pytest.mark.fault("D16")
@pytest.mark.parametrize("encoding", ["msgpack", "json"])
def test_record_read_record_gives_the_same_bytes(tmp_path: Path, encoding: Any) -> None:
    """A NaN with a payload, text that is no ASCII, empty sequences, every width, plain values, dtypes."""

    @record
    class Volume:
        data: NDArray

    nan = np.frombuffer(b"\x01\x00\x00\x00\x00\x00\xf8\x7f", dtype="f8")
    samples: dict[str, Any] = {
        "nan": Volume(nan.copy()),
        "half": Volume(np.array([[1.5, -0.0]], dtype="f2")),
        "complex": Volume(np.zeros((0, 3), dtype="c8")),
        "text": TimedString(5, "\x1b[31m \U0001f916 ä"),
        "point": TimedPoint3D(),
        "images": MultiCameraImages(),
        "int": -(2**62),
        "float": float("inf"),
        "bytes": b"\0\xff",
        "str": "",
        "bool": True,
    }
    paths = [tmp_path / "a.mcap", tmp_path / "b.mcap"]
    found = samples
    for path in paths:
        with RecordingWriter(path, RecordingOptions(min_free=0, encoding=encoding)) as writer:
            for i, (name, value) in enumerate(found.items()):
                assert writer.write(writer.add_port(name, type(value)), value, i)
        assert writer.statistics.refused == {}
        found = {name: value for name, _, value in read(path)}
    first, second = ([(s.port.name, s.log_time, s.data) for s in RecordingReaderOnce(path)] for path in paths)
    assert first == second
    assert {name: bits(value) for name, value in found.items()} == {name: bits(v) for name, v in samples.items()}


def RecordingReaderOnce(path: Path) -> list[Any]:
    with RecordingReader(path) as reader:
        return list(reader.samples())


@pytest.mark.slow
def test_samples_of_all_ports_come_in_the_order_of_their_time(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    expected = make(path, 500, chunk=4096)
    assert read(path) == expected
    assert read(path, ports=["log"]) == [one for one in expected if one[0] == "log"]
    begin, end = BEGIN + 100 * MS, BEGIN + 200 * MS
    assert read(path, start=begin, end=end) == [one for one in expected if begin <= one[1] < end]
    assert read(path, start=end + 10**12) == []
    with RecordingReader(path) as reader:
        assert [s.sequence for s in reader.samples(ports=["arm.joints"])] == list(range(500))
        assert [s.publish_time for s in reader.samples(ports=["pid0.command"])] == [
            BEGIN + i * MS - 5 for i in range(500)
        ]
        assert (reader.start, reader.end, reader.count) == (BEGIN, BEGIN + 499 * MS, 1500)
        assert reader.ports["pid0.command"].metadata == {"unit": "m/s"}
        assert reader.ports["pid0.command"].type is TimedDouble
        with pytest.raises(RecordingError, match=r"no port 'pid'; there are pid0.command, arm.joints, log"):
            list(reader.samples(ports=["pid"]))


@pytest.mark.slow
@given(
    st.lists(st.lists(st.integers(0, 20), min_size=1, max_size=8), max_size=8),
    st.booleans(),
)
def test_chunks_that_overlap_are_merged_by_time_and_place(chunks: list[list[int]], within: bool) -> None:
    """As `sorted` would, which is stable: what has one time comes as it lies in the file."""
    contents = [sorted(times) if within else times for times in chunks]
    pieces = [Piece(min(times), max(times), offset, 1) for offset, times in enumerate(contents)]
    messages = {p.offset: [(0, i, t, t, b"%d" % p.offset) for i, t in enumerate(contents[p.offset])] for p in pieces}
    flat = [message for several in messages.values() for message in several]
    load = lambda piece: list(messages[piece.offset])  # noqa: E731
    assert list(merged(pieces, load, 10**6, True)) == sorted(flat, key=lambda message: message[2])
    assert list(merged(pieces, load, 10**6, False)) == flat


def test_chunks_that_overlap_without_end_are_refused() -> None:
    pieces = [Piece(0, 1000, offset, 10) for offset in range(100)]
    with pytest.raises(RecordingError, match="overlap in time; at most 500 are held"):
        list(merged(pieces, lambda piece: [(0, 0, 0, 0, b""), (0, 0, 1000, 0, b"")], 500, True))


@pytest.mark.fault("D14")
def test_a_time_that_goes_back_does_not_change_the_order(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with RecordingWriter(path, RecordingOptions(min_free=0)) as writer:
        port = writer.add_port("n", TimedLong)
        for i, time in enumerate([BEGIN, BEGIN + 5, BEGIN - 3600 * 10**9, BEGIN + 5, BEGIN + 31 * 10**15, BEGIN + 6]):
            writer.write(port, TimedLong(i, i), time)
    assert writer.statistics.clamped == 2
    with RecordingReader(path) as reader:
        assert [s.record.data for s in reader.samples()] == [0, 1, 2, 3, 4, 5]
        assert info_of(reader).gaps == ((BEGIN + 5, BEGIN + 31 * 10**15),)


@pytest.mark.parametrize("indexed", [True, False])
@pytest.mark.parametrize("begin", [0, BEGIN])
def test_what_is_recorded_at_time_0_is_the_first_sample_like_any_other(
    begin: int, indexed: bool, tmp_path: Path
) -> None:
    path, second = tmp_path / "a.mcap", 1000 * MS
    with RecordingWriter(path, RecordingOptions(min_free=0)) as writer:
        assert writer.flush(10.0)
        port = writer.add_port("n", TimedLong)
        for number in range(4):  # a chunk of its own for each
            assert writer.write(port, TimedLong(0, number), begin + number * second)
    if not indexed:
        raw = path.read_bytes()
        path.write_bytes(raw[: raw.index(b"end.json")])
    with RecordingReader(path) as reader:
        assert reader.start == begin
        assert [sample.data for _, _, sample in reader.records(start=reader.start)] == [0, 1, 2, 3]
        found = info_of(reader)
        assert (found.duration, found.closed) == (3.0, indexed)
        assert found.gaps == tuple((begin + n * second, begin + (n + 1) * second) for n in range(3))


@pytest.mark.fault("D17")
def test_a_recording_that_is_there_is_never_touched_unless_that_is_said(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    expected = make(path, 10)
    before = path.read_bytes()
    with pytest.raises(RecordingError, match="exists already; --append continues it, --overwrite replaces it"):
        RecordingWriter(path)
    assert path.read_bytes() == before
    make(path, 5, existing="overwrite")
    assert read(path) == expected[:15]


@pytest.mark.slow
@pytest.mark.fault("D17")
@pytest.mark.fault("F15")
@pytest.mark.parametrize("existing", ["append", "overwrite"])
def test_two_recorders_never_share_a_file(tmp_path: Path, existing: Any) -> None:
    path = tmp_path / "run.mcap"
    with RecordingWriter(path, RecordingOptions(min_free=0)) as writer:
        port = writer.add_port("n", TimedLong)
        writer.write(port, TimedLong(1, 1), 1)
        with pytest.raises(RecordingError, match=rf"this process \({os.getpid()}\) writes it"):
            RecordingWriter(path, RecordingOptions(min_free=0, existing=existing))
        code = (
            "import sys; from aiorts_log import *\n"
            f"RecordingWriter(sys.argv[1], RecordingOptions(min_free=0, existing={existing!r}))"
        )
        done = subprocess.run(
            [sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=False, timeout=100
        )
        assert f"process {os.getpid()} (" in done.stderr  # and its command
        writer.write(port, TimedLong(2, 2), 2)
    assert [value.data for _, _, value in read(path)] == [1, 2]


@pytest.mark.fault("D17")
@pytest.mark.parametrize("existing", ["append", "overwrite"])
def test_who_only_looks_whether_a_file_is_written_keeps_no_recorder_from_it(tmp_path: Path, existing: Any) -> None:
    """`aiorts record` looks so at a file before it asks another process to record there."""
    path = tmp_path / "run.mcap"
    make(path, 10)
    with path.open("rb") as file:
        fcntl.flock(file, fcntl.LOCK_SH)
        looks = threading.Timer(0.02, fcntl.flock, (file, fcntl.LOCK_UN))
        looks.start()
        with RecordingWriter(path, RecordingOptions(min_free=0, existing=existing)):
            assert held_by(path).startswith("this process")
        looks.join()


@pytest.mark.fault("D17")
def test_a_link_is_not_followed_and_nobody_else_may_read(tmp_path: Path) -> None:
    (tmp_path / "link.mcap").symlink_to(tmp_path / "target.mcap")
    for existing in ("refuse", "append", "overwrite"):
        with pytest.raises(RecordingError):
            RecordingWriter(tmp_path / "link.mcap", RecordingOptions(existing=existing))  # type: ignore[arg-type]
    assert not (tmp_path / "target.mcap").exists()
    make(tmp_path / "run.mcap", 1)
    assert (tmp_path / "run.mcap").stat().st_mode & 0o777 == 0o600
    os.mkfifo(tmp_path / "fifo")
    with pytest.raises(RecordingError):
        RecordingWriter(tmp_path / "fifo", RecordingOptions(existing="append"))


@pytest.mark.fault("D18")
@pytest.mark.parametrize("closed", [True, False])
def test_a_recording_is_continued_again_and_again(tmp_path: Path, closed: bool) -> None:
    path = tmp_path / "run.mcap"
    number = 0
    for cycle in range(10):
        options = RecordingOptions(min_free=0, existing="append" if cycle else "refuse", chunk=500)
        with RecordingWriter(path, options, metadata={"cycle": cycle}) as writer:
            assert writer.floor == (BEGIN + number - 1 if number else 0)
            ports = [writer.add_port("n", TimedLong), writer.add_port(f"only{cycle}", TimedString)]
            for _ in range(20):
                writer.write(ports[0], TimedLong(0, number), BEGIN + number)
                number += 1
            writer.write(ports[1], TimedString(0, "x"), BEGIN + number - 1)
        assert writer.statistics.stored == 21
        if not closed:
            with RecordingReader(path) as reader:
                last = max(reader.pieces, key=lambda piece: piece.offset)
            with path.open("rb+") as file:
                file.truncate(last.offset + last.length + 13)  # as a kill leaves it
    with RecordingReader(path) as reader:
        assert [s.record.data for s in reader.samples(ports=["n"])] == list(range(200))
        assert [s.sequence for s in reader.samples(ports=["n"])] == list(range(200))
        assert len(reader.ports) == 11
        assert [one["cycle"] for one in reader.metadata] == list(range(10))
        assert [gap for gap in reader.check() if gap != reader.torn] == []
        assert reader.clean is closed


def test_what_is_damaged_or_not_ours_is_not_continued(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    make(path, 100, chunk=1000)
    raw = bytearray(path.read_bytes())
    path.write_bytes(raw[:-20])
    raw[3000] ^= 1
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(raw[:-20])
    with pytest.raises(RecordingError, match="salvage makes a whole one"):
        RecordingWriter(damaged, RecordingOptions(existing="append"))
    assert damaged.read_bytes() == raw[:-20]
    (tmp_path / "text").write_text("hello")
    with pytest.raises(RecordingError, match="no recording"):
        RecordingWriter(tmp_path / "text", RecordingOptions(existing="append"))
    assert (tmp_path / "text").read_text() == "hello"


@pytest.mark.slow
def test_a_recording_goes_on_in_the_next_file(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    expected = make(path, 400, chunk=1000, max_bytes=20_000)
    paths = [path, *(path.with_name(f"run.{i}.mcap") for i in range(1, len(list(tmp_path.iterdir()))))]
    assert len(paths) > 4
    found = [sample for one in paths for sample in read(one)]
    assert found == expected
    for number, one in enumerate(paths):
        assert one.stat().st_size < 30_000
        with RecordingReader(one) as reader:
            assert reader.clean
            assert reader.metadata == ({"kernel": "test", "part": number},)
    make(tmp_path / "time.mcap", 400, chunk=1000, max_seconds=0.1)
    assert len(list(tmp_path.glob("time*.mcap"))) == 4


def test_a_next_file_that_is_there_stays_and_is_passed_over(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    (tmp_path / "run.1.mcap").write_bytes(b"precious")
    with RecordingWriter(path, RecordingOptions(min_free=0, chunk=1000, max_bytes=20_000)) as writer:
        port = writer.add_port("n", TimedLong)
        for i in range(1000):
            writer.write(port, TimedLong(i, i), i)
    assert writer.failure is None
    assert (tmp_path / "run.1.mcap").read_bytes() == b"precious"
    parts = [path, *(tmp_path / f"run.{number}.mcap" for number in range(2, writer.part + 1))]
    assert [record.data for part in parts for _, _, record in read(part)] == list(range(1000))


def test_flush_returns_when_everything_is_in_the_file(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with RecordingWriter(path, RecordingOptions(min_free=0, age=3600.0, sync="chunk")) as writer:
        port = writer.add_port("n", TimedLong)
        for i in range(3):
            writer.write(port, TimedLong(i, i), i)
            assert writer.flush(10.0)
            assert writer.statistics.durable == i + 1
            assert len(read(path)) == i + 1
    assert not writer.write(port, TimedLong(9, 9), 9)
    assert writer.flush(1.0)
    assert writer.statistics.dropped == {"n": 1}


def test_a_sample_that_cannot_travel_is_counted_and_the_others_go_on(tmp_path: Path) -> None:
    @dataclasses.dataclass
    class Loose:
        number: int = 0

    path = tmp_path / "run.mcap"
    with RecordingWriter(path, RecordingOptions(min_free=0)) as writer:
        port = writer.add_port("n", Loose)
        for value in (1, "text", 2**70, 3):
            writer.write(port, Loose(value), 1)  # type: ignore[arg-type]
    assert writer.statistics.refused == {"n": 2}
    assert [value.number for _, _, value in read(path)] == [1, 3]


def test_what_is_no_sample_of_the_port_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with RecordingWriter(path, RecordingOptions(min_free=0)) as writer:
        port = writer.add_port("n", TimedLong)
        for value in (TimedLong(1, 1), TimedDouble(2, 2.0), object(), None, TimedLong(3, 3)):
            assert writer.write(port, value, 5) is isinstance(value, TimedLong)
        wrong: Any
        for wrong in (-1, 2**63, 1.5, None):
            with pytest.raises(ValueError, match="log_time: expected nanoseconds"):
                writer.write(port, TimedLong(4, 4), wrong)
    assert writer.failure is None
    assert writer.statistics.refused == {"n": 3}
    assert [value.data for _, _, value in read(path)] == [1, 3]


def test_a_sample_that_changes_later_is_recorded_as_it_was(tmp_path: Path) -> None:
    @dataclasses.dataclass
    class Changing:
        number: int = 0

    path = tmp_path / "run.mcap"
    value = Changing()
    with RecordingWriter(path, RecordingOptions(min_free=0)) as writer:
        port = writer.add_port("n", Changing)
        for i in range(100):
            value.number = i
            writer.write(port, value, i)
    assert [one.number for _, _, one in read(path)] == list(range(100))


def test_so_is_what_a_frozen_dataclass_holds(tmp_path: Path) -> None:
    @dataclasses.dataclass(frozen=True)
    class Held:
        numbers: tuple[int, ...] = ()

    path = tmp_path / "run.mcap"
    held: list[int] = []
    with RecordingWriter(path, RecordingOptions(min_free=0)) as writer:
        port = writer.add_port("n", Held)
        for i in range(100):
            held.append(i)
            writer.write(port, Held(held), i)  # type: ignore[arg-type]
    assert [len(one.numbers) for _, _, one in read(path)] == list(range(1, 101))


def test_samples_cannot_be_had_after_the_reader_was_closed(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    make(path, 300, chunk=1000)
    with RecordingReader(path) as reader:
        samples = reader.samples()
        next(samples)
    reader.close()
    with pytest.raises(RecordingError, match="is closed here; open it again"):
        list(samples)


@pytest.mark.parametrize("left", [13, 40])
def test_a_recorder_killed_while_it_closes_can_be_continued(tmp_path: Path, left: int) -> None:
    path = tmp_path / "run.mcap"
    expected = make(path, 30)
    from aiorts_log.mcap.index import read_index
    from aiorts_log.mcap.source import Limits, Source

    source = Source(path, Limits())
    found = read_index(source)
    source.close()
    assert found is not None
    with path.open("rb+") as file:
        file.truncate(found[1] + left)
    assert read(path) == expected
    with RecordingReader(path) as reader:
        assert reader.fault == "its index is missing"
    with RecordingWriter(path, RecordingOptions(min_free=0, existing="append")) as writer:
        writer.write(writer.add_port("log", TimedString), TimedString(0, "more"), writer.floor)
    assert read(path) == [*expected, ("log", expected[-1][1], TimedString(0, "more"))]
    with RecordingReader(path) as reader:
        assert (reader.fault, reader.check()) == ("", ())


def test_a_subclass_has_a_schema_of_its_own(tmp_path: Path) -> None:
    @record
    class Base:
        tm: int = 0

    @record
    class More(Base):
        extra: float = 0.0

    path = tmp_path / "run.mcap"
    samples = [Base(1), More(2, 0.5), Base(3)]
    with RecordingWriter(path, RecordingOptions(min_free=0)) as writer:
        port = writer.add_port("n", Base)
        for sample in samples:
            writer.write(port, sample, sample.tm)
    assert [value for _, _, value in read(path)] == samples
    with RecordingReader(path) as reader:
        assert [port.type for port in reader.ports.values()] == [Base, More]


@pytest.mark.fault("D12")
def test_a_type_that_is_another_one_by_now_is_named_and_told_as_it_was(tmp_path: Path) -> None:
    def made(name: str, annotation: type) -> type:
        cls = type("Reading", (), {"__annotations__": {name: annotation}, "__module__": "somewhere"})
        return dataclasses.dataclass(frozen=True)(cls)

    path = tmp_path / "run.mcap"
    old = made("value", float)
    with RecordingWriter(path, RecordingOptions(min_free=0)) as writer:
        writer.write(writer.add_port("n", old), old(1.5), 7)
    assert len(read(path)) == 1
    new = made("amount", int)
    schema_of(1, new, "msgpack")
    assert wire_name(new) == wire_name(old)
    with RecordingReader(path) as reader:
        (sample,) = reader.samples()
        assert sample.port.type is None
        assert "its fields differ" in sample.port.unknown
        assert sample.port.plain(sample.data) == {"value": 1.5}
        with pytest.raises(RecordingError, match=r"port 'n': somewhere.Reading was another type"):
            list(reader.records())


def test_samples_of_several_threads_and_files_within_the_file(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with RecordingWriter(
        path, RecordingOptions(min_free=0), metadata={"params": {"gain": 1}}, attachments={"system.toml": b"schema = 1"}
    ) as writer:
        port = writer.add_port("n", TimedLong)
        lock = threading.Lock()

        def run(base: int) -> None:
            for i in range(500):
                with lock:  # one at a time, as `write` asks for
                    writer.write(port, TimedLong(0, base + i), 5)

        threads = [threading.Thread(target=run, args=(1000 * i,)) for i in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert sorted(value.data for _, _, value in read(path)) == [1000 * i + j for i in range(4) for j in range(500)]
    with RecordingReader(path) as reader:
        assert [(one.name, one.data) for one in reader.attachments()][1:2] == [("system.toml", b"schema = 1")]
        assert reader.metadata[0]["params"] == {"gain": 1}
        assert reader.endings[0]["why"] == "closed"


@pytest.mark.slow
def test_definitions_stand_in_the_file_again_so_that_no_damage_takes_them_all(tmp_path: Path) -> None:
    path, new = tmp_path / "run.mcap", tmp_path / "new.mcap"
    with RecordingWriter(path, RecordingOptions(min_free=0)) as writer:
        port = writer.add_port("n", bytes)
        for i in range(150):
            writer.write(port, bytes(50_000), i)
    with RecordingReader(path) as reader:
        first = reader.pieces[0]
    raw = bytearray(path.read_bytes()[:-30])  # not closed, and the first chunk is damaged
    raw[first.offset + 100] ^= 1
    path.write_bytes(raw)
    report = salvage(path, new)
    assert report.samples["n"] >= 147
    assert len(read(new)) == report.samples["n"]


@pytest.mark.parametrize(
    "wrong",
    [{"encoding": "xml"}, {"existing": "no"}, {"sync": "often"}, {"chunk": 0}, {"age": float("nan")}, {"queue": 0}],
)
def test_options_that_make_no_sense_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=f"^{next(iter(wrong))}: expected"):
        RecordingOptions(**wrong)


def test_the_limit_on_what_waits_counts_what_samples_hold() -> None:
    from aiorts.types import CameraImage, TimedDoubleSeq
    from aiorts_log.recorder.weight import weigher

    assert weigher(TimedDouble) is None
    assert weigher(TimedPoint3D) is None
    sequence, image, text = weigher(TimedDoubleSeq), weigher(CameraImage), weigher(str)
    assert sequence is not None
    assert image is not None
    assert text is not None
    assert 8000 <= sequence(TimedDoubleSeq(0, np.zeros(1000))) <= 8500
    assert text("x" * 1000) >= 1000


def test_a_sample_that_is_none_of_its_type_is_damage(tmp_path: Path) -> None:
    """Its sum may be right when somebody else's program wrote it."""
    from aiorts_log.mcap.outfile import OutFile

    path = tmp_path / "run.mcap"
    file = OutFile(path, "refuse", 0)
    channel = file.channel_of("n", schema_of(0, TimedLong, "msgpack"), "msgpack", {})
    file.builder.add(channel.id, 0, 5, 5, b"\x93\x01\xa9TimedLong\x80")
    file.finish()
    with pytest.raises(DamagedError, match="port n: TimedLong: missing tm, data"):
        read(path)
    assert json.dumps(RecordingReaderOnce(path)[0].port.plain(b"\xc1")) == '{"encoding": "msgpack", "bytes": "wQ=="}'
