"""In which order components end: held against what the words of the rule say, for any graph."""

from __future__ import annotations

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from aiorts.kernel.execution.ending_order import Edges, ending_order

NAMES = tuple("abcdefg")
edges = st.sets(st.tuples(st.sampled_from(NAMES), st.sampled_from(NAMES)), max_size=14)


def mapped(pairs: set[tuple[str, str]]) -> Edges:
    return {name: {after for before, after in pairs if before == name} for name in NAMES}


def reach(pairs: set[tuple[str, str]]) -> dict[str, set[str]]:
    """From each component, all that its edges lead to in one step or more."""
    found = {name: {after for before, after in pairs if before == name} for name in NAMES}
    for _ in NAMES:
        for name in NAMES:
            for one in tuple(found[name]):
                found[name] |= found[one]
    return found


@given(edges, edges)
def test_who_comes_first_ends_first_and_circles_end_in_the_reverse_order_of_the_start(
    calls: set[tuple[str, str]], data: set[tuple[str, str]]
) -> None:
    groups = ending_order(NAMES, mapped(calls), mapped(data))
    order = [name for group in groups for name in group]
    assert sorted(order) == sorted(NAMES)
    place = {name: index for index, name in enumerate(order)}
    far, called = reach(calls | data), reach(calls)
    for group in groups:
        assert len(group) == 1 or all(other in called[one] for one in group for other in group)
    for one in NAMES:
        for other in NAMES:
            in_circle = one in far[other] and other in far[one]
            if other in far[one] and not in_circle:
                assert place[one] < place[other]
            elif other in called[one] and one not in called[other]:
                assert place[one] < place[other]  # calls are ordered within a circle of data, too
            elif one != other and other in called[one] and one in called[other] and one < other:
                assert place[other] < place[one]


def test_without_edges_it_is_the_reverse_order_of_the_start() -> None:
    assert ending_order(NAMES, {}, {}) == [[name] for name in reversed(NAMES)]
    assert ending_order((), {}, {}) == []


def test_a_circle_of_data_ends_before_the_logger_behind_it() -> None:
    loop = {"pid": ["plant", "log"], "plant": ["pid"]}
    for names in (["log", "pid", "plant"], ["pid", "plant", "log"], ["plant", "log", "pid"]):
        assert ending_order(names, {}, loop)[-1] == ["log"]


def test_a_chain_of_many_components_is_ordered_without_recursion() -> None:
    names = [f"c{number}" for number in range(10_000)]
    chain = {name: [after] for name, after in pairwise(names)}
    assert ending_order(list(reversed(names)), chain, {}) == [[name] for name in names]
