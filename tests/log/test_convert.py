"""`aiorts log convert`: nothing changes on the way between the forms, what cannot go over is refused, no half file."""

from __future__ import annotations

import csv
import io
import json
import math
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import aiorts.types.ros  # noqa: F401 - records like others
from aiorts.cli.app import run_command
from aiorts.types import TimedDouble, TimedDoubleSeq, TimedLong, TimedOctetSeq, TimedString, all_types, to_plain
from aiorts_log import DamagedError, RecordingError, RecordingOptions, RecordingReader, RecordingWriter, open_recording
from aiorts_log.analysis.convert import convert, cut
from aiorts_log.text.csv_format import TableOptions
from aiorts_log.text.flat import LONGEST
from campaign import CAMPAIGN, cases
from log_parts import BEGIN, make
from wire.test_codec import SCALARS, records_of

ROOMBA = Path(__file__).parents[2] / "examples" / "roomba" / "imu.txt"
RECORDS = [
    cls for cls in all_types().values() if cls.__module__.startswith("aiorts.types") and hasattr(cls, "__slots__")
]
BARE = {bool: SCALARS["bool"], int: SCALARS["i64"], float: SCALARS["f64"], str: SCALARS["str"], bytes: st.binary()}
ANY = st.one_of(
    st.sampled_from([cls for cls in RECORDS if hasattr(cls, "__dataclass_fields__")]).flatmap(records_of),
    *BARE.values(),
)
ROOMBA_OPTIONS = [
    *("--from", "csv", "--no-header", "--time", "0", "--time-unit", "s"),
    *("--port", "imu.gyro", "--type", "TimedDoubleSeq", "--port", "imu.wheels", "--type", "TimedShortSeq"),
    *("--port", "imu.heading", "--type", "TimedDouble"),
    *("--map", "4=imu.gyro.data[0]", "--map", "5=imu.gyro.data[1]", "--map", "6=imu.gyro.data[2]"),
    *("--map", "12=imu.wheels.data[0]", "--map", "13=imu.wheels.data[1]", "--map", "14=imu.heading.data"),
]


def run(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> tuple[int, str, str]:
    capsys.readouterr()
    status = run_command(["log", *map(str, arguments)])
    said = capsys.readouterr()
    return status, said.out, said.err


def everything(path: Path) -> list[tuple[str, int, type, str]]:
    """What is in a recording, compared by what each value prints as: -0.0 differs from 0.0, a NaN is a NaN."""
    with open_recording(path) as reader:
        return [(name, time, type(record), repr(to_plain(record))) for name, time, record in reader.records()]


def record(path: Path, samples: list[tuple[str, int, Any]]) -> None:
    """A recording of these samples, in which a port has one type."""
    with RecordingWriter(path, RecordingOptions(min_free=0)) as writer:
        ports: dict[str, int] = {}
        for name, time, value in samples:
            if name not in ports:
                ports[name] = writer.add_port(name, type(value), {"unit": "m"})
            assert writer.write(ports[name], value, time)
    assert not writer.statistics.refused


@pytest.mark.slow(kept_by="test_numbers_and_texts_at_the_edge_come_back")
@pytest.mark.fault("D16")
@pytest.mark.campaign
@settings(max_examples=cases(2_000))
@given(st.lists(st.tuples(ANY, st.sampled_from("ab\t\n\x1b#,\"'é\u2028."), SCALARS["stamp"]), min_size=1, max_size=6))
def test_every_type_comes_back_from_every_form(samples: list[tuple[Any, str, int]]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "run.mcap"
        named = [(f"{name}{type(value).__name__}", time, value) for value, name, time in samples]
        named.sort(key=lambda one: one[1])
        record(source, named)
        expected = everything(source)
        with RecordingReader(source) as reader:
            table = TableOptions(ports=tuple((name, port.type) for name, port in reader.ports.items()))
        for form in ("text", "jsonl", "csv"):
            there, back = Path(folder) / f"run.{form}", Path(folder) / f"{form}.mcap"
            made = convert(source, there, target_format=form)
            assert sum(made.samples.values()) == len(named)
            convert(there, back, source_format=form, table=table)
            assert everything(back) == expected
        if not any(value in ("", b"") for _, _, value in named):
            there, back = Path(folder) / "rows.csv", Path(folder) / "rows.mcap"
            convert(source, there, table=TableOptions(by_time=True))
            convert(there, back, table=table)
            assert sorted(everything(back), key=str) == sorted(expected, key=str)


TEXTS = st.text(alphabet="=+-@'\t\r\n\0\x1b1a,#\" ", max_size=4)


@pytest.mark.slow(kept_by="test_a_number_stays_one_and_a_text_that_looks_like_a_formula_is_shown")
@pytest.mark.campaign
@settings(max_examples=cases(2_000))
@given(st.lists(st.tuples(TEXTS, st.floats(), st.binary(max_size=3)), min_size=1, max_size=5), TEXTS)
def test_no_cell_of_a_table_is_a_formula_and_all_of_them_come_back(
    values: list[tuple[str, float, bytes]], name: str
) -> None:
    """What begins with = + - @ or a control character is run by programs that show tables; numbers are none of that."""
    with tempfile.TemporaryDirectory() as folder:
        source, there, back = Path(folder) / "run.mcap", Path(folder) / "run.csv", Path(folder) / "back.mcap"
        samples: list[tuple[str, int, Any]] = []
        for time, (text, number, content) in enumerate(values):
            samples += [
                (f"{name}text", time, TimedString(time, text)),
                (f"{name}number", time, TimedDouble(time, number)),
                (f"{name}bytes", time, TimedOctetSeq(time, content)),
            ]
        record(source, samples)
        with RecordingReader(source) as reader:
            ports = tuple((port, one.type) for port, one in reader.ports.items())
        for by_time in (False, True):
            if by_time and not all(text and content for text, _, content in values):
                continue  # which is refused: nothing would be in the row
            table = TableOptions(ports=ports, by_time=by_time)
            convert(source, there, table=table, overwrite=True)
            with there.open(encoding="utf-8", newline="") as file:
                header, *rows = csv.reader(file, strict=True)
            for column, cells in zip(header, zip(*rows, strict=True), strict=True):
                assert column[0] not in "=+-@\t\r\n\0\x1b"
                for cell in cells:
                    assert cell[:1] not in tuple("=+-@\t\r\n\0\x1b") or str(float(cell)) == cell
            convert(there, back, table=table, overwrite=True)
            assert sorted(everything(back), key=str) == sorted(everything(source), key=str)


def test_a_number_stays_one_and_a_text_that_looks_like_a_formula_is_shown(tmp_path: Path) -> None:
    record(tmp_path / "run.mcap", [("n", 1, TimedDouble(1, -1.5)), ("t", 1, TimedString(1, "=cmd()"))])
    convert(tmp_path / "run.mcap", tmp_path / "run.csv", table=TableOptions(by_time=True))
    _, row = (tmp_path / "run.csv").read_text().splitlines()
    assert row == "1,1,-1.5,1,'=cmd()"


@pytest.mark.fault("D16")
def test_numbers_and_texts_at_the_edge_come_back(tmp_path: Path) -> None:
    large, least = 1.7976931348623157e308, 5e-324
    odd = [0.0, -0.0, least, -large, 0.1, 1e22, math.inf, -math.inf, math.nan, 2**53 + 1.0, 1.0, 2.0, 3.0, 4.0]
    texts = [
        "",
        " ",
        "nan",
        "NaN",
        '"',
        "a,b",
        "a\r",
        "\n\n",
        "\r\n",
        "# no comment",
        "\0",
        "\x1b[2J",
        "é\u2028",
        " a ",
    ]
    samples: list[tuple[str, int, Any]] = []
    for i, (number, text) in enumerate(zip(odd, texts, strict=True)):
        samples += [
            ("x", i, TimedDouble(i, number)),
            ("t", i, TimedString(i, text)),
            ("s", i, text),
            ("n", i, 2**63 - 1),
            ("f", i, number),
        ]
    record(tmp_path / "run.mcap", samples)
    table = TableOptions(ports=(("x", TimedDouble), ("t", TimedString), ("s", str), ("n", int), ("f", float)))
    for form in ("text", "jsonl", "csv"):
        convert(tmp_path / "run.mcap", tmp_path / f"run.{form}", target_format=form)
        convert(tmp_path / f"run.{form}", tmp_path / f"{form}.mcap", source_format=form, table=table)
        assert everything(tmp_path / f"{form}.mcap") == everything(tmp_path / "run.mcap")
    made = convert(tmp_path / "run.mcap", tmp_path / "tables", split=True)
    assert sorted(os.listdir(tmp_path / "tables")) == ["f.csv", "n.csv", "s.csv", "t.csv", "x.csv"]
    assert made.samples == dict.fromkeys("xtsnf", 14)
    for name, cls in table.ports:
        one = TableOptions(ports=((name, cls),))
        convert(tmp_path / "tables" / f"{name}.csv", tmp_path / f"{name}.mcap", table=one)
        assert everything(tmp_path / f"{name}.mcap") == [e for e in everything(tmp_path / "run.mcap") if e[0] == name]


def test_what_a_recording_says_of_itself_goes_over_to_text_and_back(tmp_path: Path) -> None:
    source, text, back = (tmp_path / name for name in ("run.mcap", "run.txt", "back.mcap"))
    options = RecordingOptions(min_free=0)
    files = {"system.toml": b"a = 1\n", "raw": b"\xff\x00"}
    with RecordingWriter(source, options, metadata={"kernel": "k"}, attachments=files) as writer:
        writer.write(writer.add_port("a", TimedDouble, {"unit": "m/s"}), TimedDouble(3, 1.0), 5)
    assert convert(source, text).left_out == ()
    assert convert(text, back).left_out == ()
    with RecordingReader(source) as one, open_recording(text) as two, RecordingReader(back) as three:
        for reader in (two, three):
            assert (reader.metadata, reader.endings) == (one.metadata, one.endings)
            assert [(f.name, f.data) for f in reader.attachments() if f.name in files] == list(files.items())
            assert reader.ports["a"].metadata == {"unit": "m/s"}
            assert [(s.log_time, s.publish_time) for s in reader.samples()] == [(5, 3)]
    left_out = convert(source, tmp_path / "run.jsonl").left_out
    assert left_out == ("1 file within the recording",)  # of the user: the others, and units, aiorts adds itself
    assert convert(source, tmp_path / "run.csv").left_out == left_out
    assert convert(source, tmp_path / "tables", split=True).left_out == left_out


@pytest.mark.slow(kept_by="test_numbers_and_texts_at_the_edge_come_back")
def test_the_roomba_recording_gives_the_same_numbers_after_every_form(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mcap = tmp_path / "imu.mcap"
    status, out, err = run(capsys, "convert", ROOMBA, mcap, *ROOMBA_OPTIONS)
    assert (status, out) == (0, f"{mcap}: 3648 samples of 3 ports\n")
    assert err == "  columns not used: 1, 2, 3, 7, 8, 9, 10, 11\n"
    rows = [[float(cell) for cell in line.split(",")] for line in ROOMBA.read_text().splitlines()]
    for form in ("text", "jsonl", "csv"):
        assert run(capsys, "convert", mcap, tmp_path / f"imu.{form}", "--to", form)[0] == 0
    ports = [*ROOMBA_OPTIONS[7:11], *ROOMBA_OPTIONS[11:19]][:12]
    assert run(capsys, "convert", tmp_path / "imu.csv", tmp_path / "again.mcap", *ports)[0] == 0
    for path in (mcap, tmp_path / "imu.text", tmp_path / "imu.jsonl", tmp_path / "again.mcap"):
        with open_recording(path) as reader:
            heading = [(time, value.data) for _, time, value in reader.records(ports=["imu.heading"])]
            gyro = [list(value.data) for _, _, value in reader.records(ports=["imu.gyro"])]
            wheels = [list(value.data) for _, _, value in reader.records(ports=["imu.wheels"])]
        assert heading == [(round(row[0] * 1e6) * 1000, row[14]) for row in rows]
        assert gyro == [row[4:7] for row in rows]
        assert wheels == [row[12:14] for row in rows]
        assert (len(rows), heading[-1][1]) == (1216, 5.722592)


def test_samples_of_one_time_in_one_row(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    both = ("b", 2, TimedLong(7, 5)), ("a", 2, "x,y")
    record(tmp_path / "run.mcap", [("a", 1, "x"), *both, ("a", 2, "again"), ("b", 3, TimedLong(8, 6))])
    assert run(capsys, "convert", tmp_path / "run.mcap", tmp_path / "run.csv", "--by-time")[0] == 0
    lines = (tmp_path / "run.csv").read_text().splitlines()
    assert lines == ["log_time,a.value,b.tm,b.data", "1,x,,", '2,"x,y",7,5', "2,again,,", "3,,8,6"]
    record(tmp_path / "empty.mcap", [("a", 1, ""), ("b", 1, TimedLong(8, 6))])
    status, _, err = run(capsys, "convert", tmp_path / "empty.mcap", tmp_path / "x.csv", "--by-time")
    assert (status, "port 'a': an empty text would be no sample in such a row; leave out --by-time" in err) == (2, True)


def test_a_text_of_blanks_is_a_sample(tmp_path: Path) -> None:
    record(tmp_path / "run.mcap", [("a", 1, " \x0c"), ("b", 1, TimedLong(8, 6))])
    convert(tmp_path / "run.mcap", tmp_path / "run.csv", table=TableOptions(by_time=True))
    table = TableOptions(ports=(("a", str), ("b", TimedLong)))
    convert(tmp_path / "run.csv", tmp_path / "back.mcap", table=table)
    assert everything(tmp_path / "back.mcap") == everything(tmp_path / "run.mcap")


def test_mcap_keeps_its_bytes_and_json_is_for_those_who_ask(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    make(tmp_path / "run.mcap", 50)
    assert run(capsys, "convert", tmp_path / "run.mcap", tmp_path / "same.mcap")[0] == 0
    assert run(capsys, "convert", tmp_path / "run.mcap", tmp_path / "json.mcap", "--json")[0] == 0
    with RecordingReader(tmp_path / "run.mcap") as old, RecordingReader(tmp_path / "same.mcap") as new:
        assert [s[1:] for s in new.samples()] == [s[1:] for s in old.samples()]
        assert new.check() == ()
    with RecordingReader(tmp_path / "json.mcap") as new:
        assert {port.encoding for port in new.ports.values()} == {"json"}
        assert json.loads(next(iter(new.samples(ports=["log"]))).data) == {"tm": BEGIN, "data": "line 0"}
    assert everything(tmp_path / "json.mcap") == everything(tmp_path / "run.mcap")


def test_some_ports_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    make(tmp_path / "run.mcap", 3)
    status, out, _ = run(capsys, "convert", tmp_path / "run.mcap", tmp_path / "log.csv", "--port", "log")
    assert (status, out) == (0, f"{tmp_path / 'log.csv'}: 3 samples of 1 port\n")
    assert (tmp_path / "log.csv").read_text().splitlines()[:2] == ["log_time,tm,data", f"{BEGIN},{BEGIN},line 0"]
    status, _, err = run(capsys, "convert", tmp_path / "run.mcap", tmp_path / "x.csv", "--port", "logg")
    assert (status, "no port 'logg'; there are pid0.command" in err) == (2, True)
    assert not (tmp_path / "x.csv").exists()
    made = convert(
        tmp_path / "run.mcap", tmp_path / "s.tsv", ports=["log"], table=TableOptions(unit="s", delimiter="\t")
    )
    assert made.samples == {"log": 3}
    assert (tmp_path / "s.tsv").read_text().splitlines()[2].split("\t")[0] == "1700000000.001000000"


@pytest.mark.fault("D12")
def test_a_type_that_is_not_known_here_goes_from_mcap_to_mcap_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.txt").write_text(
        'a\tno_such.Type\t1.000000000\t{"x": 1}\nb\tTimedLong\t2.000000000\t{"tm": 1, "data": 2}\n'
    )
    for target in ("x.mcap", "x.csv", "x.jsonl"):
        status, _, err = run(capsys, "convert", tmp_path / "a.txt", tmp_path / target)
        assert (status, err.startswith("aiorts: E-RECORDING: ")) == (2, True)
        assert "port 'a': no type 'no_such.Type' is known here" in err
        assert err.endswith("choose others with --port\n")
        assert run(capsys, "convert", tmp_path / "a.txt", tmp_path / target, "--port", "b")[0] == 0
        (tmp_path / target).unlink()
    assert sorted(os.listdir(tmp_path)) == ["a.txt"]


def test_targets_are_never_lost(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = tmp_path / "run.mcap"
    make(source, 3)
    (tmp_path / "there.csv").write_text("mine")
    (tmp_path / "link.mcap").symlink_to(source)
    (tmp_path / "folder.csv").mkdir()
    for target, why in (
        (source, "is the recording that is read"),
        (tmp_path / "link.mcap", "is the recording that is read"),
        (tmp_path / "there.csv", "exists already; --overwrite replaces it"),
        (tmp_path / "folder.csv", "exists already"),
        (tmp_path / "no" / "x.csv", "there is no folder"),
    ):
        status, _, err = run(capsys, "convert", source, target)
        assert (status, why in err, err.count("\n")) == (2, True, 1)
    for target, why in ((source, "is the recording that is read"), (tmp_path / "folder.csv", "is no regular file")):
        status, _, err = run(capsys, "convert", source, target, "--overwrite")
        assert (status, why in err) == (2, True)
    assert (tmp_path / "there.csv").read_text() == "mine"
    assert run(capsys, "convert", source, tmp_path / "there.csv", "--overwrite")[0] == 0
    assert (tmp_path / "there.csv").read_text().startswith("log_time,port,")
    assert everything(source) != []


@pytest.mark.slow
@pytest.mark.fault("D06")
def test_a_damaged_recording_is_refused_before_a_target_is_there(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = tmp_path / "run.mcap"
    make(source, 300, chunk=2000)
    with RecordingReader(source) as reader:
        hit = reader.pieces[9].offset + 99
    content = bytearray(source.read_bytes())
    content[hit] ^= 2
    source.write_bytes(content)
    (tmp_path / "old.csv").write_text("old")
    for target in ("x.csv", "x.txt", "x.mcap", "old.csv"):
        status, _, err = run(capsys, "convert", source, tmp_path / target, "--overwrite")
        assert (status, "damaged" in err, "aiorts log salvage copies what is whole" in err) == (2, True, True)
    assert (tmp_path / "old.csv").read_text() == "old"
    assert sorted(os.listdir(tmp_path)) == ["old.csv", "run.mcap"]


@pytest.mark.slow
def test_a_recording_that_was_not_closed_goes_over_to_its_end_and_that_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = tmp_path / "run.mcap"
    make(source, 300, chunk=2000)
    with RecordingReader(source) as reader:
        last = reader.pieces[-1]
    with source.open("rb+") as file:
        file.truncate(last.offset + last.length - 1)
    status, out, err = run(capsys, "convert", source, tmp_path / "x.csv")
    kept = len(everything(source))
    assert (status, out) == (1, f"{tmp_path / 'x.csv'}: {kept} samples of 3 ports\n")
    assert "was not closed" in err
    assert f"; {last.length - 1} bytes at its end are unusable" in err
    assert 0 < kept < 900


@pytest.mark.slow(kept_by="log/test_text_form.py::test_a_full_disk_ends_it_and_what_is_there_is_whole")
@pytest.mark.fault("D03")
@pytest.mark.parametrize(
    ("command", "target", "before"),
    [
        ("convert", "x.csv", b""),
        ("convert", "x.mcap", b""),
        ("salvage", "x.mcap", b""),
        ("salvage", "x.mcap", b"what was there"),
        ("salvage", "x.txt", b""),
    ],
)
def test_a_full_disk_leaves_nothing_and_is_one_line(tmp_path: Path, command: str, target: str, before: bytes) -> None:
    make(tmp_path / "run.mcap", 3000)
    source = "run.mcap"
    if (command, target) == ("salvage", "x.txt"):
        source = "run.txt"
        convert(tmp_path / "run.mcap", tmp_path / source)
    code = (
        "import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (50000, 50000));"
        "import signal; signal.signal(signal.SIGXFSZ, signal.SIG_IGN);"
        "from aiorts.cli.app import run_command; sys.exit(run_command(['log', *sys.argv[1:]]))"
    )
    if before:
        (tmp_path / target).write_bytes(before)
    there = sorted(os.listdir(tmp_path))
    done = subprocess.run(
        [sys.executable, "-B", "-c", code, command, source, target, *(["--overwrite"] if before else [])],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        timeout=100,
    )
    assert done.stderr == f"aiorts: E-RECORDING: {target}: cannot be written: File too large\n"
    assert done.returncode == 1
    assert sorted(os.listdir(tmp_path)) == there
    if before:
        assert (tmp_path / target).read_bytes() == before


@pytest.mark.slow(kept_by="test_targets_are_never_lost")
def test_ctrl_c_leaves_nothing_and_is_status_130(tmp_path: Path) -> None:
    lines = "".join(f"{i},{i}\n" for i in range(300_000))
    (tmp_path / "x.csv").write_text(f"log_time,data\n{lines}")
    arguments = ["log", "convert", "x.csv", "x.mcap", "--port", "a", "--type", "TimedLong"]
    process = subprocess.Popen(
        [sys.executable, "-m", "aiorts", *arguments], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    try:
        while len(os.listdir(tmp_path)) == 1:
            assert process.poll() is None
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=30)
    finally:
        process.kill()
    assert (process.returncode, out, err.strip()) == (130, b"", b"")
    assert os.listdir(tmp_path) == ["x.csv"]


class _Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.slow(kept_by="cli/test_terminal.py::test_the_line_leaves_room_for_the_cursor_and_tells_as_much_as_fits")
def test_long_work_shows_a_bar_on_a_terminal_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make(tmp_path / "run.mcap", 1000)
    for stream, shown in ((_Terminal(), True), (io.StringIO(), False)):
        monkeypatch.setattr(sys, "stderr", stream)
        convert(tmp_path / "run.mcap", tmp_path / f"{shown}.csv")
        assert ("converting" in stream.getvalue(), "100%" in stream.getvalue()) == (shown, shown)


@pytest.mark.parametrize(
    ("words", "label"),
    [
        (["diff", "run.mcap", "same.mcap"], "comparing"),
        (["salvage", "run.mcap", "new.mcap"], "salvaging"),
        (["salvage", "torn.mcap", "new.mcap"], "salvaging"),
        (["salvage", "run.jsonl", "new.jsonl"], "salvaging"),
    ],
)
def test_a_comparison_and_a_salvage_show_a_bar_too(
    words: list[str], label: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    make(tmp_path / "run.mcap", 100)
    shutil.copy("run.mcap", "same.mcap")
    Path("torn.mcap").write_bytes(Path("run.mcap").read_bytes()[:-500])
    convert(Path("run.mcap"), Path("run.jsonl"))
    monkeypatch.setattr(sys, "stderr", stream := _Terminal())
    assert run_command(["log", *words]) == 0
    assert (label in stream.getvalue(), "100%" in stream.getvalue()) == (True, True)


def test_lines_of_filters_are_a_recording(tmp_path: Path) -> None:
    source = tmp_path / "run.jsonl"
    source.write_text(
        '{"port": "output0", "type": "TimedLong", "tm": 5, "data": 6200}\n'
        '{"data": [1, "NaN"], "tm": 6, "type": "TimedDoubleSeq", "port": "b"}\n'
        '{"port": "c", "type": "int", "data": 7, "log_time": 8}\n'
        '{"port": "a\\"", "type": "TimedString", "tm": 3, "data": ", \\"log_time\\": 7", "log_time": 9}\n'
    )
    assert everything(source) == [
        ("output0", 5, TimedLong, "{'tm': 5, 'data': 6200}"),
        ("b", 6, TimedDoubleSeq, "{'tm': 6, 'data': [1.0, 'NaN']}"),
        ("c", 8, int, "7"),
        ('a"', 9, TimedString, "{'tm': 3, 'data': ', \"log_time\": 7'}"),
    ]
    with open_recording(source) as reader:
        assert [sample.publish_time for sample in reader.samples()] == [5, 6, 8, 3]
        assert reader.check() == ()
    for line, why in (
        ('{"port": "c", "type": "int", "data": 7}', "has no time: aiorts log cat --log-time writes one"),
        ('{"type": "int", "tm": 1, "data": 7}', "expected"),
        ('{"port": "c", "type": "int", "tm": -1, "data": 7}', "has no time"),
        ('{"port": "c", "type": "int", "tm": 1, "datum": 7}', "expected"),
        ("7", "expected an object"),
        ('{"port": "c", "type": "TimedLong", "tm": 1, "data": "x"}', "expected an integer"),
        ('{"port": "c", "type": "TimedLong", "tm": 1, "data": 7, "log_time": 8', "no JSON"),
    ):
        with source.open("a") as file:
            file.write(f"{line}\n")
        with pytest.raises(DamagedError, match=rf"line 5: .*{why}|'c', line 5: .*{why}"):
            convert(source, tmp_path / "x.mcap")
        source.write_text("".join(source.read_text().splitlines(keepends=True)[:4]))


@pytest.mark.slow(kept_by="system/test_pipes.py::test_a_line_without_end_is_refused_and_takes_no_memory")
@pytest.mark.fault("D07")
@pytest.mark.fault("D08")
def test_a_line_without_end_is_refused_in_little_memory(tmp_path: Path) -> None:
    with (tmp_path / "x.txt").open("wb") as file:
        file.write(b"# aiorts text recording 1.0\na\tint\t")
        file.truncate(2**34)
    with (tmp_path / "x.csv").open("wb") as file:
        file.write(b"log_time,data\n1,")
        file.truncate(2**34)
    code = (
        "import resource; from pathlib import Path; from aiorts.types import TimedLong;"
        "from aiorts_log import open_recording, RecordingError; from aiorts_log.analysis.convert import convert;"
        "from aiorts_log.text.csv_format import TableOptions; from contextlib import suppress;"
        "peak = lambda: int(next(l for l in open('/proc/self/status') if l.startswith('VmHWM')).split()[1]);"
        "before = peak()\n"
        "for work in (lambda: open_recording('x.txt'),"
        " lambda: convert(Path('x.csv'), Path('y.mcap'), table=TableOptions(ports=(('a', TimedLong),)))):\n"
        " try: work()\n"
        " except RecordingError as error: print(error)\n"
        "print((peak() - before) // 1024)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True, timeout=100
    )
    first, second, memory = done.stdout.splitlines()
    assert first.endswith("a line has more than the 33554432 bytes that are allowed")
    assert second.endswith("a line has more than the 33554432 characters that are allowed")
    assert int(memory) <= 128  # a line that is allowed, and a copy of it


@pytest.mark.slow(kept_by="test_a_text_of_blanks_is_a_sample")
def test_a_sample_that_no_line_can_hold_is_refused(tmp_path: Path) -> None:
    record(tmp_path / "run.mcap", [("a", 0, TimedString(0, "x" * 1000)), ("b", 1, b"\0" * (LONGEST * 3 // 4))])
    for form in ("text", "jsonl", "csv"):
        with pytest.raises(RecordingError, match="a line has at most 33554432"):
            convert(tmp_path / "run.mcap", tmp_path / "x", target_format=form)
    assert os.listdir(tmp_path) == ["run.mcap"]


@pytest.mark.slow(kept_by="test_lines_of_filters_are_a_recording")
def test_a_hundred_thousand_samples_take_no_memory(tmp_path: Path) -> None:
    count = 1_000_000 if CAMPAIGN else 100_000
    rows = (f"{i * 1000},{i},{i / 7}\n" for i in range(count))
    with (tmp_path / "x.csv").open("w") as file:
        file.write("log_time,tm,data\n")
        file.writelines(rows)
    code = (
        "import sys, resource; from pathlib import Path; from aiorts.types import TimedDouble;"
        "from aiorts_log.analysis.convert import convert; from aiorts_log.text.csv_format import TableOptions;"
        "peak = lambda: int(next(l for l in open('/proc/self/status') if l.startswith('VmHWM')).split()[1]);"
        "before = peak(); convert(Path('x.csv'), Path('x.mcap'), table=TableOptions(ports=(('p', TimedDouble),)));"
        "convert(Path('x.mcap'), Path('y.csv'));"
        "print((peak() - before) // 1024)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True, timeout=100
    )
    assert int(done.stdout) <= 64
    assert (tmp_path / "y.csv").read_bytes() == (tmp_path / "x.csv").read_bytes()


def test_forms_are_told_by_names_or_by_options(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    make(tmp_path / "run.mcap", 2)
    status, _, err = run(capsys, "convert", tmp_path / "run.mcap", tmp_path / "run.xyz")
    assert (status, "unknown ending; --to mcap | csv | text | jsonl" in err) == (2, True)
    status, _, err = run(capsys, "convert", tmp_path / "run.mcap", tmp_path / "x.csv", "--from", "text")
    assert (status, "is mcap, not text; leave out --from" in err) == (2, True)
    status, _, err = run(capsys, "convert", tmp_path / "run.mcap", tmp_path / "x", "--split", "--to", "text")
    assert (status, "--split: writes tables" in err) == (2, True)
    assert run(capsys, "convert", tmp_path / "run.mcap", tmp_path / "bag", "--to", "mcap")[0] == 0
    assert everything(tmp_path / "bag") == everything(tmp_path / "run.mcap")


def test_several_types_of_one_port_stay_apart(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text(
        'a\tTimedLong\t1.000000000\t{"tm": 1, "data": 2}\na\tTimedDouble\t2.000000000\t{"tm": 1, "data": 2.5}\n'
    )
    convert(tmp_path / "a.txt", tmp_path / "a.mcap")
    convert(tmp_path / "a.mcap", tmp_path / "a.jsonl")
    cut(tmp_path / "a.jsonl", tmp_path / "b.jsonl")
    convert(tmp_path / "b.jsonl", tmp_path / "b.mcap")
    assert [one[:3] for one in everything(tmp_path / "b.mcap")] == [
        ("a", 10**9, TimedLong),
        ("a", 2 * 10**9, TimedDouble),
    ]
    convert(tmp_path / "a.mcap", tmp_path / "split", split=True)
    assert sorted(os.listdir(tmp_path / "split")) == ["a.csv", "a_2.csv"]


@pytest.mark.parametrize("ending", ["csv", "txt", "jsonl", "mcap"])
def test_an_empty_recording_goes_into_each_form_and_comes_back(
    ending: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    empty, there, back = tmp_path / "empty.mcap", tmp_path / f"there.{ending}", tmp_path / "back.mcap"
    with RecordingWriter(empty, RecordingOptions(min_free=0), metadata={"kernel": "test"}) as writer:
        writer.add_port("quiet", TimedDouble)
    for source, target in ((empty, there), (there, back)):
        status, out, _ = run(capsys, "convert", source, target)
        assert (status, out.splitlines()[0]) == (0, f"{target}: 0 samples of 0 ports")
    assert run(capsys, "diff", empty, back)[:2] == (0, "equal: 0 samples of 0 ports\n")
    assert everything(back) == []


def test_a_table_of_times_alone_is_no_empty_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.csv").write_text("log_time\n1\n")
    status, _, said = run(capsys, "convert", tmp_path / "a.csv", tmp_path / "a.mcap")
    assert (status, "a table does not have the types of its columns" in said) == (2, True)
    (tmp_path / "b").write_bytes(b"")
    assert "no recording: it is empty" in run(capsys, "info", tmp_path / "b")[2]
