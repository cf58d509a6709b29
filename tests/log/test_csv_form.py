"""Tables: what is read of those of others, exactly and strictly, with the line of whatever is wrong."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aiorts.cli.app import run_command
from aiorts.errors import AiortsError, ConfigurationError, RecordError
from aiorts.types import (
    Time,
    TimedDouble,
    TimedDoubleSeq,
    TimedLong,
    TimedOctetSeq,
    TimedPose2D,
    TimedString,
    describe,
    record,
)
from aiorts_log import DamagedError, RecordingReader
from aiorts_log.analysis.convert import Converted, convert
from aiorts_log.text.columns import cells_of, columns_of, taker_of
from aiorts_log.text.csv_format import TableOptions, quoted, time_cell, time_of


@record
class Stamped:
    """A record whose time is one of two numbers."""

    tm: Time
    on: bool


def table(tmp_path: Path, text: str | bytes, **options: Any) -> tuple[Converted, list[tuple[str, int, Any]]]:
    """What becomes of a table."""
    source, target = tmp_path / "in.csv", tmp_path / "out.mcap"
    source.write_bytes(text.encode() if isinstance(text, str) else text)
    made = convert(source, target, table=TableOptions(**options), overwrite=True)
    with RecordingReader(target) as reader:
        return made, list(reader.records())


@pytest.mark.parametrize(
    ("text", "unit", "offset", "ns"),
    [
        ("0.019201", "s", "0", 19_201_000),
        ("1700000000.123456789", "s", "0", 1_700_000_000_123_456_789),
        ("1.7e9", "s", "0", 1_700_000_000_000_000_000),
        (" 12.5 ", "ms", "0", 12_500_000),
        ("0.0000000015", "s", "0", 2),
        ("0.0000000025", "s", "0", 2),
        ("7", "ns", "1700000000", 1_700_000_000_000_000_007),
        ("-1", "s", "1.5", 500_000_000),
        ("9223372036854775807", "ns", "0", 2**63 - 1),
    ],
)
def test_times_are_exact_to_the_nanosecond(text: str, unit: Any, offset: str, ns: int) -> None:
    assert time_of(text, unit, offset) == ns


@pytest.mark.slow(kept_by="test_times_are_exact_to_the_nanosecond")
@given(st.integers(0, 2**63 - 1), st.sampled_from(["s", "ms", "us", "ns"]))
def test_a_time_comes_back_in_every_unit(ns: int, unit: Any) -> None:
    assert time_of(time_cell(ns, unit), unit) == ns


@pytest.mark.parametrize(
    "text", ["", "soon", "1,5", "0x10", "1_000", "nan", "inf", "-0.1", "9223372036.854775808", "1e99", "٣"]
)
def test_what_is_no_time_is_refused(text: str) -> None:
    with pytest.raises(RecordError, match="expected a time"):
        time_of(text, "s")


def test_columns_are_the_numbers_and_texts_of_a_type() -> None:
    assert [column.path for column in columns_of(TimedPose2D)] == [
        "tm",
        "data.position.x",
        "data.position.y",
        "data.heading",
    ]
    assert columns_of(int)[0] == ("value", "int", "int")
    assert [column.path for column in columns_of(Stamped)] == ["tm.sec", "tm.nsec", "on"]
    assert cells_of(Stamped)(Stamped(Time(1, 2), True)) == ["1", "2", "true"]
    assert taker_of(Stamped, {"on": 0})(["false"], 3_000_000_004) == Stamped(Time(3, 4), False)
    assert describe(Stamped).has_tm


def test_columns_of_others_are_mapped_and_the_rest_is_told(tmp_path: Path) -> None:
    made, found = table(
        tmp_path,
        '# made by somebody\r\nt [ms]; x ;y;note;h\r\n0;1;2.50;a;0\r\n10.5;-1e-3;nan;"b;\r\n#c";.5\r\n',
        time="t [ms]",
        unit="ms",
        offset="1",
        delimiter=";",
        ports=(("base0.pose", TimedPose2D),),
        columns={"x": "data.position.x", "y": "base0.pose.data.position.y", "h": "data.heading"},
    )
    assert made.samples == {"base0.pose": 2}
    assert made.unused == ("note",)
    (_, first, one), (_, second, other) = found
    assert (first, second, one.tm, other.tm) == (10**9, 1_010_500_000, 10**9, 1_010_500_000)
    assert (one.data.position.x, one.data.position.y, one.data.heading) == (1.0, 2.5, 0.0)
    assert (other.data.position.x, other.data.heading) == (-0.001, 0.5)
    assert other.data.position.y != other.data.position.y


def test_names_of_columns_are_those_of_the_fields_when_nothing_is_mapped(tmp_path: Path) -> None:
    _, found = table(tmp_path, "\ufefflog_time,tm,data\n5,3,1.5\n", ports=(("a", TimedDouble),))
    assert found == [("a", 5, TimedDouble(3, 1.5))]
    _, found = table(tmp_path, "log_time,data\n5,1.5\n", ports=(("a", TimedDouble),))
    assert found == [("a", 5, TimedDouble(5, 1.5))]
    _, found = table(
        tmp_path,
        "log_time,a.data,b.data\n1,1.5,\n2,,x\n2,2.5,y\n3,,\n",
        ports=(("a", TimedDouble), ("b", TimedString)),
    )
    assert found == [
        ("a", 1, TimedDouble(1, 1.5)),
        ("b", 2, TimedString(2, "x")),
        ("a", 2, TimedDouble(2, 2.5)),
        ("b", 2, TimedString(2, "y")),
    ]


def test_without_a_header_columns_have_numbers(tmp_path: Path) -> None:
    _, found = table(
        tmp_path,
        "0.5 1 2 3\n0.6 4 5 6\n",
        time="0",
        unit="s",
        header=False,
        delimiter=" ",
        ports=(("a", TimedDoubleSeq), ("b", TimedOctetSeq)),
        columns={"1": "a.data[0]", "2": "a.data[1]", "3": "b.data[0]"},
        values={"b.tm": "7"},
    )
    assert found[0] == ("a", 500_000_000, TimedDoubleSeq(500_000_000, [1.0, 2.0]))
    assert found[3] == ("b", 600_000_000, TimedOctetSeq(7, [6]))


@pytest.mark.parametrize(
    ("row", "why"),
    [
        ("x,1", "expected a time in ns, got 'x'"),
        ("2,", "data: expected a number, got nothing"),
        ("2,one", "data: expected a number, got 'one'"),
        ("2,1_0", "data: expected a number, got '1_0'"),
        ("2,0x1p3", "data: expected a number"),
        ("2,1e999", "data: '1e999' is too large"),
        ("2,--inf", "data: expected a number"),
        ("2", "expected 2 cells, got 1"),
        ("2,1,3", "expected 2 cells, got 3"),
        ("0,1", "its time is 1 ns before the row in front of it; sort the table"),
        ('2,"1', "no table: unexpected end of data"),
    ],
)
def test_a_bad_row_is_named_and_ends_it_or_is_left_out(tmp_path: Path, row: str, why: str) -> None:
    text = f'log_time,data\n1,1.5\n\n# "\n{row}\n3,2.5\n'
    ports = (("a", TimedDouble),)
    with pytest.raises(DamagedError) as caught:
        table(tmp_path, text, ports=ports)
    assert str(caught.value).startswith(f"{tmp_path / 'in.csv'}: line 5: {why}")
    assert not (tmp_path / "out.mcap").exists()
    if "no table" not in why:
        made, found = table(tmp_path, text, ports=ports, skip_bad=True)
        assert made.samples == {"a": 2}
        assert [record.data for _, _, record in found] == [1.5, 2.5]
        assert made.bad[0][0] == 5
        assert made.bad[0][1].startswith(why)


def test_a_bad_row_behind_cells_of_several_lines_is_named_by_its_own_line(tmp_path: Path) -> None:
    text = 'log_time,data,note\n1,1.5,"two\r\nlines"\n# "\n\n2,x,y\n'
    with pytest.raises(DamagedError, match="line 6: data: expected a number, got 'x'"):
        table(tmp_path, text, ports=(("a", TimedDouble),))


def test_integers_are_integers_however_they_are_written(tmp_path: Path) -> None:
    ports = (("a", TimedLong),)
    _, found = table(tmp_path, "log_time,data\n1,5\n2,5.0\n3,-2e3\n4,+7\n", ports=ports)
    assert [record.data for _, _, record in found] == [5, 5, -2000, 7]
    for wrong in ("5.5", "1e400", "five", "2147483648", "true", ""):
        with pytest.raises(DamagedError, match="line 2: "):
            table(tmp_path, f"log_time,data\n1,{wrong}\n", ports=ports)


def test_an_empty_cell_is_a_nan_when_that_is_said(tmp_path: Path) -> None:
    _, found = table(tmp_path, "log_time,data\n1,\n", ports=(("a", TimedDouble),), empty_is_nan=True)
    assert found[0][2].data != found[0][2].data


@pytest.mark.parametrize(
    ("text", "options", "why"),
    [
        (
            "log_time,x\n",
            {},
            "a table does not have the types of its columns; give --port NAME --type TYPE once for each",
        ),
        ("log_time,x\n", {"ports": (("a", TimedDouble),)}, "TimedDouble.data: has no column; --map COLUMN=data"),
        ("t,x\n", {"ports": (("a", TimedDouble),)}, "--time: .* has no column 'log_time'; it has t, x"),
        ("log_time,x,x\n", {"ports": (("a", TimedDouble),)}, "two columns are called 'x'"),
        ("1,2\n", {"ports": (("a", TimedDouble),)}, "its first row has numbers alone; --no-header"),
        (
            "log_time,x\n",
            {"ports": (("a", TimedDouble),), "columns": {"x": "date"}},
            "no field 'date'; it has tm, data",
        ),
        ("log_time,x\n", {"ports": (("a", TimedDouble),), "columns": {"y": "data"}}, "--map: .* no column 'y'"),
        ("log_time,x\n", {"ports": (("a", TimedDoubleSeq),), "columns": {"x": "data[1]"}}, "in order, from"),
        ("", {"ports": (("a", TimedDouble),)}, "has no column 'log_time'; it has none"),
        (
            "log_time,x\n",
            {"ports": (("a", TimedDouble), ("b", TimedDouble)), "columns": {"x": "data"}},
            "expected COLUMN=PORT.FIELD, got 'data'; ports: a, b",
        ),
    ],
)
def test_columns_and_ports_that_do_not_go_together_are_refused(
    tmp_path: Path, text: str, options: dict[str, Any], why: str
) -> None:
    with pytest.raises(ConfigurationError, match=why):
        table(tmp_path, text, **options)


@pytest.mark.parametrize("wrong", [{"delimiter": ""}, {"delimiter": '"'}, {"offset": "x"}, {"unit": "h"}])
def test_options_that_make_no_sense_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ConfigurationError):
        TableOptions(**wrong)


@pytest.mark.fault("D09")
@pytest.mark.parametrize(
    "raw", [b"log_time,data\n1,\xff\n", b"\x80\x04\x95", b"\0" * 9000, b'log_time,data\n"' + b"a" * 10_000, b"\n\n"]
)
def test_what_is_no_table_is_one_clear_error(tmp_path: Path, raw: bytes) -> None:
    with pytest.raises(AiortsError):
        table(tmp_path, raw, ports=(("a", TimedDouble),))
    assert not (tmp_path / "out.mcap").exists()


@pytest.mark.slow(kept_by="test_columns_are_the_numbers_and_texts_of_a_type")
@given(st.lists(st.text(st.characters(exclude_categories=["Cs"])), min_size=1), st.sampled_from(",;\t| "))
def test_cells_are_read_as_they_were_written(cells: list[str], delimiter: str) -> None:
    import csv
    import io

    line = delimiter.join(["x", *(quoted(cell, delimiter) for cell in cells)])
    found = list(csv.reader(io.StringIO(f"{line}\n", newline=""), delimiter=delimiter, strict=True))
    assert found == [["x", *cells]]


@pytest.mark.parametrize(
    ("text", "more", "told"),
    [
        (
            "log_time,port,a.b.tm,a.b.data,c.tm,c.data\n1,a.b,1,2,,\n2,c,,,1,2\n",
            [],
            "--port a.b --type TYPE --port c --type TYPE",
        ),
        ("log_time,a.b.tm,a.b.data.x,c d.tm,c d.data\n", [], "--port a.b --type TYPE --port 'c d' --type TYPE"),
        ("log_time,a.tm,a.data,b.x\n", [], "--port NAME --type TYPE"),
        ("log_time,tm,data\n1,1,2\n", [], "--port NAME --type TYPE"),
        ("log_time,tm,data\n1,1,2\n", ["--port", "a"], "--port a --type TYPE"),
        ("t,x.tm,x.data\n1,1,2\n", ["--time", "t"], "--port x --type TYPE, and your other options"),
    ],
)
def test_without_types_the_command_is_told_with_the_ports_of_the_table(
    text: str, more: list[str], told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source, target = tmp_path / "my table.csv", tmp_path / "x.mcap"
    source.write_text(text)
    assert run_command(["log", "convert", str(source), str(target), *more]) == 2
    err = capsys.readouterr().err
    assert err.endswith(f": aiorts log convert '{source}' {target} {told}\n")
    assert not target.exists()


def test_the_command_names_what_is_typed_wrong(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = tmp_path / "x.csv"
    source.write_text("log_time,data\n1,2\nx,3\n4,5\n")
    both = [str(source), str(tmp_path / "x.mcap")]
    for more, why in (
        (["--port", "a"], "give --port NAME --type TYPE once for each port"),
        (["--port", "a", "--type", "TimedDuble"], "unknown type 'TimedDuble'"),
        (["--type", "TimedDouble"], "--port NAME --type TYPE once for each port of the table, got 1 type for 0 ports"),
        (
            ["--port", "a", "--port", "b", "--type", "TimedLong"],
            "once for each port of the table, got 1 type for 2 ports",
        ),
        (["--port", "a", "--type", "TimedDouble", "--map", "x"], "--map: expected COLUMN=FIELD, got 'x'"),
        (["--port", "a", "--type", "TimedDouble"], "line 3: expected a time in ns, got 'x'; --skip-bad"),
    ):
        assert run_command(["log", "convert", *both, *more]) == 2
        assert why in capsys.readouterr().err
    assert run_command(["log", "convert", *both, "--port", "a", "--type", "TimedDouble", "--skip-bad"]) == 1
    said = capsys.readouterr()
    assert said.out == f"{both[1]}: 2 samples of 1 port\n"
    assert said.err == "  left out: line 3: expected a time in ns, got 'x'\n"
