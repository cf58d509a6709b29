"""Places of boxes and ways of edges, for graphs of all shapes."""

from __future__ import annotations

from itertools import combinations, pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts_studio.watching.layout import Edge, Key, Layout, Spot, meets

pytestmark = pytest.mark.row(120)
PORTS = 3


@st.composite
def drawn(draw: st.DrawFn) -> tuple[list[Spot], list[Edge], dict[Key, str]]:
    """A graph: boxes in bands of groups, and edges between any two, also back and to themselves."""
    count = draw(st.integers(1, 14))
    bands = draw(st.lists(st.integers(0, 3), min_size=count, max_size=count))
    spots = []
    for i, band in enumerate(bands):
        inputs, outputs = (tuple(f"p{n}" for n in range(draw(st.integers(0, PORTS)))) for _ in range(2))
        spots.append(Spot((str(i),), ("band", str(band)), inputs, outputs, "n" * draw(st.integers(1, 40))))
    ends = st.tuples(*[st.integers(0, count - 1)] * 2, *[st.integers(0, PORTS - 1)] * 2)
    wanted = draw(st.lists(ends, max_size=20))
    edges = [
        Edge(("edge", str(n)), spots[a].key, f"p{out}", spots[b].key, f"p{into}")
        for n, (a, b, out, into) in enumerate(wanted)
    ]
    return spots, edges, {("band", str(band)): f"group {band // 2}" for band in sorted(set(bands))}


def check(layout: Layout, edges: list[Edge]) -> None:
    for one, other in combinations(layout.spots.values(), 2):
        apart = (
            one.x + one.w <= other.x
            or other.x + other.w <= one.x
            or one.y + one.h <= other.y
            or other.y + other.h <= one.y
        )
        assert apart, (one, other)
    for spot in layout.spots.values():
        band = layout.bands[spot.band]
        assert band.top <= spot.y
        assert spot.y + spot.h <= band.top + band.height
    for above, below in pairwise(layout.bands.values()):
        assert above.top + above.height <= below.top
    for edge in edges:
        route = layout.route(edge)
        assert not [spot for spot in layout.spots.values() if meets(route, spot)], (edge, route)
        for (ax, ay), (bx, by) in pairwise(route.points):
            assert ax == bx or ay == by


@given(drawn())
@settings(max_examples=60, deadline=None)
def test_no_boxes_overlap_and_no_edge_runs_through_one(graph: tuple[list[Spot], list[Edge], dict[Key, str]]) -> None:
    spots, edges, groups = graph
    layout = Layout()
    layout.place(spots, edges, groups)
    check(layout, edges)


@given(drawn())
@settings(max_examples=60, deadline=None)
def test_one_box_more_moves_no_other(graph: tuple[list[Spot], list[Edge], dict[Key, str]]) -> None:
    spots, edges, groups = graph
    *others, last = spots
    if not others:
        return
    near = [edge for edge in edges if last.key not in (edge.source, edge.target)]
    layout = Layout()
    layout.place(
        others, near, {band: group for band, group in groups.items() if any(one.band == band for one in others)}
    )
    before = {one.key: (one.x, one.y) for one in others}
    sources = [edge.source for edge in edges if edge.target == last.key]
    targets = [edge.target for edge in edges if edge.source == last.key]
    if layout.add(last, groups[last.band], sources, targets):
        check(layout, edges)
    assert before == {key: (one.x, one.y) for key, one in layout.spots.items() if key != last.key}


@given(drawn(), st.integers(-500, 3_000), st.integers(-500, 3_000))
@settings(max_examples=60, deadline=None)
def test_a_box_that_is_moved_finds_room(graph: tuple[list[Spot], list[Edge], dict[Key, str]], x: int, y: int) -> None:
    spots, edges, groups = graph
    layout = Layout()
    layout.place(spots, edges, groups)
    before = {one.key: (one.x, one.y) for one in spots}
    layout.move(spots[0].key, x, y)
    check(layout, edges)
    assert all((one.x, one.y) == before[one.key] for one in spots[1:])


def test_room_that_is_given_back_is_used_again() -> None:
    layout = Layout()
    spots = [Spot((str(i),), ("band",), ("in",), ("out",)) for i in range(3)]
    edges = [Edge((f"e{i}",), ("0",), "out", (str(i),), "in") for i in (1, 2)]
    layout.place(spots, edges, {("band",): "all"})
    first = layout.route(edges[0])
    for _ in range(50):
        layout.forget(edges[0].key)
        assert layout.route(edges[0]) == first
