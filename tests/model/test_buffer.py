"""The reference buffer: what a full one does, and a ledger that balances after anything."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aiorts.model.buffer import FullPolicy, Verdict, decide
from reference_buffer import DROP_REASONS, Buffer


@pytest.mark.row(41)
@pytest.mark.parametrize(
    ("full", "verdict", "left", "dropped"),
    [
        (FullPolicy.OVERWRITE, Verdict.REPLACE_OLDEST, [2, 3], {"overwritten": 1}),
        (FullPolicy.REJECT, Verdict.REFUSE, [1, 2], {"rejected": 1}),
        (FullPolicy.BLOCK, Verdict.WAIT, [1, 2], {}),
    ],
)
def test_a_full_buffer_does_what_its_policy_says(
    full: FullPolicy, verdict: Verdict, left: list[int], dropped: dict[str, int]
) -> None:
    buffer: Buffer[int] = Buffer(2, full)
    assert [buffer.offer(1), buffer.offer(2)] == [Verdict.STORE, Verdict.STORE]
    assert buffer.offer(3) is verdict
    assert list(buffer.samples) == left
    assert buffer.dropped == dropped
    assert buffer.written == (2 if verdict is Verdict.WAIT else 3)
    assert buffer.balanced


@given(length=st.integers(1, 100), buffered=st.integers(0, 100), full=st.sampled_from(FullPolicy))
def test_a_sample_is_stored_exactly_when_there_is_room(length: int, buffered: int, full: FullPolicy) -> None:
    assert (decide(buffered, length, full) is Verdict.STORE) == (buffered < length)


def test_the_newest_supersedes_what_is_older() -> None:
    buffer: Buffer[int] = Buffer(4)
    for number in range(4):
        buffer.offer(number)
    assert buffer.take() == 0
    assert buffer.take_newest() == 3
    assert buffer.dropped == {"superseded": 2}
    assert buffer.delivered == 2
    assert buffer.balanced
    with pytest.raises(IndexError):
        buffer.take()
    with pytest.raises(IndexError):
        buffer.take_newest()


STEPS = st.one_of(
    st.integers(0, 1_000).map(lambda sample: ("offer", sample)),
    st.sampled_from([("take", 0), ("take_newest", 0), ("discard", 0)]),
)


@pytest.mark.slow(kept_by="test_a_sample_is_stored_exactly_when_there_is_room")
@pytest.mark.row(60)
@given(length=st.integers(1, 5), full=st.sampled_from(FullPolicy), steps=st.lists(STEPS, max_size=60))
def test_the_ledger_balances_after_every_step(length: int, full: FullPolicy, steps: list[tuple[str, int]]) -> None:
    buffer: Buffer[int] = Buffer(length, full)
    for step, sample in steps:
        if step == "offer":
            buffer.offer(sample)
        elif step == "discard":
            buffer.discard("inactive")
        elif buffer.samples:
            getattr(buffer, step)()
        assert buffer.balanced
        assert len(buffer.samples) <= length
        assert set(buffer.dropped) <= set(DROP_REASONS)
