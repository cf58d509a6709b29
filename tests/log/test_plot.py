"""`aiorts log plot`: every peak is in the picture, the same recording gives the same bytes, nothing is half drawn."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from collections.abc import Sequence
from enum import Enum
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aiorts.cli.app import run_command
from aiorts.errors import ConfigurationError
from aiorts.types import NDArray, Point2D, Pose2D, TimedDouble, TimedDoubleSeq, TimedPose2D, TimedString, record
from aiorts_log import RecordingOptions, RecordingWriter, open_recording
from aiorts_log.analysis.series import numeric_fields, read_series
from aiorts_log.analysis.thinning import thinned, thinned_path

FLOATS = st.floats(-1e6, 1e6) | st.just(math.nan)


@record
class Partly:
    tm: int = 0
    speed: float | None = None
    never: float | None = None


def run(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> tuple[int, str, str]:
    capsys.readouterr()
    status = run_command(["log", "plot", *map(str, arguments)])
    said = capsys.readouterr()
    return status, said.out, said.err


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    """A robot that drives an ellipse, twice as long as it is wide, in 1000 samples."""
    path = tmp_path / "drive.mcap"
    with RecordingWriter(path, RecordingOptions(min_free=0)) as writer:
        pose = writer.add_port("odometry.pose", TimedPose2D, {"unit": "m"})
        speed = writer.add_port("base.speed", TimedDouble, {"unit": "m/s"})
        sonar = writer.add_port("base.sonar", TimedDoubleSeq)
        note = writer.add_port("note", TimedString)
        for i in range(1000):
            time, angle = i * 10**7, i * 2 * math.pi / 1000
            where = Point2D(2 * math.cos(angle), math.sin(angle))
            writer.write(pose, TimedPose2D(time, Pose2D(where, angle)), time)
            writer.write(speed, TimedDouble(time, 1.0 + (50.0 if i == 500 else 0.0)), time)
            writer.write(sonar, TimedDoubleSeq(time, [1.0, 2.0, 3.0]), time)
            writer.write(note, TimedString(time, "x"), time)
    return path


@pytest.mark.slow
@given(st.lists(st.tuples(st.floats(0.0, 10.0), FLOATS), max_size=300), st.integers(1, 12))
def test_a_thinned_curve_keeps_every_peak(points: list[tuple[float, float]], pieces: int) -> None:
    points.sort(key=lambda point: point[0])
    times, values = [time for time, _ in points], [value for _, value in points]
    kept = thinned(times, values, pieces)
    assert kept == sorted(set(kept))
    if not points:
        return
    numbers = [value for value in values if value == value]
    shown = [values[i] for i in kept if values[i] == values[i]]
    if times[-1] > times[0]:
        assert (min(shown, default=0), max(shown, default=0)) == (min(numbers, default=0), max(numbers, default=0))
        assert {0, len(points) - 1} <= set(kept)
        assert any(value != value for value in values) == any(values[i] != values[i] for i in kept)
    assert len(kept) <= max(5 * (pieces + 1), 4 * pieces)


def test_a_long_curve_is_thinned_and_a_short_one_is_not() -> None:
    times = [i / 1000 for i in range(100_000)]
    values = [math.sin(time) for time in times]
    values[54_321] = 99.0
    kept = thinned(times, values, 100)
    assert len(kept) <= 505
    assert 54_321 in kept
    assert thinned(times[:400], values, 100) == list(range(400))


@given(st.lists(st.tuples(FLOATS, FLOATS), min_size=1, max_size=100), st.integers(1, 50))
def test_a_thinned_path_leaves_no_point_far_from_one_that_is_kept(
    points: Sequence[tuple[float, float]], cells: int
) -> None:
    xs, ys = [x for x, _ in points], [y for _, y in points]
    whole = [(x, y) for x, y in points if x == x and y == y]
    kept = thinned_path(xs, ys, cells)
    if not whole:
        assert kept == []
        return
    size = max(max(x for x, _ in whole) - min(x for x, _ in whole), max(y for _, y in whole) - min(y for _, y in whole))
    near = [(xs[i], ys[i]) for i in kept if xs[i] == xs[i] and ys[i] == ys[i]]
    assert all(min(math.hypot(x - a, y - b) for a, b in near) <= size / cells * (1 + 1e-9) for x, y in whole)


def test_fields_are_read_as_curves(drive: Path) -> None:
    with open_recording(drive) as reader:
        names = ["odometry.pose.data.heading", "base.sonar", "base.sonar.data[1]", "base.speed"]
        heading, sonar, second, speed = read_series(reader, names, None, 10**9, lambda done: None)
    assert [one.label for one in (*heading, *sonar, *second, *speed)] == [
        "odometry.pose.data.heading",
        "base.sonar.data[0]",
        "base.sonar.data[1]",
        "base.sonar.data[2]",
        "base.sonar.data[1]",
        "base.speed.data",
    ]
    assert (heading[0].unit, speed[0].unit, sonar[0].unit) == ("", "m/s", "")
    assert len(heading[0].values) == len(heading[0].times) == 100
    assert list(second[0].values) == [2.0] * 100
    assert heading[0].times[99] == 0.99


DRAW = """
import sys
from aiorts.cli.app import run_command
for number in "01":
    for form in ("svg", "png"):
        for name, fields in (("path", ["--xy", *sys.argv[1:3]]), ("times", sys.argv[3:])):
            assert run_command(["log", "plot", "drive.mcap", *fields, "-o", f"{name}{number}.{form}"]) == 0
"""
"""In a process of its own: matplotlib keeps the files of its fonts open for the next picture."""


@pytest.mark.slow(kept_by="test_fields_are_read_as_curves")
def test_a_path_and_curves_are_drawn_the_same_every_time(drive: Path) -> None:
    pytest.importorskip("matplotlib")
    fields = ["odometry.pose.data.position.x", "odometry.pose.data.position.y", "base.speed", "base.sonar"]
    done = subprocess.run(
        [sys.executable, "-c", DRAW, *fields], cwd=drive.parent, capture_output=True, text=True, check=True, timeout=100
    )
    assert done.stderr == ""
    assert done.stdout.splitlines()[:2] == ["path0.svg: 2000 values of 2 curves", "times0.svg: 4000 values of 4 curves"]
    for name in ("path", "times"):
        for form in ("svg", "png"):
            raw = drive.with_name(f"{name}0.{form}").read_bytes()
            assert raw == drive.with_name(f"{name}1.{form}").read_bytes()
            assert name == "times" or len(raw) <= 60_000
    text = drive.with_name("path0.svg").read_text()
    assert "odometry.pose.data.position.x<" in text
    root = ElementTree.fromstring(text)
    lines = [path.get("d", "") for path in root.iter("{http://www.w3.org/2000/svg}path")]
    longest = max(lines, key=len).replace("M", "L").split("L")[1:]
    xs, ys = ([float(point.split()[i]) for point in longest] for i in (0, 1))
    assert max(xs) - min(xs) == pytest.approx(2 * (max(ys) - min(ys)), rel=0.01)
    assert len(longest) > 500
    assert "base.speed.data [m/s]" in drive.with_name("times0.svg").read_text()


class Mode(Enum):
    """What a robot does."""

    IDLE = 0
    RUN = 3


class Word(Enum):
    """An enumeration without numbers."""

    YES = "yes"
    NO = "no"


@record
class Scan:
    """A scan of a user."""

    tm: int = 0
    ranges: NDArray = np.zeros(0)
    mode: Mode = Mode.IDLE
    word: Word = Word.YES


LONG = "lidar_front_left.everything_around"


@pytest.fixture
def scans(tmp_path: Path) -> Path:
    path = tmp_path / "scans.mcap"
    with RecordingWriter(path, RecordingOptions(min_free=0)) as writer:
        port, grid = writer.add_port(LONG, Scan), writer.add_port("grid", Scan)
        for i in range(20):
            mode = Mode.RUN if i % 2 else Mode.IDLE
            writer.write(port, Scan(i, np.arange(36.0) + i, mode), i)
            writer.write(grid, Scan(i, np.arange(40.0).reshape(5, 8)), i)
    return path


def test_items_that_are_not_drawn_are_told_with_how_to_draw_them(
    scans: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("aiorts_log.analysis.plot.find_spec", lambda name: True)
    monkeypatch.setattr("aiorts_log.commands.drawing.draw_times", lambda file, *more: file.write_text("drawn"))
    for name, said in (
        (f"{LONG}.ranges", f"  not in it: {LONG}.ranges: 16 of 36 items drawn; name others, as {LONG}.ranges[16]\n"),
        ("grid.ranges", "  not in it: grid.ranges: 16 of 40 items drawn; name others, as grid.ranges[2][0]\n"),
        ("grid.ranges[2][0]", ""),
        ("grid.ranges[4]", ""),
    ):
        target = scans.with_name("x.svg")
        status, out, err = run(capsys, scans, name, "-o", target, "--overwrite")
        assert (status, out.startswith(f"{target}: "), err) == (0, True, said)
    with open_recording(scans) as reader:
        ((*_, last),) = read_series(reader, ["grid.ranges"], None, None, lambda done: None)
    assert (last.label, list(last.values)) == ("grid.ranges[1][7]", [15.0] * 20)


def test_an_enumeration_is_drawn_as_its_number_or_it_is_said_what_can_be(
    scans: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("aiorts_log.analysis.plot.find_spec", lambda name: True)
    with open_recording(scans) as reader:
        ((mode,),) = read_series(reader, [f"{LONG}.mode"], None, None, lambda done: None)
    assert list(mode.values) == [0.0, 3.0] * 10
    status, _, err = run(capsys, scans, f"{LONG}.word", "-o", scans.with_name("x.svg"))
    said = "word: is Word, not a number; numbers, moments, and enumerations of numbers whose type is known can be drawn"
    assert (status, said in err) == (2, True)


LEGEND = """
import sys, warnings
from matplotlib.image import imread
from aiorts.cli.app import run_command
warnings.simplefilter("error")
for size in ("3", "8"):
    assert run_command(["log", "plot", "scans.mcap", *sys.argv[1:], "-o", "x.png", "--overwrite", "--size", size]) == 0
    print(imread("x.png")[:, -3:, 3].max())
"""


@pytest.mark.slow(kept_by="test_fields_are_read_as_curves")
def test_a_legend_stays_within_the_picture(scans: Path) -> None:
    pytest.importorskip("matplotlib")
    words = [f"{LONG}.{name}" for name in ("ranges", "ranges[20]", "tm")]
    line = [sys.executable, "-c", LEGEND, *words]
    done = subprocess.run(line, cwd=scans.parent, capture_output=True, text=True, timeout=100)
    assert done.stdout.splitlines()[1::2] == ["0.0", "0.0"], done.stderr


@record
class Weather:
    """Two fields that have no unit in common; in every second sample one is absent."""

    tm: int = 0
    distance: float = 0.0
    temperature: float | None = None
    inner: TimedDoubleSeq | None = None


@record
class Level:
    """One field beside the stamp."""

    tm: int = 0
    heights: Sequence[float] = ()


@pytest.fixture
def weather(tmp_path: Path) -> Path:
    path = tmp_path / "weather.mcap"
    with RecordingWriter(path, RecordingOptions(min_free=0)) as writer:
        port, level = writer.add_port("outside", Weather, {"unit": "m"}), writer.add_port("level", Level, {"unit": "m"})
        for i in range(20):
            inner = TimedDoubleSeq(i, [1.0] * (i % 4))
            writer.write(port, Weather(i, 1.0, 20.0 if i % 2 else None, inner if i % 2 else None), i)
            writer.write(level, Level(i, [1.0, 2.0]), i)
    return path


UNKNOWN = pytest.mark.parametrize("unknown", [False, True])


@pytest.fixture
def types(unknown: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whether the types of a recording are loaded."""
    if unknown:
        monkeypatch.setattr("aiorts_log.mcap.reader.named_type", lambda name: (None, f"{name} is not known here"))


@UNKNOWN
@pytest.mark.usefixtures("types")
def test_the_unit_of_a_port_is_that_of_a_record_with_one_field(weather: Path) -> None:
    names = ["outside.distance", "outside.temperature", "level.heights", "level.heights[1]", "level.tm"]
    with open_recording(weather) as reader:
        found = read_series(reader, names, None, None, lambda done: None)
    assert [group[0].unit for group in found] == ["", "", "m", "m", ""]


@UNKNOWN
@pytest.mark.usefixtures("types")
def test_an_item_that_no_sample_has_is_an_error_with_the_longest(
    weather: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("aiorts_log.analysis.plot.find_spec", lambda name: True)
    target = weather.with_name("x.svg")
    for field, why in (
        ("heights[30]", "level: no sample has heights[30]; the longest has 2; nothing is drawn"),
        ("inner.data[3]", "outside: no sample has inner.data[3]; the longest has 3; nothing is drawn"),
    ):
        port = why.partition(":")[0]
        for fields in ([f"{port}.{field}"], ["outside.distance", f"{port}.{field}"]):
            status, out, err = run(capsys, weather, *fields, "-o", target)
            assert (status, out, err) == (2, "", f"aiorts: E-RECORDING: {weather}: {why}\n")
    assert not target.exists()
    with open_recording(weather) as reader:
        ((some,),) = read_series(reader, ["outside.inner.data[2]"], None, None, lambda done: None)
    assert [value for value in some.values if value == value] == [1.0] * 5


@pytest.mark.slow
def test_a_field_without_a_number_in_any_sample_is_an_error(
    drive: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("aiorts_log.analysis.plot.find_spec", lambda name: True)
    path = drive.with_name("none.mcap")
    with RecordingWriter(path, RecordingOptions(min_free=0)) as writer:
        writer.write(writer.add_port("outside", Weather), Weather(), 0)
    status, _, err = run(capsys, path, "outside.temperature", "-o", drive.with_name("x.svg"))
    assert (status, "outside.temperature: is None or NaN in every sample; nothing is drawn" in err) == (2, True)


DOTS = """
import re, sys
from aiorts.cli.app import run_command
for fields in (["outside.temperature"], ["--xy", "outside.tm", "outside.temperature"]):
    assert run_command(["log", "plot", "weather.mcap", *fields, "-o", "x.svg", "--overwrite"]) == 0
    print(sum(one.count("<use ") for one in re.findall("<g clip-path=.*?</g>", open("x.svg").read(), re.DOTALL)))
assert run_command(["log", "plot", "weather.mcap", "outside.distance", "-o", "x.svg", "--overwrite"]) == 0
print(len(re.findall("<g clip-path=.*?<use ", open("x.svg").read())))
"""


@pytest.mark.slow(kept_by="log/test_own_fields.py::test_a_curve_has_a_gap_where_a_value_is_absent")
def test_points_between_gaps_are_marked(weather: Path) -> None:
    pytest.importorskip("matplotlib")
    line = [sys.executable, "-c", DOTS]
    done = subprocess.run(line, cwd=weather.parent, capture_output=True, text=True, timeout=100)
    assert done.stdout.splitlines()[1::2] == ["10", "12", "0"], done.stderr  # a path has a begin and an end, too


def test_a_field_that_is_not_there_is_told_with_the_numbers_below(drive: Path) -> None:
    with open_recording(drive) as reader:
        with pytest.raises(ConfigurationError, match=r"; numbers are in odometry\.pose\.data\.position\.x$"):
            read_series(reader, ["odometry.pose.x"], None, None, lambda _: None)
        below = r"numbers are in odometry\.pose\.data\.position\.x, .*\.y, odometry\.pose\.data\.heading$"
        with pytest.raises(ConfigurationError, match=below):
            read_series(reader, ["odometry.pose.nothing"], None, None, lambda _: None)


@pytest.mark.slow
def test_what_cannot_be_drawn_is_one_line_and_leaves_nothing(drive: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("matplotlib")
    target = drive.with_name("x.svg")
    for arguments, why in (
        (["nix.data"], "no port for 'nix.data'; write PORT.FIELD; ports: odometry.pose"),
        (["base.speed.date"], "base.speed.date: TimedDouble has no field 'date'; did you mean data?"),
        (["odometry.pose"], "odometry.pose.data: is Pose2D, not a number; name a field of it: position, heading"),
        (["note"], "note.data: is str, not a number"),
        (["base.speed", "--start", "+100"], "base.speed has no sample there; nothing is drawn"),
        (["base.speed", "--xy", "base.speed", "base.speed"], "expected fields or --xy X Y, and not both"),
        (["--start", "+100"], "has no numbers there; nothing is drawn"),
        (["--xy", "base.sonar", "base.speed"], "--xy: base.sonar.data[0] is one of 3; name one item"),
        (["base.speed", "--size", "nan"], "no finite number"),
    ):
        status, out, err = run(capsys, drive, *arguments, "-o", target)
        assert (status, out, err.count("\n")) == (2, "", 1), (arguments, err)
        assert why in err
    assert run(capsys, drive, "base.speed", "-o", drive.with_name("x.pdf"))[2].startswith(
        "aiorts: E-CONFIG: -o: expected FILE.png or FILE.svg"
    )
    target.write_text("mine")
    assert "exists already" in run(capsys, drive, "base.speed", "-o", target)[2]
    assert target.read_text() == "mine"
    assert sorted(os.listdir(drive.parent)) == ["drive.mcap", "x.svg"]


@pytest.mark.slow(kept_by="test_a_field_that_the_first_sample_lacks_is_drawn_too")
def test_without_fields_all_numbers_are_drawn(drive: Path) -> None:
    pytest.importorskip("matplotlib")
    with open_recording(drive) as reader:
        assert numeric_fields(reader, None, None) == [
            "odometry.pose.data.position.x",
            "odometry.pose.data.position.y",
            "odometry.pose.data.heading",
            "base.speed.data",
            "base.sonar.data",
        ]
    target = drive.with_name("all.svg")
    command = [sys.executable, "-m", "aiorts", "log", "plot", drive, "-o", target]
    done = subprocess.run(command, capture_output=True, text=True, timeout=100)
    assert (done.returncode, done.stdout, done.stderr) == (0, f"{target}: 7000 values of 7 curves\n", "")


def test_a_field_that_the_first_sample_lacks_is_drawn_too(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "part.mcap", RecordingOptions(min_free=0)) as writer:
        part = writer.add_port("part", Partly)
        scan = writer.add_port("scan", TimedDoubleSeq)
        bare = writer.add_port("bare", float)
        for i in range(3):
            writer.write(part, Partly(i, None if i == 0 else 1.0), i)
            writer.write(scan, TimedDoubleSeq(i, [0.0] * 100), i)
            writer.write(bare, 0.5, i)
    with open_recording(tmp_path / "part.mcap") as reader:
        assert numeric_fields(reader, None, None) == ["part.speed", "bare"]


def test_without_matplotlib_the_command_is_named(
    drive: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("aiorts_log.analysis.plot.find_spec", lambda name: None)
    status, _, err = run(capsys, drive, "base.speed", "-o", "x.svg")
    assert (status, err) == (
        2,
        'aiorts: E-EXTRA: x.svg: a picture needs matplotlib, which is not installed; pip install "aiorts[plot]"\n',
    )


@pytest.mark.slow
def test_matplotlib_is_loaded_for_pictures_alone() -> None:
    code = "import sys, aiorts_log, aiorts_log.commands.command; print('matplotlib' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=100)
    assert done.stdout == "False\n"
