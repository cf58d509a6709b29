"""Two windows of one system, compared as a plain model of the rule compares them."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from types import MappingProxyType
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aiorts.model.health.verdict import verdict
from aiorts.model.health.windows import ContextCounts, EdgeCounts, Window, context_since, edge_since

S = 1_000_000_000
NAMES = ("a.out-b.in", "b.out-c.in", "c.out-d.in")


def edge(written: int, dropped: int = 0, name: str = "a.out-b.in") -> dict[str, EdgeCounts]:
    source, _, target = name.partition("-")
    return {name: EdgeCounts(source, target, written, dropped)}


def window(seconds: float = 1.0, edges: dict[str, EdgeCounts] | None = None, **more: Any) -> Window:
    return Window(int(seconds * S), MappingProxyType(edges or {}), **more)


def loop(ticks: int, overruns: int = 0, **more: Any) -> dict[str, ContextCounts]:
    return {"loop": ContextCounts(ticks, overruns, **more)}


def said(before: Window, after: Window, new: tuple[str, ...] = ()) -> tuple[str, str] | None:
    found = verdict(before, after, new)
    return None if found is None else (found.what, found.name)


counts = st.tuples(st.integers(0, 400), st.integers(0, 400)).map(lambda pair: (max(pair), min(pair)))
windows = st.builds(
    window,
    st.sampled_from((0.0, 0.5, 1.0, 5.0)),
    st.dictionaries(st.sampled_from(NAMES), counts, max_size=3).map(
        lambda found: {
            key: one for name, (written, dropped) in found.items() for key, one in edge(written, dropped, name).items()
        }
    ),
    contexts=st.dictionaries(st.sampled_from(("x", "y")), counts, max_size=2).map(
        lambda found: {name: ContextCounts(*pair) for name, pair in found.items()}
    ),
    errors=st.dictionaries(st.sampled_from("abc"), st.just("OSError: gone"), max_size=2),
)


def model(before: Window, after: Window, new: frozenset[str]) -> set[tuple[str, str]]:
    """Everything that is worse, each by the words of the rule, in exact numbers, as rates."""
    found = {("error", name) for name in after.errors if name in new or name not in before.errors}
    if not after.length_ns:
        return found
    for what, now, then, of, lost in (
        ("overruns", after.contexts, before.contexts, "ticks", "overruns"),
        ("drops", after.edges, before.edges, "written", "dropped"),
    ):
        for name, one in now.items():
            if getattr(one, of) < 50:
                continue
            rate = Fraction(getattr(one, lost), after.length_ns)
            rate_before = Fraction(0)
            if name in then and before.length_ns:
                rate_before = Fraction(getattr(then[name], lost), before.length_ns)
            if rate > 2 * rate_before + Fraction(getattr(one, of), 100 * after.length_ns):
                found.add((what, name))
    for name, one in after.edges.items():
        if name not in before.edges or not before.length_ns or before.edges[name].written < 50:
            continue
        then_rate = Fraction(before.edges[name].written, before.length_ns)
        if then_rate * after.length_ns >= 50 and Fraction(one.written, after.length_ns) < then_rate * 4 / 5:
            found.add(("rate", name))
    return found


@pytest.mark.slow
@given(windows, windows, st.frozensets(st.sampled_from("abc")))
def test_it_is_worse_exactly_where_the_rule_says_so(before: Window, after: Window, new: frozenset[str]) -> None:
    fed = {one.target for one in after.edges.values()}
    if any(one.target not in fed for one in before.edges.values()):
        return  # less is expected downstream: below
    worse = model(before, after, new)
    found = said(before, after, tuple(new))
    assert (found is None) == (not worse)
    assert found is None or found in worse


@pytest.mark.slow
@given(windows, windows, st.integers(2, 5))
def test_a_longer_window_with_the_same_rates_is_judged_the_same(before: Window, after: Window, times: int) -> None:
    longer = replace(
        before,
        length_ns=before.length_ns * times,
        edges={
            name: one._replace(written=one.written * times, dropped=one.dropped * times)
            for name, one in before.edges.items()
        },
        contexts={
            name: ContextCounts(one.ticks * times, one.overruns * times) for name, one in before.contexts.items()
        },
    )
    if all(not 50 <= one.written * times < 50 * times for one in before.edges.values()):
        assert verdict(before, after) is None or said(longer, after) == said(before, after)


@given(windows)
def test_the_same_again_is_healthy(one: Window) -> None:
    assert verdict(one, one) is None


def test_the_figure_and_the_edge_are_named() -> None:
    before, after = window(1.0, edge(100, 20)), window(2.0, edge(200, 120))
    assert str(verdict(before, after)) == ("a.out-b.in: 120 of 200 samples were dropped in 2 s, and 20 of 100 before")
    assert str(verdict(window(1.0, edge(100)), window(2.0, edge(100)))) == (
        "a.out-b.in: 50 samples a second, and 100 before"
    )
    assert str(verdict(window(contexts=loop(100)), window(contexts=loop(100, 40)))) == (
        "loop: 40 of 100 ticks overran in 1 s, and 0 of 100 before"
    )
    assert str(verdict(window(), window(errors={"b": "ValueError: no"}))) == "b: in error: ValueError: no"


def test_fewer_than_50_samples_decide_nothing() -> None:
    assert said(window(1, edge(49)), window(1, edge(49, 49))) is None
    assert said(window(1, edge(50)), window(1, edge(50, 50))) == ("drops", NAMES[0])
    assert said(window(1, edge(49)), window(1, edge(0))) is None
    assert said(window(1, edge(50)), window(1, edge(0))) == ("rate", NAMES[0])
    assert said(window(contexts=loop(49)), window(contexts=loop(49, 49))) is None


def test_an_edge_that_there_was_not_may_drop_one_sample_of_100() -> None:
    assert said(window(), window(1, edge(100, 1))) is None
    assert said(window(), window(1, edge(100, 2))) == ("drops", NAMES[0])
    assert said(window(1, edge(100)), window()) is None


def test_a_component_that_was_in_error_before_is_no_worse_unless_it_was_replaced() -> None:
    failed = window(errors={"b": "OSError"})
    assert said(failed, failed) is None
    assert said(failed, failed, ("b",)) == ("error", "b")


def test_overruns_that_the_machine_is_to_blame_for_do_not_count() -> None:
    before = window(contexts=loop(100, 30, by_machine=30))
    assert said(before, window(contexts=loop(100, 40, by_machine=39))) is None
    assert said(before, window(contexts=loop(100, 40, by_machine=38))) == ("overruns", "loop")


def test_a_rate_is_not_lower_for_what_the_machine_has_kept_from_running() -> None:
    before = window(1, edge(100), contexts=loop(100, members=("a",)))
    stopped = window(1, edge(60), contexts=loop(100, 5, by_machine=5, left_out=40, members=("a",)))
    assert said(before, stopped) is None
    assert said(before, replace(stopped, edges=edge(40))) == ("rate", NAMES[0])


def test_where_the_machine_took_more_than_before_as_much_more_is_no_fault() -> None:
    before = window(1, edge(100), contexts=loop(100), stalled=0.2)
    assert said(before, window(1, edge(60), stalled=0.35)) is None
    assert said(before, window(1, edge(60), stalled=0.3)) == ("rate", NAMES[0])
    assert said(replace(before, stalled=0.5), window(1, edge(60), stalled=0.5)) == ("rate", NAMES[0])
    assert said(replace(before, stalled=0.6), window(1, edge(60), stalled=0.6)) is None
    for lost, found in ((25, False), (27, True)):
        late = said(before, window(1, contexts=loop(100, lost), stalled=0.45))
        assert (late == ("overruns", "loop")) is found
        gone = said(before, window(1, edge(100, lost), stalled=0.45))
        assert (gone == ("drops", NAMES[0])) is found
        assert said(before, window(1, edge(100, lost), stalled=0.1)) == ("drops", NAMES[0])
        paced = window(1, edge(100, lost), contexts=loop(100, paced=True, members=("a",)), stalled=0.45)
        assert said(before, paced) == ("drops", NAMES[0])
        assert said(before, replace(paced, edges=edge(100, 3))) is None


def test_a_rate_that_was_lowered_is_expected_downstream() -> None:
    chain = {**edge(100), **edge(100, 0, NAMES[1]), **edge(100, 0, NAMES[2])}
    half = {name: one._replace(written=50) for name, one in chain.items()}
    before = window(1, chain, contexts=loop(100, rate=100.0, members=("a",)))
    after = window(1, half, contexts=loop(50, rate=50.0, members=("a",)))
    assert said(before, after) is None
    assert said(before, replace(after, contexts=loop(50, rate=100.0, members=("a",)))) == ("rate", NAMES[0])
    twice = replace(before, edges={name: one._replace(written=200) for name, one in chain.items()})
    slower = {**{name: one._replace(written=100) for name, one in chain.items()}, **edge(60, 0, NAMES[2])}
    assert said(twice, replace(after, edges=slower)) == ("rate", NAMES[2])


def test_nothing_is_expected_of_what_is_not_active_or_not_fed_any_more() -> None:
    chain = {**edge(100), **edge(100, 0, NAMES[1])}
    none = {name: one._replace(written=0) for name, one in chain.items()}
    assert said(window(1, chain), window(1, none)) == ("rate", NAMES[0])
    assert said(window(1, chain), window(1, none, idle=frozenset("a"))) is None
    assert said(window(1, chain), window(1, edge(0, 0, NAMES[1]))) is None
    other = {**edge(100, 0, "x.out-b.in"), **edge(0, 0, NAMES[1])}
    assert said(window(1, chain), window(1, other)) == ("rate", NAMES[1])


def test_components_that_feed_each_other_are_looked_at_once() -> None:
    circle = {**edge(100), **edge(100, 0, "b.out-a.in")}
    slower = {name: one._replace(written=50) for name, one in circle.items()}
    before = window(1, circle, contexts=loop(100, rate=100.0, members=("a",)))
    assert said(before, window(1, slower, contexts=loop(50, rate=50.0, members=("a",)))) is None


@given(counts, counts)
def test_what_came_in_between_is_counted(start: tuple[int, int], more: tuple[int, int]) -> None:
    end = start[0] + more[0], start[1] + more[1]
    (found,) = edge(*more).values()
    assert edge_since(*edge(*start).values(), *edge(*end).values()) == found
    (ticks,) = loop(*more).values()
    assert context_since(*loop(*start).values(), *loop(*end).values()) == ticks


def test_what_was_made_in_between_counts_whole() -> None:
    (edge_was,), (edge_is,) = edge(100, 5).values(), edge(7, 1).values()
    assert edge_since(edge_was, edge_is) == edge_since(None, edge_is) == edge_is
    (was,), (now,) = loop(100, 5, by_machine=5).values(), loop(7, 1).values()
    assert context_since(was, now) == context_since(None, now) == now
