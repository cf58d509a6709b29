"""`--codec NAME`: filters that hand each other binary frames of a codec, ours or a plugin's, in place of JSON lines."""

from __future__ import annotations

import os
import pty
import subprocess
import sys
from pathlib import Path

import pytest

import run_parts
from aiorts.system.stdio.frames import framed
from aiorts.types import TimedDouble, TimedLong
from aiorts.wire import MsgpackCodec
from plugin_dists import project

pytestmark = pytest.mark.row(54)
CODEC = MsgpackCodec()
DUMP = ("flexidump", "-p", "TimedLong", "--format", "values")


def here(*arguments: str, stdin: bytes = b"") -> subprocess.CompletedProcess[bytes]:
    return run_parts.here(*arguments, stdin=stdin)


def frames(*values: int) -> bytes:
    return b"".join(framed("output0", CODEC.encode(TimedLong(1, value))) for value in values)


def test_what_a_filter_writes_is_what_the_next_one_reads() -> None:
    made = here("flexiconst", "-p", "TimedDouble", "-c", "6.2", "-r", "500", "--count", "5", "--codec", "msgpack")
    assert (made.returncode, made.stderr) == (0, b"")
    arguments = ("flexifilter", "-i", "TimedDouble", "-o", "TimedLong", "-m", "0>1000>0", "--codec", "msgpack")
    turned = here(*arguments, stdin=made.stdout)
    assert (turned.returncode, turned.stderr) == (0, b"")
    shown = here(*DUMP, "--codec", "msgpack", stdin=turned.stdout)
    assert (shown.returncode, shown.stdout, shown.stderr) == (0, b"6200\n" * 5, b"")


def test_frames_are_as_they_are_written_down() -> None:
    assert framed("in", b"abc") == b"\x02\x00\x00\x00\x03inabc"


@pytest.mark.slow(kept_by="test_what_a_filter_writes_is_what_the_next_one_reads")
def test_every_frame_of_many_arrives_in_order_in_any_pieces() -> None:
    done = here(*DUMP, "--codec", "msgpack", stdin=frames(*range(20_000)))
    assert done.returncode == 0
    assert done.stdout.split() == [b"%d" % number for number in range(20_000)]


@pytest.mark.parametrize(
    ("data", "good", "fault"),
    [
        (frames(1) + framed("x", b"garbage") + frames(2), [b"1", b"2"], b"frame 2: "),
        (frames(1) + framed("x", CODEC.encode(TimedDouble(1, 2.0))) + frames(2), [b"1", b"2"], b"expected a TimedLong"),
        (
            frames(1) + frames(2)[:-1],
            [b"1"],
            f"frame 2: the input ends inside a frame, after {len(frames(2)) - 1} bytes of it".encode(),
        ),
        (frames(1) + b"\x01\xff\xff\xff\xff", [b"1"], b"frame 2: a frame of 4294967295 bytes; at most 67108864"),
        (b'{"data": 5}\n' * 10, [], b"does the input have frames?"),
    ],
)
def test_a_bad_frame_is_one_line_and_counted_and_the_good_ones_are_processed(
    data: bytes, good: list[bytes], fault: bytes
) -> None:
    done = here(*DUMP, "--codec", "msgpack", stdin=data)
    assert done.stdout.split() == good
    assert done.returncode == 1
    assert done.stderr.startswith(b"aiorts: E-FRAME: standard input, frame ")
    assert fault in done.stderr
    assert done.stderr.count(b"\n") == 1


def test_frames_name_the_port_where_there_are_several() -> None:
    data = framed("input1", CODEC.encode(TimedLong(1, 7))) + framed("none", CODEC.encode(TimedLong(1, 8)))
    done = here("flexidump", "-p", "TimedLong", "-p", "TimedLong", "--codec", "msgpack", stdin=data)
    assert done.stdout.startswith(b"input1 TimedLong")
    assert b"frame 2: no in-port 'none'; there are input0, input1" in done.stderr
    assert done.returncode == 1


def test_count_ends_both_ends() -> None:
    done = here(*DUMP, "--codec", "msgpack", "--count", "3", stdin=frames(1, 2, 3, 4, 5))
    assert (done.returncode, done.stdout.split()) == (0, [b"1", b"2", b"3"])


def test_an_unknown_codec_is_refused_with_a_near_one() -> None:
    done = here(*DUMP, "--codec", "msgpck")
    assert done.returncode == 2
    assert done.stderr == b"aiorts: E-PLUGIN: no codec named 'msgpck'; did you mean msgpack?\n"


def test_a_codec_of_a_plugin_is_used(tmp_path: Path) -> None:
    text = (
        "from aiorts.wire import MsgpackCodec\n"
        "class Turned(MsgpackCodec):\n"
        "    def encode(self, record): return super().encode(record)[::-1]\n"
        "    def decode(self, data, expected=None): return super().decode(data[::-1], expected)\n"
    )
    project(tmp_path, "turned", {"turned": text}, {"codecs/turned": "turned:Turned"})
    data = framed("x", CODEC.encode(TimedLong(1, 42))[::-1])
    done = here("--plugins", str(tmp_path), *DUMP, "--codec", "turned", stdin=data)
    assert (done.returncode, done.stdout, done.stderr) == (0, b"42\n", b"")


@pytest.mark.slow(kept_by="test_a_bad_frame_is_one_line_and_counted_and_the_good_ones_are_processed")
def test_a_codec_that_fails_ends_the_filter_and_nothing_hangs(tmp_path: Path) -> None:
    text = "class Broken:\n    def encode(self, *any): raise OverflowError('no')\n    decode = encode\n"
    project(tmp_path, "broken", {"broken_codec": text}, {"codecs/broken": "broken_codec:Broken"})
    for arguments in (("flexiconst", "-p", "TimedLong", "-c", "1", "--count", "2"), DUMP):
        done = here("--plugins", str(tmp_path), *arguments, "--codec", "broken", "--for", "20", stdin=frames(1))
        assert done.returncode == 1
        assert b"OverflowError: no" in done.stderr
        assert b"Traceback" not in done.stderr


@pytest.mark.slow(kept_by="test_frames_are_as_they_are_written_down")
@pytest.mark.skipif(sys.platform == "win32", reason="terminals are POSIX")
def test_a_terminal_gets_no_binary_frames() -> None:
    ours, theirs = pty.openpty()
    try:
        done = subprocess.run(
            [sys.executable, "-m", "aiorts", "flexiconst", "-p", "TimedLong", "-c", "1", "--codec", "msgpack"],
            stdin=subprocess.DEVNULL,
            stdout=theirs,
            stderr=subprocess.PIPE,
            timeout=40,
        )
    finally:
        os.close(ours)
        os.close(theirs)
    assert done.returncode == 2
    assert b"binary frames are nothing for a terminal; redirect standard output" in done.stderr


@pytest.mark.slow(kept_by="cli/test_demo.py::test_a_reader_that_has_seen_enough_ends_it_quietly")
@pytest.mark.fault("F11")
def test_a_reader_that_goes_ends_the_writer_quietly() -> None:
    writer = subprocess.Popen(
        [
            sys.executable,
            "-m",
            "aiorts",
            *["flexiconst", "-p", "TimedLong", "-c", "1", "--continuous", "--codec", "msgpack"],
        ],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    with run_parts.limited(writer):
        assert writer.stdout is not None
        assert writer.stderr is not None
        assert len(writer.stdout.read(1000)) == 1000
        writer.stdout.close()
        assert writer.wait(30) in (0, 141)
        assert writer.stderr.read() == b""
        writer.stderr.close()
