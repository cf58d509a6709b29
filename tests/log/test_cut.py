"""`aiorts log cut` and `merge`: a part of a recording, several as one, every sample as it was."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts.cli.app import run_command
from aiorts.types import TimedDouble, TimedLong
from aiorts_log import RecordingError, RecordingOptions, RecordingReader, RecordingWriter, open_recording
from aiorts_log.analysis.convert import cut, merge
from log_parts import BEGIN, MS, make, read

Messages = list[tuple[str, int, int, bytes]]


def run(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> tuple[int, str, str]:
    capsys.readouterr()
    status = run_command(["log", *map(str, arguments)])
    said = capsys.readouterr()
    return status, said.out, said.err


def messages(path: Path, **chosen: Any) -> Messages:
    """What is in a recording, to the byte."""
    with open_recording(path) as reader:
        return [(s.port.name, s.log_time, s.publish_time, s.data) for s in reader.samples(**chosen)]


def small(path: Path, ports: dict[str, type], times: list[tuple[str, int]]) -> Messages:
    """A recording of these ports with a sample at each of these times."""
    with RecordingWriter(path, RecordingOptions(min_free=0), metadata={"of": path.stem}) as writer:
        numbers = {name: writer.add_port(name, cls) for name, cls in ports.items()}
        for i, (name, time) in enumerate(times):
            assert writer.write(numbers[name], ports[name](time, i), time)
    return messages(path)


def test_cut_takes_some_of_the_time_and_of_the_ports(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, target = tmp_path / "run.mcap", tmp_path / "part.mcap"
    make(source, 100, chunk=2000)
    arguments = ["--start", "+0.02", "--end", "1700000000.05", "--port", "log", "--port", "pid0.command"]
    status, out, err = run(capsys, "cut", source, target, *arguments)
    assert (status, out, err) == (0, f"{target}: 60 samples of 2 ports\n", "")
    expected = messages(source, start=BEGIN + 20 * MS, end=BEGIN + 50 * MS, ports=["log", "pid0.command"])
    assert messages(target) == expected
    with RecordingReader(target) as reader:
        assert reader.check() == ()
        assert reader.metadata[0]["kernel"] == "test"
        assert reader.ports["pid0.command"].metadata == {"unit": "m/s"}
        assert [s.sequence for s in reader.samples(ports=["log"])] == list(range(30))
    status, _, err = run(capsys, "cut", source, target, "--start", "+1", "--end", "+1", "--overwrite")
    assert (status, "--end: expected a time behind --start" in err) == (2, True)
    assert messages(target) == expected


@pytest.mark.slow
@settings(max_examples=30)
@given(st.integers(-2, 25), st.integers(-2, 25))
def test_cut_takes_exactly_what_lies_between(tmp_path_factory: pytest.TempPathFactory, start: int, end: int) -> None:
    source = tmp_path_factory.getbasetemp() / "cut_run.mcap"
    if not source.exists():
        small(source, {"a": TimedDouble}, [("a", BEGIN + i) for i in range(20)])
    target = source.with_name("cut_part.mcap")
    cut(source, target, start=BEGIN + start, end=BEGIN + end, overwrite=True)
    assert [time for _, time, _, _ in messages(target)] == [BEGIN + i for i in range(20) if start <= i < end]


def test_cut_keeps_the_form_unless_the_name_tells_another(tmp_path: Path) -> None:
    make(tmp_path / "run.mcap", 3)
    cut(tmp_path / "run.mcap", tmp_path / "run.txt")
    assert cut(tmp_path / "run.txt", tmp_path / "part", ports=["log"]).format == "text"
    assert len(messages(tmp_path / "part")) == 3
    assert cut(tmp_path / "run.mcap", tmp_path / "part.bag").format == "mcap"


def test_merge_puts_samples_in_the_order_of_their_time(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    one, two, three = (tmp_path / name for name in ("one.mcap", "two.mcap", "three.txt"))
    first = small(one, {"a": TimedDouble}, [("a", BEGIN + i) for i in range(0, 20, 2)])
    second = small(two, {"b": TimedDouble}, [("b", BEGIN + i) for i in range(1, 30, 3)])
    small(tmp_path / "c.mcap", {"c": TimedLong}, [("c", BEGIN + 5)])
    cut(tmp_path / "c.mcap", three)
    status, out, err = run(capsys, "merge", one, two, three, tmp_path / "all.mcap")
    assert (status, out, err) == (0, f"{tmp_path / 'all.mcap'}: 21 samples of 3 ports\n", "")
    found = messages(tmp_path / "all.mcap")
    assert [one for one in found if one[0] == "a"] == first
    assert [one for one in found if one[0] == "b"] == second
    assert [time for _, time, _, _ in found] == sorted(time for _, time, _, _ in found)
    with RecordingReader(tmp_path / "all.mcap") as reader:
        assert reader.check() == ()
        assert [about["of"] for about in reader.metadata] == ["one", "two", "c"]


@pytest.mark.slow
def test_names_that_clash_are_refused_renamed_or_joined(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    one, two, other, target = (tmp_path / f"{name}.mcap" for name in ("one", "two", "other", "all"))
    small(one, {"a": TimedDouble}, [("a", 1), ("a", 3)])
    small(two, {"a": TimedDouble}, [("a", 2), ("a", 4)])
    small(other, {"a": TimedLong}, [("a", 2)])
    status, _, err = run(capsys, "merge", one, two, target)
    assert (status, "port 'a' is in another file, too; --prefix renames, --join makes them one" in err) == (2, True)
    for more in ((), ("--join",)):
        status, _, err = run(capsys, "merge", one, other, target, *more)
        assert (status, "port 'a' is TimedLong, and TimedDouble in another file; --prefix" in err) == (2, True)
    assert not target.exists()
    assert run(capsys, "merge", one, two, target, "--join")[0] == 0
    assert [(name, time) for name, time, _ in read(target)] == [("a", 1), ("a", 2), ("a", 3), ("a", 4)]
    assert run(capsys, "merge", one, other, target, "--prefix", "l.", "--prefix", "", "--overwrite")[0] == 0
    assert [(name, time) for name, time, _ in read(target)] == [("l.a", 1), ("a", 2), ("l.a", 3)]
    status, _, err = run(capsys, "merge", one, other, target, "--prefix", "l.", "--overwrite")
    assert (status, "--prefix: give one for each of the 2 files" in err) == (2, True)
    status, _, err = run(capsys, "merge", one, target)
    assert (status, "expected at least two recordings and the TARGET" in err) == (2, True)
    status, _, err = run(capsys, "merge", one, two, one, "--join", "--overwrite")
    assert (status, "is the recording that is read" in err) == (2, True)
    assert [time for _, time, _, _ in messages(one)] == [1, 3]


@pytest.mark.slow
def test_the_parts_of_a_rotated_recording_become_one_again(tmp_path: Path) -> None:
    expected = make(tmp_path / "run.mcap", 300, chunk=1000, max_bytes=20_000)
    parts = sorted((path for path in tmp_path.iterdir()), key=lambda path: (len(path.name), path.name))
    assert len(parts) > 2
    merge(parts, tmp_path / "whole.mcap", join=True)
    assert read(tmp_path / "whole.mcap") == expected


@pytest.mark.slow
@pytest.mark.fault("D06")
def test_salvage_of_text_takes_every_line_that_is_whole(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    make(tmp_path / "run.mcap", 50)
    source, target = tmp_path / "run.txt", tmp_path / "new.txt"
    cut(tmp_path / "run.mcap", source)
    lines = source.read_text().split("\n")
    hit = next(i for i, line in enumerate(lines) if "line 20" in line)
    lines[hit] = lines[hit].replace('"data"', "data")
    lines[hit + 1] = "garbage"
    source.write_text("\n".join(lines)[:-100])
    assert run(capsys, "info", source, "--check")[0] == 1
    status, out, err = run(capsys, "salvage", source, target)
    assert (status, err) == (0, "")
    assert f"from byte {len(chr(10).join(lines[:hit])) + 1}: line {hit + 1}: no JSON" in out
    assert f"line {hit + 2}: expected PORT, TYPE, TIME and DATA" in out
    assert "the recording was not closed" in out
    kept = messages(target)
    assert kept == [one for one in _lines_of(tmp_path / "run.mcap") if one in kept]
    assert len(kept) == 148
    with open_recording(target) as reader:
        assert (reader.clean, reader.fault, reader.check()) == (True, "", ())
        assert reader.metadata[0]["kernel"] == "test"
    assert json.loads(run(capsys, "salvage", source, target, "--overwrite", "--json")[1])["samples"]["log"] == 49
    with pytest.raises(RecordingError, match="aiorts log salvage"):
        cut(source, tmp_path / "x.txt")
    assert sorted(os.listdir(tmp_path)) == ["new.txt", "run.mcap", "run.txt"]


def _lines_of(path: Path) -> Messages:
    target = path.with_name("lines.txt")
    cut(path, target)
    found = messages(target)
    target.unlink()
    return found
