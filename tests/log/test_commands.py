"""`aiorts log`: info, cat and salvage, and what they say when they cannot."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from aiorts.cli.app import run_command
from aiorts.types import TimedString
from aiorts_log import RecordingOptions, RecordingReader, RecordingWriter, info_of, open_recording
from log_parts import BEGIN, MS, make, read


def run(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> tuple[int, str, str]:
    capsys.readouterr()
    status = run_command(["log", *map(str, arguments)])
    said = capsys.readouterr()
    return status, said.out, said.err


@pytest.mark.slow
def test_info_says_what_a_recording_holds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "run.mcap"
    make(path, 101)
    status, out, err = run(capsys, "info", path)
    assert (status, err) == (0, "")
    lines = out.splitlines()
    assert lines[0].startswith(f"{path}: 303 samples of 3 ports, ")
    assert lines[1].startswith("  from 2023-11-14 22:13:20.000 UTC for 0.100 s, in ")
    assert lines[2].split() == ["pid0.command", "TimedDouble", "101", "1000", "Hz"]
    assert len(lines) == 5
    status, out, _ = run(capsys, "info", path, "--json", "--check")
    found = json.loads(out)
    assert (status, found["samples"], found["seconds"], found["closed"], found["damage"]) == (0, 303, 0.1, True, [])
    assert found["ports"][2] == {
        "name": "log",
        "type": "TimedString",
        "encoding": "msgpack",
        "samples": 101,
        "rate": pytest.approx(1000.0),
        "unknown": "",
    }
    assert found["metadata"][0]["kernel"] == "test"
    assert "all checksums are right" in run(capsys, "info", "--check", path)[1]
    lines = tmp_path / "run.jsonl"  # has none
    assert run(capsys, "convert", path, lines)[0] == 0
    assert run(capsys, "info", "--check", lines)[1].endswith("\n  all of it can be read\n")


@pytest.mark.slow
@pytest.mark.parametrize("form", ["mcap", "jsonl", "text", "not closed"])
def test_the_rate_of_a_port_is_taken_from_its_first_sample_to_its_last(
    form: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "run.mcap"
    with RecordingWriter(path, RecordingOptions(min_free=0, chunk=1024)) as writer:
        names = ("plant.fast", "slow", "event", "once", "at_once", "none")
        fast, slow, event, once, at_once, _ = (writer.add_port(name, TimedString) for name in names)
        for i in range(1, 1001):
            writer.write(fast, TimedString(i, "x" * 20), i * 10 * MS)
            if not i % 20 and i <= 500:
                writer.write(slow, TimedString(i, ""), i * 10 * MS)
            if i in (400, 600):
                writer.write(event, TimedString(i, ""), i * 10 * MS)
            if i == 400:
                writer.write(once, TimedString(i, ""), i * 10 * MS)
                for number in range(2):
                    writer.write(at_once, TimedString(number, ""), i * 10 * MS)
    if form == "not closed":
        path.write_bytes(path.read_bytes()[:-20])
    elif form != "mcap":
        target = tmp_path / ("run.jsonl" if form == "jsonl" else "run.txt")
        assert run(capsys, "convert", path, target)[0] == 0
        path = target
    with open_recording(path) as reader:
        assert len(reader.pieces) > (20 if form in ("mcap", "not closed") else 0)
        if form == "mcap":
            loaded = []
            monkeypatch.setattr(reader, "_load", lambda piece, load=reader._load: loaded.append(piece) or load(piece))
        rates = {port.name: port.rate for port in info_of(reader).ports}
        if form == "mcap":
            assert len(loaded) <= 12
    assert rates.pop("none", None) is None
    assert rates == {
        "plant.fast": pytest.approx(100.0),
        "slow": pytest.approx(5.0),
        "event": pytest.approx(0.5),
        "once": None,
        "at_once": None,
    }


@pytest.mark.fault("D06")
@pytest.mark.parametrize("what", ["the index of messages", "the index of all"])
def test_a_flipped_index_is_told_and_its_samples_are_read(
    what: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, new = tmp_path / "run.mcap", tmp_path / "new.mcap"
    expected = make(path, 101)
    with RecordingReader(path) as reader:
        chunk, end = reader.pieces[0], reader.resume()[1]
    raw = bytearray(path.read_bytes())
    raw[chunk.offset + chunk.length + 30 if what == "the index of messages" else end + 40] ^= 1
    path.write_bytes(raw)
    status, out, _ = run(capsys, "info", "--check", path)
    assert status == 1
    assert "  damaged: " in out
    assert "checksums are right" not in out
    assert read(path) == expected
    assert run(capsys, "salvage", path, new)[0] == 0
    assert "checksums are right" in run(capsys, "info", "--check", new)[1]


@pytest.mark.slow(kept_by="test_a_recording_that_the_disk_does_not_give_is_named")
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize("command", [("info",), ("info", "--json"), ("cat",), ("diff", "run.mcap")])
def test_standard_output_that_is_full_is_one_line_that_says_so(command: tuple[str, ...], tmp_path: Path) -> None:
    make(tmp_path / "run.mcap", 100)
    with open("/dev/full", "w") as full:
        code = "import sys; from aiorts.cli import main; sys.exit(main())"
        line = [sys.executable, "-c", code, "log", *command, "run.mcap"]
        done = subprocess.run(line, cwd=tmp_path, stdout=full, stderr=subprocess.PIPE, text=True, timeout=60)
    assert done.returncode == 1
    assert done.stderr.startswith("aiorts: E-OUTPUT: standard output: ")
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.skipif(not Path("/proc/self/mem").exists(), reason="a file that cannot be read, as of a broken disk")
def test_a_table_that_the_disk_does_not_give_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = "/proc/self/mem"  # a regular file whose first byte gives EIO
    how = ("--from", "csv", "--port", "a", "--type", "TimedLong")
    status, out, err = run(capsys, "convert", source, tmp_path / "x.mcap", *how)
    assert (status, out, err) == (2, "", "aiorts: E-RECORDING: /proc/self/mem: cannot be read: Input/output error\n")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("ending", ["mcap", "txt", "jsonl"])
@pytest.mark.parametrize("command", ["info", "cat", "diff", "convert", "salvage"])
def test_a_recording_that_the_disk_does_not_give_is_named(
    command: str, ending: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path, target = tmp_path / f"run.{ending}", tmp_path / f"new.{ending}"
    make(tmp_path / "run.mcap", 300, chunk=2000)
    if ending != "mcap":
        assert run(capsys, "convert", tmp_path / "run.mcap", path)[0] == 0
    there = sorted(tmp_path.iterdir())
    given, pread, broken = path.stat(), os.pread, path.stat().st_size // 2

    def failing(file: int, length: int, offset: int) -> bytes:
        if os.path.samestat(os.fstat(file), given) and offset <= broken < offset + length:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return pread(file, length, offset)

    monkeypatch.setattr(os, "pread", failing)
    more = {"info": ["--check"], "diff": [path], "convert": [target], "salvage": [target]}.get(command, [])
    status, _, err = run(capsys, command, path, *more)
    assert status == 2
    assert err.startswith(f"aiorts: E-RECORDING: {path}: cannot be read at byte ")
    assert err.endswith(": Input/output error\n")
    assert err.count("\n") == 1
    assert sorted(tmp_path.iterdir()) == there


@pytest.mark.fault("D14")
def test_info_tells_gaps_and_drops(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "run.mcap"
    with RecordingWriter(path, RecordingOptions(min_free=0, queue_bytes=1000)) as writer:
        port = writer.add_port("n", TimedString)
        writer.write(port, TimedString(0, "a"), BEGIN)
        assert writer.flush(10.0)
        writer.write(port, TimedString(0, "b"), BEGIN + 1500 * MS)
        writer.write(port, TimedString(0, "c" * 2000), BEGIN + 1600 * MS)
    _, out, _ = run(capsys, "info", path)
    assert "  no sample for 1.500 s from +0.000 s\n" in out
    assert "  dropped of n: 1 sample that found no room\n" in out


@pytest.mark.fault("D01")
def test_info_says_that_a_recording_was_not_closed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "run.mcap"
    make(path, 100)
    with RecordingReader(path) as reader:
        last = reader.pieces[-1]
    with path.open("rb+") as file:
        file.truncate(last.offset + last.length + 16)
        status, out, _ = run(capsys, "info", path)
        assert (status, "not closed cleanly: 300 samples, lost: what was not yet written" in out) == (0, True)
        file.truncate(last.offset + last.length - 1)
    status, out, _ = run(capsys, "info", path)
    assert status == 0
    assert f"; {last.length - 1} bytes at its end are unusable" in out
    assert run(capsys, "info", path, "--json")[1].count('"closed": false') == 1


@pytest.mark.slow
@pytest.mark.fault("D06")
def test_damage_is_found_and_named_and_salvaged(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, new = tmp_path / "run.mcap", tmp_path / "new.mcap"
    expected = make(path, 300, chunk=2000)
    with RecordingReader(path) as reader:
        hit = reader.pieces[9]
    raw = bytearray(path.read_bytes())
    raw[hit.offset + 99] ^= 2
    path.write_bytes(raw)
    status, out, _ = run(capsys, "info", "--check", path)
    assert status == 1
    assert f"bytes from byte {hit.offset}: the checksum of a chunk is wrong" in out
    status, out, err = run(capsys, "cat", path)
    assert status == 2
    assert err.startswith("aiorts: E-DAMAGED: ")
    assert f"damaged at byte {hit.offset}" in err
    assert err.endswith("aiorts log salvage copies what is whole\n")
    given = len(out.splitlines())
    assert given == sum(one[1] < hit.start for one in expected) or 0 < given < 900
    status, out, err = run(capsys, "salvage", path, new)
    assert (status, err) == (0, "")
    assert f"from byte {hit.offset}" in out
    kept = read(new)
    assert f"{new}: {len(kept)} samples of 3 ports" in out
    assert 860 < len(kept) < 900
    assert [one for one in expected if one in kept] == kept
    status, _, err = run(capsys, "salvage", path, new)
    assert (status, "exists already" in err) == (2, True)
    assert run(capsys, "salvage", path, path, "--overwrite")[2].startswith("aiorts: E-RECORDING: ")
    document = json.loads(run(capsys, "salvage", path, new, "--overwrite", "--json")[1])
    assert sum(document["samples"].values()) == len(kept)
    assert sum(document["missing"].values()) == 900 - len(kept)


def test_cat_prints_lines_that_filters_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "run.mcap"
    make(path, 20)
    status, out, err = run(capsys, "cat", path)
    assert (status, err) == (0, "")
    lines = [json.loads(line) for line in out.splitlines()]
    assert len(lines) == 60
    assert lines[0] == {"port": "pid0.command", "type": "TimedDouble", "tm": BEGIN - 5, "data": 0.0}
    assert lines[1]["data"] == [0.0, -0.0, 1e300, 0.0, 5.0, 6.0]
    out = run(capsys, "cat", path, "--port", "log", "--start", "+0.005", "--end", "+0.0080")[1]
    assert [json.loads(line)["data"] for line in out.splitlines()] == ["line 5", "line 6", "line 7"]
    out = run(capsys, "cat", path, "--port", "log", "--end", "1700000000.001", "--log-time")[1]
    assert [json.loads(line)["log_time"] for line in out.splitlines()] == [BEGIN]
    for wrong in ("soon", "-1", "1e3", "+", "1.0000000001"):
        status, _, err = run(capsys, "cat", path, f"--start={wrong}")
        assert (status, err.startswith("aiorts: E-CONFIG: --start: expected +SECONDS")) == (2, True)
    status, _, err = run(capsys, "cat", path, "--port", "logg")
    assert (status, "no port 'logg'; there are" in err) == (2, True)


def test_what_is_printed_of_a_file_commands_no_terminal(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "run.mcap"
    with RecordingWriter(path, RecordingOptions(min_free=0)) as writer:
        port = writer.add_port("a\x1b[2Jb\n../../c", TimedString)
        writer.write(port, TimedString(0, "\x1b]0;title\x07"), BEGIN)
    for command in ("info", "cat"):
        out = run(capsys, command, path)[1]
        assert "\x1b" not in out
        assert "\x07" not in out
        assert ("a\\x1b[2Jb\\n../../c" if command == "info" else "a\\u001b[2Jb\\n../../c") in out
    assert len(run(capsys, "cat", path)[1].splitlines()) == 1


@pytest.mark.fault("D09")
def test_what_is_no_recording_is_one_line_and_status_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "text").write_text("hello")
    for command in (["info"], ["cat"], ["salvage"]):
        for path in (tmp_path / "text", tmp_path / "absent", tmp_path):
            more = [tmp_path / "new"] if command == ["salvage"] else []
            status, out, err = run(capsys, *command, path, *more)
            assert (status, out) == (2, "")
            assert err.startswith(f"aiorts: E-RECORDING: {path}: ")
            assert err.count("\n") == 1
    assert not (tmp_path / "new").exists()


@pytest.mark.slow(kept_by="cli/test_demo.py::test_a_reader_that_has_seen_enough_ends_it_quietly")
def test_a_reader_that_goes_away_is_no_error(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    make(path, 2000)
    process = subprocess.Popen(
        [sys.executable, "-m", "aiorts", "log", "cat", str(path)], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert process.stdout is not None
    assert process.stderr is not None
    assert process.stdout.readline().startswith(b'{"port"')
    process.stdout.close()
    assert process.stderr.read() == b""
    process.stderr.close()
    assert process.wait(30) == 141  # what a shell says of SIGPIPE


def test_compressed_chunks_without_the_library_name_the_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    mcap = pytest.importorskip("mcap.writer")
    path = tmp_path / "run.mcap"
    with path.open("wb") as file:
        writer = mcap.Writer(file, compression=mcap.CompressionType.ZSTD)
        writer.start()
        writer.add_message(writer.register_channel("a", "json", 0), 1, b"{}" * 100, 1)
        writer.finish()
    monkeypatch.setitem(sys.modules, "zstandard", None)
    status, _, err = run(capsys, "cat", path)
    assert status == 2
    assert err == (
        "aiorts: E-EXTRA: a recording with compressed chunks needs zstandard, which is not installed; "
        'pip install "aiorts[log]"\n'
    )


@pytest.mark.parametrize(
    "words",
    [["--start", "+100"], ["--start", "1800000000"], ["--end", "5"], ["--start", "+0.0085", "--end", "+0.0088"]],
)
@pytest.mark.parametrize("command", ["cat", "cut"])
def test_where_no_sample_is_it_is_said_where_they_are(
    command: str, words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    make(path := tmp_path / "run.mcap", 11)
    status, out, err = run(capsys, command, path, *([tmp_path / "new.mcap"] if command == "cut" else []), *words)
    assert (status, out) == (0, "" if command == "cat" else f"{tmp_path / 'new.mcap'}: 0 samples of 3 ports\n")
    assert err == (
        "  no sample is there; the recording is from 2023-11-14 22:13:20.000 UTC to 2023-11-14 22:13:20.010 UTC, "
        "which is +0.010\n"
    )
    assert run(capsys, "cat", path, "--start", "+0.010")[2] == ""


@pytest.mark.parametrize(
    ("command", "option"),
    [("cat", "--start"), ("diff", "--abs"), ("convert", "--port"), ("info", "--type-mod"), ("plot", "-o")],
)
def test_an_option_without_its_value_names_the_help_of_its_command(
    command: str, option: str, capsys: pytest.CaptureFixture[str]
) -> None:
    why = f"Option '{option}' requires an argument; see aiorts log {command} --help"
    assert run(capsys, command, option) == (2, "", f"aiorts: E-USAGE: aiorts log {command}: {why}\n")


def test_an_option_that_is_given_twice_is_refused_in_commands_of_a_group_too(
    capsys: pytest.CaptureFixture[str],
) -> None:
    status, out, err = run(capsys, "cat", "run.mcap", "--start", "+1", "--start", "+2")
    assert (status, out, "--start is given twice; give it once" in err) == (2, "", True)
