"""`aiorts log diff`: what is missing, extra, changed or at another time, and nothing else."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aiorts.cli.app import run_command
from aiorts.types import Map, NDArray, Point2D, Seq, TimedDouble, TimedDoubleSeq, TimedLong, f32, to_plain, u8
from aiorts.types import record as record_type
from aiorts.types.registry import _by_full_name
from aiorts_log import RecordingOptions, RecordingWriter, open_recording
from aiorts_log.analysis.convert import convert
from aiorts_log.analysis.difference import Difference, DiffOptions, difference, first_change
from log_parts import make

Samples = list[tuple[int, Any]]
EMPTY: Any = {}


def record(path: Path, **ports: Samples) -> Path:
    """A recording of these samples: log time and record."""
    with RecordingWriter(path, RecordingOptions(min_free=0, existing="overwrite")) as writer:
        numbers = {name: writer.add_port(name, type(samples[0][1])) for name, samples in ports.items()}
        every = [(time, numbers[name], value) for name, samples in ports.items() for time, value in samples]
        for time, port, value in sorted(every, key=lambda one: one[0]):
            assert writer.write(port, value, time)
    return path


def compare(left: Path, right: Path, **options: Any) -> Difference:
    with open_recording(left) as one, open_recording(right) as other:
        return difference(one, other, DiffOptions(**options))


def run(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> tuple[int, str]:
    capsys.readouterr()
    status = run_command(["log", "diff", *map(str, arguments)])
    return status, capsys.readouterr().out


def numbers(*values: float, start: int = 0, step: int = 10) -> Samples:
    return [(start + i * step, TimedDouble(start + i * step, value)) for i, value in enumerate(values)]


@pytest.mark.slow
def test_equal_recordings_are_equal_in_any_form(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    make(tmp_path / "a.mcap", 50, chunk=500)
    make(tmp_path / "b.mcap", 50)
    convert(tmp_path / "a.mcap", tmp_path / "a.txt")
    for other in ("b.mcap", "a.txt"):
        assert run(capsys, tmp_path / "a.mcap", tmp_path / other) == (0, "equal: 150 samples of 3 ports\n")
    assert json.loads(run(capsys, tmp_path / "a.mcap", tmp_path / "b.mcap", "--json")[1])["equal"] is True


def test_each_kind_of_difference_is_counted_and_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    left = record(
        tmp_path / "a.mcap",
        a=numbers(1, 2, 3, 4),
        same=numbers(7, 7),
        gone=numbers(1),
        kind=[(1, TimedLong(1, 2))],
    )
    right = record(
        tmp_path / "b.mcap",
        a=[*numbers(1, 2.5), (25, TimedDouble(25, 9)), (30, TimedDouble(30, 4))],
        same=numbers(7, 7),
        new=numbers(1, 2),
        kind=[(1, TimedDouble(1, 2))],
    )
    status, out = run(capsys, left, right)
    assert status == 1
    assert out.splitlines() == [
        f"{left} and {right} differ",
        "  a: 4 and 4 samples: 1 missing, 1 extra, 1 changed",
        "    changed at 0.000000010 s: data: 2.0 -> 2.5",
        "    missing at 0.000000020 s",
        "    extra at 0.000000025 s",
        "  kind: is TimedLong in the first, TimedDouble in the second",
        f"  gone: only in {left}, 1 sample",
        f"  new: only in {right}, 2 samples",
        "  equal: 1 port with 2 samples",
    ]
    assert run(capsys, left, right, "--port", "same") == (0, "equal: 2 samples of 1 port\n")
    document = json.loads(run(capsys, left, right, "--json")[1])
    assert document["only_right"] == {"new": 2}
    assert document["ports"][0]["places"][0] == {"time": 10, "what": "changed", "detail": "data: 2.0 -> 2.5"}
    assert run_command(["log", "diff", str(left), str(right), "--port", "nix"]) == 2
    assert "no port 'nix' in" in capsys.readouterr().err


def test_tolerances_forgive_what_they_say_and_no_more(tmp_path: Path) -> None:
    left = record(tmp_path / "a.mcap", a=numbers(1.0, -0.0, math.nan, math.inf))
    for values, tolerance, equal in (
        ((1.0, -0.0, math.nan, math.inf), {}, True),
        ((1.0, 0.0, math.nan, math.inf), {}, False),
        ((1.0, 0.0, math.nan, math.inf), {"absolute": 1e-12}, True),
        ((1.25, -0.0, math.nan, math.inf), {"absolute": 0.25}, True),
        ((1.25, -0.0, math.nan, math.inf), {"absolute": 0.24}, False),
        ((1.25, -0.0, math.nan, math.inf), {"relative": 0.2}, True),
        ((1.0, -0.0, 0.0, math.inf), {"absolute": 1e300}, False),
        ((1.0, -0.0, math.nan, -math.inf), {"absolute": 1e300}, False),
    ):
        right = record(tmp_path / "b.mcap", a=numbers(*values))
        assert compare(left, right, **tolerance).equal is equal, values
    right = record(tmp_path / "b.mcap", a=[(time + 3, value) for time, value in numbers(1.0, -0.0, math.nan, math.inf)])
    assert not compare(left, right).equal
    assert not compare(left, right, time_tolerance=2).equal
    found = compare(left, right, time_tolerance=3)
    assert (found.equal, found.ports[0].furthest, found.ports[0].mean) == (True, 3, 3.0)


def test_a_replay_is_compared_by_stamp_or_order_and_its_timing_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    values = numbers(*range(100), step=10_000_000)
    left = record(tmp_path / "a.mcap", a=values)
    right = record(tmp_path / "b.mcap", a=[(10**12 + time + (i % 3) * 10**6, v) for i, (time, v) in enumerate(values)])
    assert compare(left, right).ports[0].missing == 100
    for by, tolerance in (("tm", 0), ("order", None)):
        found = compare(left, right, by=by, from_start=True, time_tolerance=tolerance).ports[0]
        assert (found.missing, found.changed, found.late, found.furthest) == (0, 0, 66, 2 * 10**6)
    status, out = run(capsys, left, right, "--by", "tm", "--from-start", "--time-tolerance", "5ms")
    assert status == 0
    assert out.splitlines()[1] == "  a: 100 and 100 samples: equal; times differ by 2 ms at most, 0.99 ms in the mean"
    status, out = run(
        capsys, left, right, "--by", "order", "--from-start", "--time-tolerance", "1.5ms", "--ignore", "tm"
    )
    assert (status, "33 at other times" in out, "+2 ms" in out) == (1, True, True)
    assert run_command(["log", "diff", str(left), str(right), "--time-tolerance", "soon"]) == 2
    assert "--time-tolerance: expected 5ms, 20us or seconds, got 'soon'" in capsys.readouterr().err


@pytest.mark.slow
def test_values_alone_are_compared_whatever_the_log_times_are(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    left = record(tmp_path / "a.mcap", a=numbers(1, 2, 3), b=numbers(4))
    later = record(tmp_path / "b.mcap", a=[(10**9 + 7 * time, v) for time, v in numbers(1, 2, 3)], b=numbers(4))
    other = record(tmp_path / "c.mcap", a=[(10**9 + time, v) for time, v in numbers(1, 2, 3.5)], b=numbers(4))
    assert run(capsys, left, later)[0] == 1
    for words in (["--by", "tm"], ["--ignore", "log_time"], ["--by", "tm", "--ignore", "log_time"]):
        assert run(capsys, left, later, *words)[0] == 0
        status, out = run(capsys, left, other, *words)
        assert (status, "changed at" in out, "data: 3.0 -> 3.5" in out, "other times" in out) == (1, True, True, False)
    assert run(capsys, left, later, "--by", "tm", "--time-tolerance", "0")[0] == 1
    assert run(capsys, left, later, "--by", "order")[0] == 1
    assert run_command(["log", "diff", str(left), str(later), "--by", "time", "--ignore", "log_time"]) == 2
    assert 'choose by "tm" or "order"' in capsys.readouterr().err


@pytest.mark.slow
def test_two_runs_whose_times_are_others_are_told_how_to_be_compared(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    values = numbers(*range(1, 51))
    left = record(tmp_path / "a.mcap", a=values, b=values)
    later = [(10**18 + time + 3 * bool(time), TimedDouble(10**18 + tm.tm, tm.data)) for time, tm in values]
    right = record(tmp_path / "b.mcap", a=later, b=later)
    status, out = run(capsys, left, right)
    assert (status, out.count("50 missing, 50 extra")) == (1, 2)
    assert out.splitlines()[-1] == (
        "  hardly a sample has a partner by their log times: --from-start --time-tolerance 5ms takes them from the "
        "first sample, --by order --ignore log_time goes by number"
    )
    _, out = run(capsys, left, right, "--by", "tm", "--time-tolerance", "1ns")
    assert out.endswith("\n  hardly a sample has a partner by their stamps: --by order goes by number\n")
    _, out = run(capsys, left, right, "--from-start")
    assert "hardly a sample has a partner by their log times: --time-tolerance 5ms allows for jitter, --by" in out
    assert run(capsys, left, right, "--from-start", "--time-tolerance", "5ms", "--ignore", "tm")[0] == 0
    assert run(capsys, left, right, "--by", "order", "--ignore", "log_time", "--ignore", "tm") == (
        0,
        "equal: 100 samples of 2 ports\n",
    )
    assert "hardly" not in run(capsys, left, record(tmp_path / "c.mcap", a=values[:10], b=values))[1]


def test_what_is_left_at_the_end_is_missing_or_extra(tmp_path: Path) -> None:
    left, right = record(tmp_path / "a.mcap", a=numbers(1, 2, 3)), record(tmp_path / "b.mcap", a=numbers(1, 2))
    for by in ("time", "tm", "order"):
        assert (compare(left, right, by=by).ports[0].missing, compare(right, left, by=by).ports[0].extra) == (1, 1)


def test_a_field_can_be_left_out(tmp_path: Path) -> None:
    left = record(tmp_path / "a.mcap", a=[(1, TimedDouble(5, 1.0))])
    right = record(tmp_path / "b.mcap", a=[(1, TimedDouble(6, 1.0))])
    assert compare(left, right).ports[0].places == [(1, "changed", "tm: 5 -> 6")]
    assert compare(left, right, ignored=frozenset({"tm"})).equal


def test_where_records_differ_is_named(tmp_path: Path) -> None:
    one, other = TimedDoubleSeq(1, [1.0, 2.0]), TimedDoubleSeq(1, [1.0, 3.0])
    assert first_change(to_plain(one), to_plain(other), DiffOptions()) == "data[1]: 2.0 -> 3.0"
    assert first_change({"a": [1]}, {"a": [1, 2]}, DiffOptions()) == "a: 1 items -> 2"
    assert first_change({"a": 1}, {"b": 1}, DiffOptions()) == "record: other fields"
    assert first_change(True, 1, DiffOptions(absolute=1.0)) == "value: True -> 1"


@pytest.mark.slow(kept_by="test_what_is_left_at_the_end_is_missing_or_extra")
@given(st.lists(st.integers(0, 30), max_size=20), st.lists(st.integers(0, 30), max_size=20), st.integers(0, 3))
def test_every_sample_is_a_partner_missing_or_extra(
    tmp_path_factory: pytest.TempPathFactory, left: list[int], right: list[int], tolerance: int
) -> None:
    folder = tmp_path_factory.getbasetemp()
    paths = []
    for name, times in (("l", left), ("r", right)):
        samples: Samples = [(time, TimedDouble(time, 0.0)) for time in sorted([*times, 1000])]
        paths.append(record(folder / f"diff_{name}.mcap", a=samples))
    found = compare(*paths, time_tolerance=tolerance).ports[0]
    assert found.left == len(left) + 1 == found.partners + found.missing
    assert found.right == len(right) + 1 == found.partners + found.extra
    assert found.furthest <= tolerance
    if sorted(left) == sorted(right):
        assert found.missing == 0
    if not tolerance:
        common = sum(min(left.count(time), right.count(time)) for time in set(left))
        assert found.partners == common + 1


@record_type
class Scan:
    """A scan, in each kind of array."""

    tm: int = 0
    ranges: NDArray = np.zeros(0)
    image: Seq[u8] = ()  # type: ignore[assignment]
    weights: Seq[f32] = ()  # type: ignore[assignment]
    points: Seq[Point2D] = ()  # type: ignore[assignment]
    data: Map = EMPTY


@dataclass
class Sweep:
    """What a user without records of aiorts has."""

    ranges: np.ndarray[Any, Any]


@pytest.fixture(params=[True, False], ids=["known", "unknown"])
def known(request: pytest.FixtureRequest) -> Iterator[bool]:
    """Whether the types are known to who compares."""
    yield request.param
    _by_full_name.update(FORGOTTEN)
    FORGOTTEN.clear()


FORGOTTEN: dict[str, Any] = {}


def forget() -> None:
    for name in [name for name, cls in _by_full_name.items() if cls in (Scan, Sweep)]:
        FORGOTTEN[name] = _by_full_name.pop(name)


RANGES = np.linspace(0.0, 36.0, 37).reshape(37)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"ranges": RANGES + (RANGES == 4) * 0.25}, "ranges[4]: 4.0 -> 4.25"),
        ({"ranges": RANGES.astype("f4")}, "ranges: float64 -> float32"),
        ({"ranges": RANGES[:36].reshape(6, 6)}, "ranges: shape (37,) -> (6, 6)"),
        ({"ranges": RANGES[:36]}, "ranges: 37 items -> 36"),
        ({"ranges": np.where(RANGES == 2, math.nan, RANGES)}, "ranges[2]: 2.0 -> 'NaN'"),
        ({"image": [7, 255, 9]}, "image[1]: 0 -> 255"),
        ({"weights": [0.5, 1.75]}, "weights[1]: 1.5 -> 1.75"),
        ({"points": [Point2D(1, 2), Point2D(3, 5)]}, "points[1].y: 4.0 -> 5.0"),
        ({"data": {"a": {"b": np.array([[1, 2], [3, 5]])}}}, "data.a.b[1][1]: 4 -> 5"),
        ({"data": {"a": {"b": np.array([[1 + 1j]])}}}, "data.a.b: int64 -> complex128"),
    ],
)
def test_arrays_are_compared_item_by_item_whether_or_not_their_type_is_known(
    change: dict[str, Any], said: str, known: bool, tmp_path: Path
) -> None:
    whole: dict[str, Any] = {
        "ranges": RANGES,
        "image": [7, 0, 9],
        "weights": [0.5, 1.5],
        "points": [Point2D(1, 2), Point2D(3, 4)],
        "data": {"a": {"b": np.array([[1, 2], [3, 4]])}},
    }
    left = record(tmp_path / "a.mcap", a=[(1, Scan(**whole))])
    right = record(tmp_path / "b.mcap", a=[(1, Scan(**{**whole, **change}))])
    if not known:
        forget()
    found = compare(left, right)
    assert [detail for _, _, detail in found.ports[0].places] == [said]


@pytest.mark.slow
@pytest.mark.parametrize("ending", ["mcap", "txt", "jsonl"])
def test_tolerances_count_for_the_items_of_an_array(
    ending: str, known: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    near = RANGES + (RANGES == 18) * 0.0099
    near[3] = math.nan
    first = np.where(RANGES == 3, math.nan, RANGES)
    left = record(tmp_path / "a.mcap", a=[(1, Sweep(first))], b=[(1, Scan(image=[7, 0]))])
    right = record(tmp_path / "b.mcap", a=[(1, Sweep(near))], b=[(1, Scan(image=[9, 0]))])
    if ending != "mcap":
        for path in (left, right):
            convert(path, path.with_suffix(f".{ending}"))
        left, right = left.with_suffix(f".{ending}"), right.with_suffix(f".{ending}")
    if not known:
        forget()
    status, out = run(capsys, left, right, "--port", "a")
    assert (status, "ranges[18]: 18.0 -> 18.0099" in out) == (1, True)
    for words, equal in (("--abs 0.01", True), ("--abs 0.009", False), ("--rel 0.001", True), ("--rel 1e-5", False)):
        assert run(capsys, left, right, "--port", "a", *words.split())[0] == (0 if equal else 1), words
    if known or ending == "mcap":  # a text of bytes is no array to who does not know the type
        assert run(capsys, left, right, "--abs", "2")[0] == 0
        assert "image[0]: 7 -> 9" in run(capsys, left, right, "--abs", "1")[1]


@pytest.mark.slow(kept_by="test_arrays_are_compared_item_by_item_whether_or_not_their_type_is_known")
@given(
    st.sampled_from(["f2", "f4", "f8", "i1", "u1", "i8", "u8"]),
    st.lists(st.tuples(st.floats(width=16), st.floats(width=16)), max_size=5),
    st.sampled_from([0.0, 0.5, 1e300]),
    st.sampled_from([0.0, 0.1, 1.0]),
)
def test_an_array_differs_where_its_items_do(
    code: str, pairs: list[tuple[float, float]], absolute: float, relative: float
) -> None:
    columns = [
        [one[side] if code[0] == "f" else int(np.nan_to_num(one[side])) % 100 for one in pairs] for side in (0, 1)
    ]
    left, right = (np.array(column, dtype=code) for column in columns)
    options = DiffOptions(absolute=absolute, relative=relative)
    lists = [[to_plain(one) for one in array.tolist()] for array in (left, right)]
    assert first_change(left, right, options) == first_change(*lists, options, "value")
