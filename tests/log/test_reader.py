"""Files that are damaged, cut, forged or no recordings at all: one clean answer, never a wrong value, little memory."""

from __future__ import annotations

import contextlib
import os
import random
import resource
import struct
import subprocess
import sys
import time
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from aiorts.errors import AiortsError
from aiorts_log import (
    DamagedError,
    Limits,
    RecordingError,
    RecordingOptions,
    RecordingReader,
    RecordingWriter,
    salvage,
)
from aiorts_log.mcap.format import (
    CHUNK,
    DATA_END,
    FOOTER,
    FOOTER_SIZE,
    HEAD,
    MAGIC,
    MESSAGE_HEAD,
    Channel,
    ChunkHead,
    Schema,
    record,
)
from aiorts_log.mcap.outfile import beginning
from campaign import CAMPAIGN, cases
from log_parts import TRIPS, Trip, make, read

if TYPE_CHECKING:
    from collections.abc import Iterator

MIB = 2**20


@contextlib.contextmanager
def frugal(most: int = 64 * MIB, seconds: float = 5.0) -> Iterator[None]:
    """What is done within takes no more memory than that, at its peak; the bound on time is generous."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    began = time.monotonic()
    yield
    assert time.monotonic() - began < seconds
    assert (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024 <= most


def outcome(path: Path) -> tuple[list[tuple[str, int, int, bytes]], str]:
    """The samples that a file gives, and the code of the error that ended it."""
    found: list[tuple[str, int, int, bytes]] = []
    told: AiortsError | None = None
    try:
        with RecordingReader(path) as reader:
            found.extend((s.port.name, s.log_time, s.publish_time, s.data) for s in reader.samples())
    except AiortsError as error:
        told = error
    if told is None:
        return found, ""
    assert "\n" not in str(told)
    assert str(path) in str(told)
    return found, told.code


@pytest.mark.slow(kept_by="test_a_check_finds_every_flipped_byte_but_in_the_name_of_who_wrote_it")
@pytest.mark.fault("D06")
@pytest.mark.parametrize("closed", [True, False], ids=["closed", "not closed"])
def test_a_flipped_bit_never_gives_a_wrong_value(tmp_path: Path, closed: bool) -> None:
    path, flipped = tmp_path / "run.mcap", tmp_path / "flipped.mcap"
    make(path, 400, chunk=2048)
    raw = bytearray(path.read_bytes())
    right, _ = outcome(path)
    names = list(read_names(path))
    if not closed:
        with RecordingReader(path) as reader:
            last = reader.pieces[-1]
        del raw[last.offset + last.length :]
    told = 0
    chance = random.Random(6)
    for _ in range(cases(1000) if CAMPAIGN else 100):
        place, bit = chance.randrange(len(raw)), 1 << chance.randrange(8)
        raw[place] ^= bit
        flipped.write_bytes(raw)
        raw[place] ^= bit
        found, error = outcome(flipped)
        assert found == right[: len(found)]
        if len(found) < len(right):
            # What is missing is told: by an error, or as the torn end of a file that was not closed.
            with contextlib.suppress(RecordingError), RecordingReader(flipped) as reader:
                assert error or (reader.torn is not None and not reader.clean)
            told += 1
        else:
            with contextlib.suppress(RecordingError):
                assert list(read_names(flipped)) == names
    assert told > 50


@pytest.mark.slow(kept_by="first")
@pytest.mark.fault("D06")
@pytest.mark.parametrize("closed", [True, False], ids=["closed", "not closed"])
def test_a_check_finds_every_flipped_byte_but_in_the_name_of_who_wrote_it(tmp_path: Path, closed: bool) -> None:
    path, flipped = tmp_path / "run.mcap", tmp_path / "flipped.mcap"
    make(path, 12, chunk=700)
    raw = bytearray(path.read_bytes())
    with RecordingReader(path) as reader:
        named, last = reader._source.begin, reader.pieces[-1]
    if not closed:
        del raw[last.offset + last.length :]
    kinds: dict[int, list[int]] = {}
    """Bytes of records, by their kind."""
    at = named  # behind the name of who wrote it, which has no checksum
    while at < len(raw) - len(MAGIC) * closed:
        kind, length = HEAD.unpack_from(raw, at)
        kinds.setdefault(kind, []).extend(range(at, at + HEAD.size + length))
        at += HEAD.size + length
    chance = random.Random(7)
    for kind, there in kinds.items():
        for place in chance.sample(there, min(len(there), 2000 if CAMPAIGN else 60)):
            raw[place] ^= 1 << chance.randrange(8)
            flipped.write_bytes(raw)
            raw[:] = path.read_bytes()[: len(raw)]
            with contextlib.suppress(AiortsError), RecordingReader(flipped) as reader:
                assert reader.check() or (closed and not reader.clean), (kind, place)


@pytest.mark.fault("D06")
def test_the_sum_over_all_of_it_that_others_write_is_checked(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    make(path, 12, chunk=700)
    with RecordingReader(path) as reader:
        stop = reader.resume()[1]
    raw = bytearray(path.read_bytes())
    for crc, told in ((zlib.crc32(raw[:stop]), ()), (5, ((0, stop, "the checksum of all of it is wrong"),))):
        raw[stop + HEAD.size : stop + HEAD.size + 4] = crc.to_bytes(4, "little")
        path.write_bytes(raw)
        with RecordingReader(path) as reader:
            assert reader.check() == told


def read_names(path: Path) -> Iterator[tuple[str, str, str]]:
    with RecordingReader(path) as reader:
        for name, port in reader.ports.items():
            yield name, port.type_name, str(port.metadata)


@pytest.mark.slow
@pytest.mark.fault("D06")
def test_salvage_skips_what_is_damaged_and_says_where_and_how_much(tmp_path: Path) -> None:
    path, new = tmp_path / "run.mcap", tmp_path / "new.mcap"
    make(path, 400, chunk=2048)
    right, _ = outcome(path)
    with RecordingReader(path) as reader:
        pieces = reader.pieces
    for hit in (0, 7, len(pieces) - 1):
        raw = bytearray(path.read_bytes())
        raw[pieces[hit].offset + 200] ^= 4
        damaged = tmp_path / f"{hit}.mcap"
        damaged.write_bytes(raw)
        with pytest.raises(DamagedError, match=f"byte {pieces[hit].offset}: the checksum") as caught:
            read(damaged)
        assert caught.value.offset == pieces[hit].offset
        report = salvage(damaged, new, existing="overwrite")
        (gap,) = report.lost
        assert (gap.offset, gap.length >= pieces[hit].length) == (pieces[hit].offset, True)
        found, error = outcome(new)
        assert error == ""
        lost = [sample for sample in right if sample not in found]
        assert [sample for sample in right if sample in found] == found
        assert 0 < len(lost) < 40
        assert sum(report.missing.values()) == len(lost)
        with RecordingReader(new) as reader:
            assert reader.check() == ()


@pytest.mark.slow
@pytest.mark.fault("D06")
def test_salvage_finds_chunks_behind_a_length_that_is_wrong(tmp_path: Path) -> None:
    path, damaged, new = tmp_path / "run.mcap", tmp_path / "damaged.mcap", tmp_path / "new.mcap"
    make(path, 400, chunk=2048)
    right, _ = outcome(path)
    with RecordingReader(path) as reader:
        hit, behind = reader.pieces[5], reader.pieces[6]
    for where, what in ((0, b"\x00"), (0, b"\x7f"), (1, b"\xff\xff"), (6, b"\xff\xff"), (2, b"\0")):
        raw = bytearray(path.read_bytes())
        raw[hit.offset + where : hit.offset + where + len(what)] = what
        damaged.write_bytes(raw)
        report = salvage(damaged, new, existing="overwrite")
        found, _ = outcome(new)
        assert report.lost[0].offset <= hit.offset < behind.offset <= report.lost[0].offset + report.lost[0].length
        assert [sample for sample in right if sample in found] == found
        assert 1150 < len(found) < 1200
        assert len(right) - len(found) == sum(report.missing.values())


@pytest.mark.slow
@pytest.mark.fault("D07")
def test_a_file_cut_at_any_length_gives_a_clean_message(tmp_path: Path) -> None:
    path, cut = tmp_path / "run.mcap", tmp_path / "cut.mcap"
    make(path, 60, chunk=700)
    whole = path.read_bytes()
    right, _ = outcome(path)
    lengths = range(4097) if CAMPAIGN else (*range(64), *range(64, 4097, 61))
    chance = random.Random(1)
    with frugal(seconds=60.0):
        for length in (*lengths, *(chance.randrange(4097, len(whole)) for _ in range(50))):
            cut.write_bytes(whole[:length])
            found, error = outcome(cut)
            assert found == right[: len(found)]
            assert error in ("", "E-RECORDING", "E-DAMAGED")
            assert error or length > 60


def forged(path: Path, *records: bytes) -> Path:
    path.write_bytes(beginning() + b"".join(records))
    return path


def channel() -> bytes:
    return Schema(1, "TimedLong", "jsonschema", b"{}").put() + Channel(1, 1, "n", "msgpack", {}).put()


def chunk(records: bytes, said: int | None = None, compression: str = "", stored: bytes | None = None) -> bytes:
    stored = records if stored is None else stored
    size = len(records) if said is None else said
    return ChunkHead(0, 9, size, zlib.crc32(records), compression, len(stored), 0).put() + stored


def bomb(name: str) -> bytes:
    zeros = bytes(MIB)
    if name == "zstd":
        zstandard = pytest.importorskip("zstandard")
        packer = zstandard.ZstdCompressor().compressobj()
        return b"".join(packer.compress(zeros) for _ in range(1024)) + bytes(packer.flush())
    frame = pytest.importorskip("lz4.frame")
    return bytes(frame.compress(zeros * 256))


@pytest.mark.slow(kept_by="first")
@pytest.mark.fault("D08")
@pytest.mark.parametrize(
    ("records", "what"),
    [
        ([HEAD.pack(CHUNK, 2**31)], "2147483648"),
        ([HEAD.pack(CHUNK, 2**63)], "9223372036854775808"),
        ([HEAD.pack(CHUNK, 2**64 - 1)], "18446744073709551615"),
        ([HEAD.pack(0x20, 2**63)], "9223372036854775808"),
        ([chunk(MESSAGE_HEAD.pack(5, 2**63, 1, 0, 1, 1))], "9223372036854775808"),
        ([chunk(MESSAGE_HEAD.pack(5, 3, 1, 0, 1, 1))], "3 bytes"),
        ([chunk(Schema(1, "x" * 9, "", b"").put().replace(b"\x09\0\0\0", b"\xff\xff\xff\xff"))], "4294967295"),
        ([chunk(b"", said=10 * 2**30, compression="zstd", stored=b"x" * 100)], "10737418240"),
        ([chunk(b"", said=2**63, compression="lz4", stored=b"x" * 100)], "9223372036854775808"),
        (["zstd"], "more"),
        (["lz4"], "more"),
    ],
    ids=range(11),
)
def test_lengths_that_cannot_be_and_bombs_take_no_memory(tmp_path: Path, records: list[bytes], what: str) -> None:
    """The number is in the message; a file that is nothing else holds nothing."""
    records = [
        chunk(bytes(9), said=MIB, compression=one, stored=bomb(one)) if isinstance(one, str) else one for one in records
    ]
    path = forged(tmp_path / "forged.mcap", *records)
    with frugal(), RecordingReader(path) as reader:
        assert list(reader.samples()) == []
        assert not reader.clean
        assert reader.torn is not None
        assert what in reader.torn.why
        assert what in str(reader.check())


@pytest.mark.fault("D08")
def test_an_index_that_lies_is_found_out(tmp_path: Path) -> None:
    """Its sum is right, as an attacker's would be; what it says of chunks is held against the chunks."""
    from aiorts_log.mcap.index import read_index
    from aiorts_log.mcap.source import Source

    path, lying = tmp_path / "run.mcap", tmp_path / "lying.mcap"
    make(path, 100, chunk=2048)
    whole = path.read_bytes()
    right, _ = outcome(path)
    source = Source(path, Limits())
    found = read_index(source)
    source.close()
    assert found is not None
    summary, stop = found
    first, second = summary.chunks[0], summary.chunks[1]
    lies = (
        first._replace(offset=2**62),
        first._replace(offset=first.offset + 1),
        first._replace(length=2**63),
        first._replace(offset=second.offset),
        first._replace(end=first.end + 5),
        first._replace(start=0),
    )
    for lie in lies:
        summary.chunks[0] = lie
        lying.write_bytes(whole[:stop] + b"".join(summary.put(stop)))
        with frugal():
            got, error = outcome(lying)
        assert got == right[: len(got)]
        if error == "":
            with RecordingReader(lying) as reader:
                assert "its index is damaged" in reader.fault
                assert got == right
    for chunks in ([first, *summary.chunks[2:]], [first, *summary.chunks[2:], summary.chunks[-1]]):
        summary.chunks = chunks  # it leaves one out, and says so consistently
        lying.write_bytes(whole[:stop] + b"".join(summary.put(stop)))
        got, error = outcome(lying)
        with RecordingReader(lying) as reader:
            assert error == "E-DAMAGED" or "its index is damaged" in reader.fault
            assert reader.check() != () or got == right


@pytest.mark.fault("D08")
def test_a_message_outside_the_time_of_its_chunk_is_damage(tmp_path: Path) -> None:
    for log_time in (100, 10):
        message = MESSAGE_HEAD.pack(5, 22, 1, 0, log_time, 0)
        path = forged(tmp_path / "forged.mcap", chunk(channel() + message), record(DATA_END, bytes(4)))
        assert outcome(path) == ([], "E-DAMAGED")
    message = MESSAGE_HEAD.pack(5, 22, 1, 0, 9, 0)
    path = forged(tmp_path / "forged.mcap", chunk(channel() + message), record(DATA_END, bytes(4)))
    assert len(outcome(path)[0]) == 1


@pytest.mark.fault("D08")
def test_a_message_of_a_port_that_nothing_defines_is_damage(tmp_path: Path) -> None:
    message = MESSAGE_HEAD.pack(5, 22, 7, 0, 9, 0)
    path = forged(tmp_path / "forged.mcap", chunk(channel() + message), record(DATA_END, bytes(4)))
    assert outcome(path) == ([], "E-DAMAGED")
    report = salvage(path, tmp_path / "new.mcap")
    assert "1 samples of ports that nothing defines" in report.lost[0].why


@pytest.mark.slow
@pytest.mark.fault("D06")
def test_a_chunk_that_looks_like_something_else_is_missed(tmp_path: Path) -> None:
    """One flipped bit makes it a record that may be skipped, or an end; without an index only the numbers tell."""
    path, flipped = tmp_path / "run.mcap", tmp_path / "flipped.mcap"
    make(path, 120, chunk=2048)
    right, _ = outcome(path)
    with RecordingReader(path) as reader:
        pieces = reader.pieces
    raw = bytearray(path.read_bytes()[: pieces[-1].offset + pieces[-1].length])
    for piece in (pieces[3], pieces[-1]):
        for kind in (*range(16), 0x16, 0x26, 0x46, 0x86):
            if kind == CHUNK:
                continue
            raw[piece.offset] = kind
            flipped.write_bytes(raw)
            found, error = outcome(flipped)
            assert found == right[: len(found)]
            assert len(found) < len(right)
            with RecordingReader(flipped) as reader:
                assert error == "E-DAMAGED" or (not reader.clean and reader.torn is not None)
        raw[piece.offset] = CHUNK


@pytest.mark.fault("D06")
def test_a_chunk_that_is_not_there_any_more_is_missed(tmp_path: Path) -> None:
    """As after a copy that lost a block: everything that is left is whole, and the numbers of the samples tell."""
    path, less, new = tmp_path / "run.mcap", tmp_path / "less.mcap", tmp_path / "new.mcap"
    make(path, 120, chunk=2048)
    right, _ = outcome(path)
    with RecordingReader(path) as reader:
        gone, behind, last = reader.pieces[3], reader.pieces[4], reader.pieces[-1]
    raw = path.read_bytes()
    less.write_bytes(raw[: gone.offset] + raw[behind.offset : last.offset + last.length])
    found, error = outcome(less)
    assert (found == right[: len(found)], error) == (True, "E-DAMAGED")
    report = salvage(less, new)
    kept, _ = outcome(new)
    assert sum(report.missing.values()) == len(right) - len(kept) > 0
    assert "samples are missing" in report.lost[0].why


@pytest.mark.slow(kept_by="test_an_index_that_lies_is_found_out")
@pytest.mark.fault("D06")
def test_figures_of_an_index_that_is_damaged_are_not_told(tmp_path: Path) -> None:
    path, flipped = tmp_path / "run.mcap", tmp_path / "flipped.mcap"
    make(path, 100, chunk=2048)

    def figures(path: Path) -> tuple[object, ...]:
        with RecordingReader(path) as reader:
            names = [(n, p.type_name, p.count, dict(p.metadata), p.schema) for n, p in reader.ports.items()]
            return reader.count, reader.start, reader.end, len(reader.pieces), names

    right = figures(path)
    raw = bytearray(path.read_bytes())
    begin = raw.rindex(HEAD.pack(DATA_END, 4))
    chance = random.Random(2)
    for place in range(begin, len(raw)) if CAMPAIGN else chance.sample(range(begin, len(raw)), 200):
        raw[place] ^= 1 << chance.randrange(8)
        flipped.write_bytes(raw)
        raw[:] = path.read_bytes()
        assert figures(flipped) == right


@pytest.mark.fault("D09")
def test_what_is_no_recording_is_refused_in_one_line(tmp_path: Path) -> None:
    def made(name: str, raw: bytes) -> Path:
        (tmp_path / name).write_bytes(raw)
        return tmp_path / name

    os.mkfifo(tmp_path / "fifo")
    (tmp_path / "loop").symlink_to("loop")
    refused = {
        made("magic", b"\x89PNG\r\n\x1a\n" + bytes(100)): "no recording: it does not begin with",
        made("text", b"hello, world\n" * 10): "no recording: it does not begin with",
        made("empty", b""): "it is empty",
        made("short", MAGIC[:5]): "it ends after 5 bytes",
        tmp_path: "is a folder",
        tmp_path / "fifo": "no regular file",
        Path("/dev/zero"): "no regular file",
        tmp_path / "loop": "cannot be read: Too many levels of symbolic links",
        tmp_path / "absent": "cannot be read: No such file",
        Path("a\0b"): "cannot be read",
        made("version", MAGIC.replace(b"0", b"1") + bytes(100)): "MCAP of version '1'",
    }
    for path, why in refused.items():
        began = time.monotonic()
        with pytest.raises(RecordingError, match=why):
            RecordingReader(path)
        assert time.monotonic() - began < 1.0


@pytest.mark.fault("D09")
@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become somebody who may not")
def test_a_file_that_may_not_be_read_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    make(path, 1)
    os.seteuid(65534)
    try:
        with pytest.raises(RecordingError, match="cannot be read: Permission denied"):
            RecordingReader(path)
    finally:
        os.seteuid(0)
    assert path.stat().st_mode & 0o777 == 0o600


GOLDEN = Path(__file__).parent / "golden"


@pytest.mark.fault("D10")
def test_recordings_of_other_versions(tmp_path: Path) -> None:
    whole = (GOLDEN / "format-1.0.mcap").read_bytes()
    newer = tmp_path / "newer.mcap"
    newer.write_bytes(whole.replace(b"recording format 1.0", b"recording format 2.0", 1))
    with pytest.raises(RecordingError, match=r"written by aiorts .*, recording format 2\.0; this reads <= 1"):
        RecordingReader(newer)
    newer.write_bytes(whole.replace(b"recording format 1.0", b"recording format 1.9", 1))
    assert read(newer) == read(GOLDEN / "format-1.0.mcap")
    with RecordingReader(GOLDEN / "format-1.7.mcap") as reader:
        assert [record for _, _, record in reader.records()] == [r for _, _, r in read(GOLDEN / "format-1.0.mcap")]
        assert reader.skipped == 1
        assert reader.clean
    with RecordingReader(GOLDEN / "format-1.0.mcap") as reader:
        assert reader.check() == ()
        assert reader.metadata[0]["kernel"] == "golden"
        assert [port.unknown for port in reader.ports.values()] == [""] * 5
        assert reader.count == 10


@pytest.mark.fault("D10")
@pytest.mark.parametrize("encoding", ["msgpack", "json"])
def test_a_stored_recording_has_the_fields_that_it_had_and_is_written_so_to_the_byte(
    encoding: Any, tmp_path: Path
) -> None:
    stored = GOLDEN / f"fields-{encoding}-1.0.mcap"
    with RecordingReader(stored) as reader:
        assert tuple(one for _, _, one in reader.records()) == TRIPS
        (port,), before = reader.ports.values(), [sample.data for sample in reader.samples()]
        assert port.unknown == ""
    with RecordingWriter(tmp_path / "new.mcap", RecordingOptions(min_free=0, encoding=encoding)) as writer:
        number = writer.add_port("trip", Trip)
        assert all(writer.write(number, trip, time) for time, trip in enumerate(TRIPS))
    with RecordingReader(tmp_path / "new.mcap") as reader:
        assert [sample.data for sample in reader.samples()] == before
        assert reader.ports["trip"].schema == port.schema


@pytest.mark.fault("D10")
def test_a_compression_that_nobody_knows_is_named(tmp_path: Path) -> None:
    path = forged(tmp_path / "run.mcap", chunk(channel(), compression="brotli"), record(DATA_END, bytes(4)))
    with RecordingReader(path) as reader, pytest.raises(DamagedError, match="compressed by 'brotli'"):
        list(reader.samples())


NESTED = b"\x80\x04" + b"(" * 200_000 + b"."
EVIL = b"\x80\x04\x95\x1e\x00\x00\x00\x00\x00\x00\x00\x8c\x05posix\x8c\x06system\x93\x8c\x08touch ow\x85R."
MEMO = b"\x80\x04r\xff\xff\xff\x7f."


@pytest.mark.fault("D11")
@pytest.mark.parametrize("raw", [EVIL, MEMO, NESTED], ids=["os.system", "memo", "nested"])
def test_a_pickle_is_refused_by_its_first_bytes(tmp_path: Path, raw: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "logger.log"
    path.write_bytes(raw)
    with frugal(10 * MIB), pytest.raises(RecordingError, match="no recording"):
        RecordingReader(path)
    with pytest.raises(RecordingError, match="no recording"):
        salvage(path, tmp_path / "new.mcap")
    assert sorted(os.listdir(tmp_path)) == ["logger.log"]


@pytest.mark.fault("D11")
def test_no_source_of_recordings_knows_pickles() -> None:
    for path in (Path(__file__).parents[2] / "plugins" / "aiorts_log").rglob("*.py"):
        assert "pickle" not in path.read_text(encoding="utf-8")


@pytest.mark.slow(kept_by="log/test_player.py::test_nothing_is_imported_for_a_file")
@pytest.mark.fault("D12")
def test_nothing_that_a_file_names_is_imported(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    frame = b"\x93\x01\xb1evil_module.Evil\x00\xa0"
    message = MESSAGE_HEAD.pack(5, 22 + len(frame), 1, 0, 1, 1) + frame
    definitions = Schema(1, "evil_module.Evil", "jsonschema", b"{}").put() + Channel(1, 1, "n", "msgpack", {}).put()
    forged(path, chunk(definitions + message), record(DATA_END, bytes(4)))
    (tmp_path / "evil_module.py").write_text("raise SystemExit('imported')")
    code = (
        "import sys; sys.path.insert(0, '.')\n"
        "from aiorts_log import RecordingReader\n"
        "with RecordingReader('run.mcap') as reader:\n"
        "    print([(s.port.unknown, s.port.plain(s.data)) for s in reader.samples()])\n"
        "    try: list(reader.records())\n"
        "    except Exception as error: print(error)\n"
        "print('evil_module' in sys.modules)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False, timeout=100
    )
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert "no type 'evil_module.Evil' is known here" in lines[0]
    assert "import the module that defines it" in lines[1]
    assert lines[2] == "False"


def test_a_footer_that_points_nowhere_is_found_out(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    expected = make(path, 20)
    raw = bytearray(path.read_bytes())
    at = len(raw) - len(MAGIC) - FOOTER_SIZE
    assert HEAD.unpack_from(raw, at)[0] == FOOTER
    for where in (2**63, len(raw) - 20, 5):
        struct.pack_into("<Q", raw, at + HEAD.size, where)
        path.write_bytes(raw)
        with RecordingReader(path) as reader:
            assert "its index is damaged" in reader.fault
            assert list(reader.records()) == expected
