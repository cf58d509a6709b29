"""The drawing of `aiorts bench`: it parses, loads nothing, and holds every line, row, unit and name."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import click
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aiorts_bench.harness import chart, plot
from aiorts_bench.harness.case import COST, Case, Reading
from aiorts_bench.harness.report import Figure, Report, Series, row_of

MACHINE = {"aiorts": "0", "commit": None, "python": "P<3>", "cpu": None, "cores": 2, "system": "S", "load": None}
FIGURE = Figure(
    "Latency & more",
    "offered",
    "1/s",
    "latency p50",
    "us",
    (Series("flush", ((10, 5, 4, 6), (1000, 50, 40, 60))), Series("new/<new>", ((10, 2, 1, 3), (0, 1, 1, 1)))),
    mark=100.0,
)
LONG = "a case with a name that is so very long that it cannot stand on one line of a chart, not even of a wide one"


def unused(count: int) -> Reading:
    raise AssertionError(count)


def report(*figures: Figure, name: str = "flush & new", loops: tuple[str, ...] = ("asyncio", "uvloop")) -> Report:
    found = {name: [Reading({"cost": 100.0}), Reading({"cost": 300.0})]}
    rows = tuple(row_of(loop, Case(name, "", COST, unused), found) for loop in loops)
    return Report("push", "aiorts bench push", {**MACHINE, "packages": {}}, 2, 1.0, rows, figures=figures)


def parsed(text: str) -> ElementTree.Element:
    return ElementTree.fromstring(text.split("\n", 1)[1])


def texts(text: str) -> str:
    return " ".join("".join(part.itertext()) for part in parsed(text).iter() if part.tag in ("text", "li", "h2"))


def test_loads_nothing_from_anywhere() -> None:
    text = plot.html(report(FIGURE))
    parsed(text)
    assert re.search(r"https?:|src=|href=|url\(|@import|<script", text) is None
    assert "prefers-color-scheme:dark" in text


def test_every_line_has_its_points_its_band_and_its_name() -> None:
    svg = ElementTree.fromstring(chart.lines(FIGURE))
    assert [len(line.attrib["points"].split()) for line in svg.iter("polyline")] == [2, 1]
    assert [len(band.attrib["points"].split()) for band in svg.iter("polygon")] == [4, 2]
    said = texts(plot.html(report(FIGURE)))
    assert all(word in said for word in ("offered [1/s]", "latency p50 [us]", "flush", "new/<new>", "Latency & more"))


def test_rows_are_drawn_for_each_loop_beside_the_figures() -> None:
    text = plot.html(report(FIGURE))
    assert text.count('class="half"') == 2
    assert all(word in texts(text) for word in ("flush & new", "asyncio", "uvloop", "cost [ns]", "200 ns"))


def test_long_name_is_wrapped_and_not_clipped() -> None:
    parts = [
        part.text or "" for part in parsed(plot.html(report(name=LONG))).iter("text") if part.get("class") == "name"
    ]
    assert " ".join(parts) == LONG
    assert max(map(len, parts)) <= 70


@pytest.mark.slow(kept_by="test_every_line_has_its_points_its_band_and_its_name")
@given(st.lists(st.floats(1e-6, 1e12), min_size=1, max_size=20), st.booleans())
def test_axis_holds_all_values(values: list[float], log: bool) -> None:
    axis = chart.Axis.of(values, log)
    assert axis.low <= min(values) * 1.001
    assert axis.high >= max(values) * 0.999
    assert 2 <= len(axis.ticks) <= 40
    assert all(0 <= axis.place(value) <= 1 for value in (*values, 0.0 if not log else 1e-9, 1e300))


def test_name_of_the_file_is_checked_before_anything_is_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(click.BadParameter, match=r"FILE\.html"):
        plot.check(tmp_path / "plot.pdf")
    with pytest.raises(click.BadParameter, match="no such folder"):
        plot.check(tmp_path / "none" / "plot.html")
    monkeypatch.setattr(plot, "find_spec", lambda name: None)
    with pytest.raises(click.BadParameter, match="matplotlib"):
        plot.check(tmp_path / "plot.png")


@pytest.mark.slow(kept_by="test_rows_are_drawn_for_each_loop_beside_the_figures")
@pytest.mark.skipif(importlib.util.find_spec("matplotlib") is None, reason="matplotlib is not installed")
@pytest.mark.parametrize("rates", ["200", "200,1000"], ids=["rows", "lines"])
def test_png_is_one(tmp_path: Path, rates: str) -> None:
    """In a process of its own: matplotlib keeps its fonts open."""
    words = ["--subscription=flush", "--loop=asyncio", "--scale=0.05", "--rounds=2", "--plot=plot.png"]
    command = [sys.executable, "-m", "aiorts", "bench", "push", *words, f"--producer-rate={rates}"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True, timeout=40)
    assert (tmp_path / "plot.png").read_bytes().startswith(b"\x89PNG")
