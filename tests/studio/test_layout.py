"""Places of boxes and ways of edges, for graphs of all shapes."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations, count, pairwise
from random import Random
from time import process_time

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts.layout import Edge, Key, Layout, Spot, columns, meets
from aiorts.layout.detour import room
from aiorts.sessions import Entry
from aiorts_studio.watching.frames import frames_of
from aiorts_studio.watching.piles import placed
from aiorts_studio.watching.view import View, about
from campaign import CAMPAIGN

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
    for pile in {layout.pile_of(band) for band in layout.bands}:
        for above, below in pairwise(one for band, one in layout.bands.items() if layout.pile_of(band) == pile):
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
    layout.move({spots[0].key: (x, y)})
    check(layout, edges)
    assert all((one.x, one.y) == before[one.key] for one in spots[1:])


def test_a_wide_box_that_finds_room_far_to_the_right_overlaps_none_there() -> None:
    place = room(
        (320.0, 108.0),
        (0.0, 0.0),
        (0.0, 0.0, 2_000.0, 100.0 + 108.0),
        [(0.0, 0.0, 400.0, 300.0), (560.0, 0.0, 900.0, 300.0)],
    )
    assert place is None or place[0] + 320.0 <= 560.0 or place[0] >= 900.0


def test_boxes_that_are_moved_together_do_not_stand_in_the_way_of_one_another() -> None:
    layout, band = Layout(), ("band",)
    spots = [Spot((str(i),), band, ("in",), ("out",)) for i in range(3)]
    layout.place(spots, [], {band: "all"})
    places = {one.key: (one.x, one.y) for one in spots}
    turned = dict(zip(places, [*list(places.values())[1:], places["0",]], strict=True))
    layout.move(turned)
    check(layout, [])
    assert {one.key: (one.x, one.y) for one in spots} == turned


def test_a_box_stays_where_it_is_put_and_edges_go_round_it() -> None:
    spots, edges, groups = rows_of(1)
    band: Key = ("band", "0")
    spots += [Spot((f"more{n}",), band, ("in",), ("out",)) for n in range(4)]
    layout = Layout()
    layout.place(spots, edges, groups)
    writer, reader = spots[:2]
    between = (writer.x + writer.w + 40, writer.y + 9)
    layout.move({("more0",): between})  # into the channel that the edge takes
    moved = layout.spots["more0",]
    assert (moved.x, moved.y) == between
    check(layout, edges)
    layout.move({("more1",): (reader.x + 3, reader.y + 5)})  # upon another
    check(layout, edges)
    layout.move({reader.key: (reader.x + 60, reader.y + 37)})
    assert layout.route(edges[0]).points[-1] == (reader.x - 7, reader.y + reader.port_y("in", out=False))
    check(layout, edges)


def test_room_that_is_given_back_is_used_again() -> None:
    layout = Layout()
    spots = [Spot((str(i),), ("band",), ("in",), ("out",)) for i in range(3)]
    edges = [Edge((f"e{i}",), ("0",), "out", (str(i),), "in") for i in (1, 2)]
    layout.place(spots, edges, {("band",): "all"})
    first = layout.route(edges[0])
    for _ in range(50):
        layout.forget(edges[0].key)
        assert layout.route(edges[0]) == first


def test_a_graph_that_would_be_too_wide_goes_on_below() -> None:
    layout, band = Layout(), ("band",)
    spots = [Spot((str(i),), band, ("in",), ("out",)) for i in range(100)]
    edges = [Edge((f"e{i}",), (str(i),), "out", (str(i + 1),), "in") for i in range(99)]
    layout.place(spots, edges, {band: "all"})
    check(layout, edges)
    assert layout.right < 4_000
    assert max(one.column for one in spots) == 11
    assert [one.column for one in spots[:13]] == [*range(12), 0]
    assert spots[11].y < spots[12].y


def test_a_high_stack_of_a_wide_graph_takes_several_columns() -> None:
    layout, band = Layout(), ("band",)
    spots = [Spot((str(i),), band, ("in",), ("out",)) for i in range(60)]
    chain = [Edge((f"e{i}",), (str(i),), "out", (str(i + 1),), "in") for i in range(19)]
    edges = [*chain, *(Edge((f"s{i}",), ("0",), "out", (str(i),), "in") for i in range(20, 60))]
    layout.place(spots, edges, {band: "all"})
    check(layout, edges)
    stacked: dict[tuple[int, float], int] = {}
    for one in spots:
        stacked[one.column, one.x] = stacked.get((one.column, one.x), 0) + 1
    assert max(stacked.values()) < 12


def test_what_nothing_leads_to_stands_right_before_what_it_leads_to() -> None:
    assert columns(
        [("a",), ("b",), ("c",), ("late",)],
        [
            Edge(("1",), ("a",), "out", ("b",), "in"),
            Edge(("2",), ("b",), "out", ("c",), "in"),
            Edge(("3",), ("late",), "out", ("c",), "in"),
        ],
    ) == {("a",): 0, ("b",): 1, ("c",): 2, ("late",): 1}


def test_edges_side_by_side_have_tracks_of_their_own() -> None:
    layout, band = Layout(), ("band",)
    source = Spot(("s",), band, (), tuple(f"o{i}" for i in range(30)))
    sinks = [Spot((f"t{i}",), band, ("in",), ()) for i in range(30)]
    edges = [Edge((f"e{i}",), ("s",), f"o{i}", (f"t{29 - i}",), "in") for i in range(30)]
    layout.place([source, *sinks], edges, {band: "all"})
    check(layout, edges)
    downs = [
        (x, *sorted((y, v)))
        for route in map(layout.route, edges)
        for (x, y), (u, v) in pairwise(route.points)
        if x == u
    ]
    assert not [
        (one, other)
        for one, other in combinations(downs, 2)
        if one[0] == other[0] and one[1] < other[2] and other[1] < one[2]
    ]


@given(drawn())
@settings(max_examples=60, deadline=None)
def test_groups_stand_beside_one_another_and_nothing_overlaps(
    graph: tuple[list[Spot], list[Edge], dict[Key, str]],
) -> None:
    spots, edges, groups = graph
    layout = placed(spots, edges, groups, {group: group for group in groups.values()})
    check(layout, edges)
    for pile in range(max(layout.piles.values(), default=0)):
        assert max(right_of(one, layout) for one in spots if layout.pile_of(one.band) == pile) < min(
            one.x for one in spots if layout.pile_of(one.band) == pile + 1
        )


def right_of(spot: Spot, layout: Layout) -> float:
    assert spot.x + spot.w < layout.room_of(layout.pile_of(spot.band))[1]
    return spot.x + spot.w


@pytest.mark.parametrize("number", [1, 2, 3, 5, 9, 20])
def test_many_groups_have_about_the_proportions_of_a_screen(number: int) -> None:
    spots, edges, groups = rows_of(number)
    layout = placed(spots, edges, groups, {group: group for group in groups.values()})
    wide = max(one.x + one.w for one in spots)
    high = max(band.top + band.height for band in layout.bands.values())
    if number > 2:
        assert 0.6 < wide / high < 4
    check(layout, edges)


def test_what_belongs_together_stays_in_one_pile() -> None:
    spots, edges, groups = rows_of(6)
    units = {group: "this" if int(group) < 4 else "that" for group in groups.values()}
    layout = placed(spots, edges, groups, units)
    assert {layout.piles[group] for group, unit in units.items() if unit == "this"} == {0}
    assert {layout.piles[group] for group, unit in units.items() if unit == "that"} == {1}


def test_groups_stay_in_their_piles_unless_others_show_far_more() -> None:
    spots, edges, groups = rows_of(6)
    units = {group: group for group in groups.values()}
    before = placed(spots, edges, groups, units).piles
    assert len({*before.values()}) > 1
    spots, edges, groups = rows_of(7)
    units = {group: group for group in groups.values()}
    after = placed(spots, edges, groups, units, before).piles
    assert {group: after[group] for group in before} == before
    one = dict.fromkeys(before, 0)
    assert len({*placed(spots, edges, groups, units, one).piles.values()}) > 1
    few = {group: pile for group, pile in before.items() if pile}  # those of the first pile have gone
    spots = [spot for spot in spots if groups[spot.band] in few]
    edges = [edge for edge in edges if edge.key[0].removeprefix("e") in few]
    groups = {band: group for band, group in groups.items() if group in few}
    assert min(placed(spots, edges, groups, {group: group for group in few}, before).piles.values(), default=0) == 0


def test_edges_between_groups_lead_from_pile_to_pile() -> None:
    spots, edges, groups = rows_of(4)
    order = ("3", "1", "0", "2")
    edges += [Edge(("link", a, b), (f"reader{a}",), "out", (f"writer{b}",), "in") for a, b in pairwise(order)]
    layout = placed(spots, edges, groups, {group: group for group in groups.values()})
    piles = [layout.piles.get(group, 0) for group in order]
    assert piles == sorted(piles)
    check(layout, edges)


def test_a_box_more_in_a_pile_stays_left_of_the_next() -> None:
    spots, edges, groups = rows_of(6)
    layout = placed(spots, edges, groups, {group: group for group in groups.values()})
    band = next(one for one in groups if layout.pile_of(one) == 0)
    for number in range(9):
        spot = Spot((f"more{number}",), band, ("in",), ("out",))
        if not layout.add(spot, groups[band]):
            break
        assert right_of(spot, layout)
        check(layout, edges)


def rows_of(total: int) -> tuple[list[Spot], list[Edge], dict[Key, str]]:
    """As many groups, each of a writer and a reader."""
    spots, edges, groups = [], [], dict[Key, str]()
    for number in range(total):
        band: Key = ("band", str(number))
        groups[band] = str(number)
        spots += [Spot((f"{name}{number}",), band, ("in",), ("out",)) for name in ("writer", "reader")]
        edges.append(Edge((f"e{number}",), (f"writer{number}",), "out", (f"reader{number}",), "in"))
    return spots, edges, groups


def test_frames_of_kernels_beside_one_another_do_not_overlap() -> None:
    spots, edges, groups = rows_of(5)
    edges += [Edge((f"back{n}",), (f"reader{n}",), "out", (f"writer{n}",), "in") for n in range(5)]
    views = {str(n): View(str(n), f"host/k{n}", about(Entry(f"host/k{n}", n, "", ""))) for n in range(5)}
    spots = [replace(one, band=("band", *one.band[1:], "")) for one in spots]
    groups = {("band", group, ""): group for group in groups.values()}
    layout = placed(spots, edges, groups, {group: group for group in groups.values()})
    assert len({*layout.piles.values()}) > 1
    numbers = count()
    frames = frames_of(views, layout, [layout.route(one) for one in edges], lambda *_: next(numbers), ())
    kernels = [one for one in frames.values() if one["kind"] == "kernel"]
    assert len(kernels) == 5
    for one, other in combinations(kernels, 2):
        beside = one["x"] + one["w"] < other["x"] or other["x"] + other["w"] < one["x"]
        assert beside or one["y"] + one["h"] < other["y"] or other["y"] + other["h"] < one["y"]


@pytest.mark.parametrize("pile", [0, 1])
def test_boxes_of_a_pile_without_room_where_they_are_wished_stay(pile: int) -> None:
    layout = Layout()
    bands = [("left",), ("right",)]
    spots = [Spot((band[0], str(i)), band, ("in",), ("out",)) for band in bands for i in range(3)]
    layout.place(spots, [], {band: band[0] for band in bands}, {"left": 0, "right": 1})
    before = {one.key: (one.x, one.y) for one in spots}
    moved = {
        one.key: (one.x, layout.bands[one.band].top + 60.0 + i)
        for i, one in enumerate(spots)
        if one.band == bands[pile]
    }
    layout.move(moved)
    check(layout, [])
    assert {one.key: (one.x, one.y) for one in layout.spots.values() if one.band != bands[pile]} == {
        key: place for key, place in before.items() if key not in moved
    }
    assert layout.moved == moved


def kernels_of(number: int, each: int) -> tuple[list[Spot], list[Edge], dict[Key, str]]:
    """As many groups of five bands, each box with two edges to boxes not far behind it; a few lead to other groups."""
    chance = Random(1)
    bands: list[Key] = [("band", str(group), str(at)) for group in range(number) for at in range(5)]
    keys = [[(str(group), str(at)) for at in range(each)] for group in range(number)]
    spots = [
        Spot(key, bands[group * 5 + at * 5 // each], ("in0", "in1"), ("out0", "out1"), f"component{at}")
        for group, own in enumerate(keys)
        for at, key in enumerate(own)
    ]
    edges = []
    for name in range(2 * number * each):
        group, at = chance.randrange(number), chance.randrange(each - 1)
        there = group if chance.random() < 0.97 else chance.randrange(number)
        target = keys[there][min(each - 1, at + 1 + chance.randrange(40))]
        ports = f"out{chance.randrange(2)}", f"in{chance.randrange(2)}"
        edges.append(Edge((str(name),), keys[group][at], ports[0], target, ports[1]))
    return spots, edges, {band: band[1] for band in bands}


@pytest.mark.parametrize(("number", "each"), [(1, 9), (2, 30), (5, 20)])
def test_a_sketch_is_about_as_large_as_what_is_placed(number: int, each: int) -> None:
    spots, edges, groups = kernels_of(number, each)
    for piles in ({}, {str(group): group % 3 for group in range(number)} if number > 2 else {}):
        wide, high = Layout().sketch(spots, edges, groups, piles)
        layout = Layout()
        layout.place(spots, edges, groups, piles)
        assert wide == pytest.approx(layout.right, rel=0.2)
        assert high == max(band.top + band.height for band in layout.bands.values())


@pytest.mark.slow(kept_by="test_a_sketch_is_about_as_large_as_what_is_placed")
def test_a_thousand_boxes_in_five_kernels_are_laid_out_in_a_third_of_a_second() -> None:
    spots, edges, groups = kernels_of(5, 200)
    took = []
    for _ in range(3):
        began = process_time()
        layout = placed(spots, edges, groups, {group: group for group in groups.values()})
        routes = [layout.route(edge) for edge in edges]
        took.append(process_time() - began)
    print(f"1,000 boxes, 2,000 edges, 5 kernels: {min(took):.2f} s")
    assert min(took) < (0.5 if CAMPAIGN else 1.5)
    assert len({*layout.piles.values()}) > 1
    assert not [1 for route in routes[::50] for spot in spots if meets(route, spot)]
