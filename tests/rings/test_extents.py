"""Bytes of a ring are never taken twice, and come back whole, in whatever order."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from aiorts.rings.extents import STEP, Extents

SIZE = 64 * STEP

actions = st.lists(
    st.one_of(
        st.tuples(st.just("take"), st.integers(1, 20 * STEP)),
        st.tuples(st.just("claim"), st.tuples(st.integers(-STEP, SIZE + STEP), st.integers(1, 20 * STEP))),
        st.tuples(st.just("give"), st.integers(0, 63)),
    ),
    max_size=40,
)


@given(actions)
def test_extents_are_as_a_map_of_bytes(actions: list[tuple[str, object]]) -> None:
    """The model: one flag for each step of the stretch."""
    extents, used = Extents(SIZE), [False] * 64
    taken: dict[int, int] = {}

    def free_at(start: int, steps: int) -> bool:
        return start >= 0 and start + steps <= 64 and not any(used[start : start + steps])

    for what, value in actions:
        if what == "give":
            assert isinstance(value, int)
            steps = taken.pop(value, 0)
            assert extents.give(value * STEP) is bool(steps)
            used[value : value + steps] = [False] * steps
            continue
        if what == "take":
            assert isinstance(value, int)
            steps = -(-value // STEP)
            first = next((start for start in range(64) if free_at(start, steps)), None)
            assert extents.take(value) == (None if first is None else first * STEP)
        else:
            assert isinstance(value, tuple)
            start, length = value
            steps = -(-length // STEP)
            first = start // STEP if start % STEP == 0 and free_at(start // STEP, steps) else None
            assert extents.claim(start, length) is (first is not None)
        if first is not None:
            taken[first] = steps
            used[first : first + steps] = [True] * steps
        assert extents.count == len(taken)
    for start in taken:
        assert extents.give(start * STEP)
    assert extents.take(SIZE) == 0


def test_what_was_used_last_is_used_again() -> None:
    extents = Extents(SIZE)
    assert [extents.take(STEP), extents.take(1), extents.take(STEP + 1)] == [0, STEP, 2 * STEP]
    assert extents.give(STEP)
    assert not extents.give(STEP)
    assert extents.take(STEP) == STEP
