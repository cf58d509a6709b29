"""Figures and graphs from what kernels say."""

from __future__ import annotations

import asyncio
import re
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

import aiorts_studio
from aiorts_studio.beside import PORTS, port_of
from aiorts_studio.watching.figures import LEFT_OUT, Figures, different
from aiorts_studio.watching.page import Page
from aiorts_studio.watching.plots import Columns, field_of
from aiorts_studio.watching.studio import Studio
from aiorts_studio.watching.totals import folded_row, total_of
from aiorts_studio.watching.view import View
from control_parts import WAIT

pytestmark = pytest.mark.row(120)
KINDS = ("connectors", "service_connectors", "timed", "contexts", "components")
SECOND = 1_000_000_000


def item(at_ns: int, connectors: dict[str, Any], *, whole: bool = False, gone: Any = None) -> dict[str, Any]:
    return {
        "whole": whole,
        "at_ns": at_ns,
        "gone": gone or {},
        **{kind: {} for kind in KINDS},
        "connectors": connectors,
    }


@given(st.lists(st.tuples(st.integers(1, 50), st.integers(0, 30)), min_size=2, max_size=30))
def test_rates_are_of_the_last_second_and_sums_are_exact(steps: list[tuple[int, int]]) -> None:
    figures, written, lost, counted = Figures(), 0, 0, []
    for number, (more, less) in enumerate(steps):
        written, lost = written + more, lost + less
        counted.append((written, lost))
        row = [written, 0, 3, {"full": lost} if lost else {}, 0]
        figures.take(item(SECOND + number * SECOND // 5, {"a": row, "b": row}, whole=number == 0))
    rate, dropped, waiting, losing, reasons, *_ = figures.edge(["a"]) or []
    first = max(0, len(steps) - 7)
    seconds = (len(steps) - 1 - first) / 5
    assert rate == pytest.approx((written - counted[first][0]) / seconds, rel=0.01)
    assert losing == pytest.approx((lost - counted[first][1]) / seconds, rel=0.01)
    assert (dropped, waiting, reasons) == (lost, 3, {"full": lost} if lost else None)
    both = figures.edge(["a", "b", "nothing"])
    assert both is not None
    assert (both.lost, both.buffered) == (2 * lost, 6)
    assert ("a" in figures.lossy) is bool(lost)


def test_what_is_gone_is_forgotten() -> None:
    figures = Figures()
    figures.take(item(SECOND, {"a": [1, 1, 0, {}, 0]}, whole=True))
    figures.take_part({"connectors": {"a": {"ledger": {"round_trip_ns": 5}}}, "contexts": {}})
    figures.take(item(2 * SECOND, {}, gone={"connectors": ["a"]}))
    assert figures.edge(["a"]) is None
    assert not figures.trips


def test_a_kernel_is_found_by_the_name_by_which_links_reach_it() -> None:
    view = View("k", "host/monitor-2827", {}, links="monitor")
    called = ("host/monitor-2827", "monitor-2827", "monitor", "host/monitor")
    assert all(view.is_called(name, "host") for name in called)
    assert not any(view.is_called(name, "host") for name in ("", "host/", "odometry", "other/monitor"))
    assert [view.is_called(name, "other") for name in called] == [True, False, True, True]
    assert not View("k", "host/k-1", {}).is_called("", "host")


def test_a_kernel_as_a_whole_counts_what_is_folded_and_names_the_worst_first() -> None:
    figures, view = Figures(), View("k", "host/k", {})
    names = {"a.out-b.in": 5, "a.out-c.in": 70, "c.out-d.in": 0}
    ends = {name: dict(zip(("source", "target"), name.split("-"), strict=True)) for name in names}
    view.profile = {"components": {name: {"last_error": None} for name in "abcd"}, "connectors": ends}
    view.profile["components"]["c"]["last_error"] = "ValueError: no"
    states = {"states": {"x": "active"}, "failed": False}
    for step in (0, 1):
        counted = {name: [100 * step, 0, 0, {"overwritten": lost}, 0] for name, lost in names.items()}
        figures.take(item(SECOND * (step + 1), counted, whole=not step))
        figures.now["components"] = {name: {**states, "failed": name == "c"} for name in "abcd"}
    folded = {"a.out-b.in": 11, "a.out-c.in": 12, "c.out-d.in": None}
    total = total_of(view, figures, folded, {"a": 1, "b": 2, "c": 9, "d": 9})
    assert total == [
        *(4, 3, 300.0, 75),
        [["c", "ValueError: no", 9]],
        [
            ["a.out", "c.in", 70, ["overwritten"], "edge", 12],
            ["a.out", "b.in", 5, ["overwritten"], "edge", 11],
        ],
    ]
    inside = total_of(view, figures, dict.fromkeys(folded), {"a": 9, "c": 9})
    assert inside[:4] == total[:4]
    assert inside[5][0][4:] == ["box", 9]
    assert folded_row(figures, "cd", ["a.out-c.in", "c.out-d.in"]) == ["error", "1 failed, 1 loses samples"]
    assert folded_row(figures, "ab", []) == ["active", ""]


def test_only_what_is_different_and_in_view_is_told() -> None:
    told: dict[int, list[Any]] = {}
    assert different({1: [1], 2: [2]}, told, [1, 3]) == {1: [1]}
    assert different({1: [1], 2: [2]}, told, [1, 2]) == {2: [2]}
    assert different({1: [5], 2: [2]}, told, [1, 2]) == {1: [5]}


@pytest.mark.anyio
async def test_a_studio_is_unattended_some_time_after_its_last_page() -> None:
    studio, page = Studio(["nothing"]), Page()
    waiting = asyncio.create_task(studio.unattended(WAIT, 0.05))
    await studio.join(page)
    await asyncio.sleep(0.1)
    assert not waiting.done()
    await studio.leave(page)
    await asyncio.wait_for(waiting, WAIT / 2)
    await asyncio.wait_for(studio.unattended(0.01, WAIT), WAIT / 2)  # no page comes


def test_the_port_of_a_run_is_the_same_each_time() -> None:
    assert port_of("host/robot") == port_of("host/robot") != port_of("host/other")
    assert port_of("host/robot") in PORTS


DATA = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**64), 2**64) | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.sampled_from("abx0"), inner, max_size=4),
    max_leaves=12,
)


@given(DATA, st.lists(st.sampled_from(["a", "b", "x", "0", "1", "", "٣", "²", "9" * 5_000, "-1"]), max_size=5))
def test_a_path_leads_to_a_number_or_to_none(data: Any, words: list[str]) -> None:
    found = field_of(data, ".".join(words))
    assert found is None or isinstance(found, float)


@given(st.lists(st.floats(-1e9, 1e9), min_size=1))
def test_a_column_holds_the_smallest_and_the_largest(values: list[float]) -> None:
    columns = Columns(["x"])
    for value in values:
        columns.add(0.0, {"x": value})
    assert columns.take() == {"x": [(0.0, min(values), max(values))]}
    assert columns.take() == {}


def test_the_page_and_the_server_leave_out_the_same() -> None:
    text = (Path(aiorts_studio.__file__).parent / "page/words.js").read_text(encoding="utf-8")
    found = re.search(r"LEFT_OUT = new Set\(\[(.*)\]\)", text)
    assert found
    assert set(re.findall(r'"(\w+)"', found[1])) == LEFT_OUT
