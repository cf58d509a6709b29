"""Text recordings: what is written is read again to the bit, what is none is refused, what is torn is told."""

from __future__ import annotations

import errno
import json
import math
import os
import pickle
from pathlib import Path
from typing import Any

import pytest

from aiorts.types import TimedDouble, TimedString
from aiorts_log import (
    DamagedError,
    RecordingError,
    RecordingOptions,
    RecordingReader,
    TextReader,
    TextWriter,
    open_recording,
)
from aiorts_log.mcap.locked_file import LockedFile
from log_parts import BEGIN, MS, make

ESCAPE = "a\x1b[2Jb\n../../c\t#"


def write(path: Path, count: int = 10, **options: Any) -> list[tuple[str, int, Any]]:
    """A text recording of two ports with names and texts that would break lines."""
    expected: list[tuple[str, int, Any]] = []
    with TextWriter(path, RecordingOptions(**{"min_free": 0, **options}), metadata={"kernel": "test"}) as writer:
        ports = {name: writer.add_port(name, cls) for name, cls in ((ESCAPE, TimedDouble), ("#text", TimedString))}
        begin = max(BEGIN, writer.floor + 1)
        for i in range(count):
            for name, record in (
                (ESCAPE, TimedDouble(i, i / 7)),
                ("#text", TimedString(i, f"\t\r\n\x1b\x85\u2028 # ü {i}")),
            ):
                assert writer.write(ports[name], record, begin + i * MS)
                expected.append((name, begin + i * MS, record))
    assert writer.failure is None
    return expected


@pytest.mark.fault("D16")
@pytest.mark.fault("D22")
def test_what_was_written_is_read_again(tmp_path: Path) -> None:
    path = tmp_path / "run.txt"
    expected = write(path)
    lines = path.read_text().splitlines()
    assert lines[0].startswith("# aiorts text recording 1.0, aiorts ")
    assert lines[3] == 'a\\u001b[2Jb\\n../../c\\t#\tTimedDouble\t1700000000.000000000\t{"tm": 0, "data": 0.0}'
    assert all(line.isprintable() for line in path.read_text().replace("\t", "").split("\n"))
    with open_recording(path) as reader:
        assert isinstance(reader, TextReader)
        assert list(reader.records()) == expected
        assert (reader.count, reader.start, reader.end) == (20, BEGIN, BEGIN + 9 * MS)
        assert (reader.clean, reader.fault, reader.check()) == (True, "", ())
        assert {name: (port.type, port.count) for name, port in reader.ports.items()} == {
            ESCAPE: (TimedDouble, 10),
            "#text": (TimedString, 10),
        }
        assert reader.metadata == ({"kernel": "test", "part": 0},)
        assert reader.endings[0]["stored"] == 20
        assert [sample.publish_time for sample in reader.samples(ports=[ESCAPE])] == list(range(10))
        part = reader.records(start=BEGIN + 3 * MS, end=BEGIN + 5 * MS, ports=["#text"])
        assert list(part) == expected[7:10:2]
        with pytest.raises(RecordingError, match=r"no port 'text'; there are"):
            list(reader.samples(ports=["text"]))


@pytest.mark.fault("D17")
def test_a_file_that_is_there_is_refused_continued_or_replaced(tmp_path: Path) -> None:
    path = tmp_path / "run.txt"
    first = write(path)
    with pytest.raises(RecordingError, match="exists already; --append"):
        TextWriter(path)
    second = write(path, existing="append")
    with TextReader(path) as reader:
        assert list(reader.records()) == first + second
        assert (reader.clean, reader.fault, len(reader.metadata), len(reader.ports)) == (True, "", 2, 2)
    third = write(path, 1, existing="overwrite")
    with TextReader(path) as reader:
        assert list(reader.records()) == third
    make(tmp_path / "run.mcap", 1)
    with pytest.raises(RecordingError, match="is no text recording and cannot be continued"):
        TextWriter(tmp_path / "run.mcap", RecordingOptions(existing="append"))
    with RecordingReader(tmp_path / "run.mcap") as whole:
        assert whole.count == 3


@pytest.mark.slow(kept_by="test_a_last_line_that_ends_within_its_record_is_torn")
@pytest.mark.fault("D07")
def test_truncated_at_every_length_it_is_an_exact_prefix_or_one_message(tmp_path: Path) -> None:
    path, cut = tmp_path / "run.txt", tmp_path / "cut.txt"
    expected = write(path, 4)
    raw = path.read_bytes()
    for length in range(len(raw)):
        cut.write_bytes(raw[:length])
        try:
            with open_recording(cut) as reader:
                found = list(reader.records())
                assert found == expected[: len(found)]
                assert len(found) >= raw[:length].count(b'"data": ') - 1
                assert not reader.clean or length == len(raw) - 1
        except RecordingError as error:
            assert length < len("# aiorts text recording ")
            assert str(error).startswith(f"{cut}: no recording: ")  # noqa: PT017


def test_a_torn_recording_is_continued_behind_its_last_whole_line(tmp_path: Path) -> None:
    path = tmp_path / "run.txt"
    expected = write(path, 4)
    raw = path.read_bytes()
    for line_end, kept in ((raw.rindex(b"# {"), 8), (raw.rindex(b"# {") - 1, 8), (raw.rindex(b"# {") - 9, 7)):
        path.write_bytes(raw[:line_end])
        more = write(path, 1, existing="append")
        with TextReader(path) as reader:
            assert list(reader.records()) == expected[:kept] + more
            assert (reader.clean, reader.fault) == (True, "")


def test_a_last_line_that_ends_within_its_record_is_torn(tmp_path: Path) -> None:
    path = tmp_path / "run.txt"
    path.write_text('a\tint\t1.000000000\t{"value": 1}\na\tPoint2D\t2.000000000\t{"x": {"y": 1}')
    with TextReader(path) as reader:
        assert list(reader.records()) == [("a", 10**9, 1)]
        assert reader.torn is not None
        assert (reader.clean, reader.torn.offset) == (False, path.read_text().index("\n") + 1)


def test_numbers_that_are_not_finite_are_texts_of_json(tmp_path: Path) -> None:
    path = tmp_path / "run.txt"
    with TextWriter(path, RecordingOptions(min_free=0)) as writer:
        port = writer.add_port("a", TimedDouble)
        for number in (math.nan, math.inf, -math.inf, -0.0, 5e-324):
            writer.write(port, TimedDouble(1, number), 1)
    data = [line.split("\t")[3] for line in path.read_text().splitlines() if line.startswith("a")]
    assert [json.loads(one, parse_constant=pytest.fail)["data"] for one in data] == [
        "NaN",
        "Infinity",
        "-Infinity",
        -0.0,
        5e-324,
    ]
    assert data[3] == '{"tm": 1, "data": -0.0}'


def test_a_line_that_is_none_is_named_and_what_stands_before_it_is_given(tmp_path: Path) -> None:
    path = tmp_path / "run.txt"
    expected = write(path)
    lines = path.read_text().split("\n")
    for bad, why in (
        ("hello", "expected PORT, TYPE, TIME and DATA"),
        ("a\tTimedDouble\t12\t{}", "expected a time as seconds with nine digits, got '12'"),
        ("a\tTimedDouble\t12.000000000\t1.5", "expected the JSON of a record"),
        ("a\tTimedDouble\t9999999999.000000000\t{}", "expected PORT"),
        ('a"b\tTimedDouble\t12.000000000\t{}', "no name"),
    ):
        path.write_text("\n".join([*lines[:10], bad, *lines[10:]]))
        with TextReader(path) as reader:
            found = []
            with pytest.raises(DamagedError, match=rf"run\.txt: line 11: {why}.*; aiorts log salvage copies"):
                found.extend(reader.records())
            assert list(reader.records(end=BEGIN)) == []
            assert reader.check()[0].why.startswith(f"line 11: {why}")
    path.write_text("\n".join([*lines[:10], *lines[11:]]))
    with TextReader(path) as reader:
        assert reader.fault == "its end counts other samples than there are: lines were taken out, or put in"
    path.write_text("\n".join(lines).replace('"data": 0.0', '"data": "x"'))
    with TextReader(path) as reader, pytest.raises(DamagedError, match=r"run\.txt: line 4: TimedDouble\.data: exp"):
        list(reader.records())
    assert len(expected) == 20


def test_lines_alone_are_a_recording_too_and_come_in_the_order_of_their_time(tmp_path: Path) -> None:
    path = tmp_path / "some.txt"
    write(tmp_path / "run.txt")
    lines = [line for line in (tmp_path / "run.txt").read_text().splitlines() if not line.startswith("# ")]
    path.write_text("".join(f"{line}\n" for line in reversed(lines)))
    with open_recording(path) as reader:
        times = [time for _, time, _ in reader.records()]
        assert times == sorted(times)
        assert (len(times), reader.clean) == (20, True)


@pytest.mark.fault("D10")
def test_a_newer_version_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.txt"
    path.write_text("# aiorts text recording 2.0, aiorts 9.0\n")
    with pytest.raises(RecordingError, match=r"recording 2\.0, aiorts 9\.0; this reads <= 1; install a newer"):
        open_recording(path)
    path.write_text('# aiorts text recording 1.7, aiorts 9.0\n# {"new": 1}\n')
    with open_recording(path) as reader:
        assert reader.count == 0


@pytest.mark.fault("D12")
def test_a_type_that_is_not_known_here_is_told_as_plain_data(tmp_path: Path) -> None:
    path = tmp_path / "run.txt"
    path.write_text('a\tno_such_module.Type\t1.000000000\t{"data": [1, 2]}\n')
    with open_recording(path) as reader:
        sample = next(iter(reader.samples()))
        assert "no type 'no_such_module.Type' is known here" in sample.port.unknown
        assert sample.port.plain(sample.data) == {"data": [1, 2]}
        with pytest.raises(RecordingError, match="import the module"):
            list(reader.records())


class _Bomb:
    def __reduce__(self) -> tuple[Any, ...]:
        return os.system, ("touch canary",)


@pytest.mark.fault("D11")
@pytest.mark.fault("D09")
def test_what_is_no_recording_is_one_clear_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "it"
    for protocol in range(6):
        path.write_bytes(pickle.dumps(_Bomb(), protocol))
        with pytest.raises(RecordingError, match=r"it: no recording: it begins as no recording does"):
            open_recording(path)
    assert not (tmp_path / "canary").exists()
    for raw, why in (
        (b"", "no recording: it is empty"),
        (b"hello\n", "no recording: it begins as no recording does"),
        (b"t,x,y\n0,1,2\n", "CSV: aiorts log convert"),
        (b'[{"data": 1}]', "no recording"),
        (b"\0" * 5000, "no recording"),
        (b"\x89MCAP", "it ends after 5 bytes"),
    ):
        path.write_bytes(raw)
        with pytest.raises(RecordingError, match=why):
            open_recording(path)
    path.unlink()
    os.mkfifo(path)
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    for name, why in (("it", "no regular file"), (".", "a folder"), ("absent", "No such file"), ("loop", "symbolic")):
        with pytest.raises(RecordingError, match=why):
            open_recording(tmp_path / name)
    with pytest.raises(RecordingError, match="no regular file"):
        open_recording("/dev/zero")


class _Full(LockedFile):
    """A disk that has room for 2000 bytes."""

    def put(self, parts: list[memoryview]) -> int:
        if self.size + sum(map(len, parts)) > 2000:
            raise OSError(errno.ENOSPC, "No space left on device")
        return super().put(parts)


@pytest.mark.fault("D03")
def test_a_full_disk_ends_it_and_what_is_there_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "run.txt"
    writer = TextWriter(path, RecordingOptions(min_free=0, chunk=300), kind=_Full)
    port = writer.add_port("a", TimedDouble)
    for i in range(100):
        writer.write(port, TimedDouble(i, 1.0), i)
    statistics = writer.close()
    assert "recording ended: No space left on device" in str(writer.failure)
    assert 0 < statistics.stored < 100
    assert statistics.stored + statistics.dropped["a"] == 100
    with open_recording(path) as reader:
        assert [time for _, time, _ in reader.records()] == list(range(statistics.stored))
    with pytest.raises(RecordingError, match="are to stay so"):
        TextWriter(tmp_path / "other.txt", RecordingOptions(min_free=2**62))
