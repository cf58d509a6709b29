"""The two ends of a link: whatever a transport does, each sample is there once, in order, and accounted for."""

from __future__ import annotations

from collections.abc import Sequence
from random import Random
from typing import Any

import pytest
from hypothesis import find, given, settings
from hypothesis import strategies as st

from aiorts.model.links import Buffer, LinkState, ReaderEnd, WriterEnd, frames
from campaign import cases
from links.link_pair import MS, Pair


def finish(pair: Pair) -> None:
    """Let a pair settle on a good transport."""
    pair.loss = pair.double = pair.jitter_ms = 0
    pair.buffer = 10**9
    if not pair.up:
        pair.connect()
    pair.step(pair.now + 20_000 * MS)


def schedule(seed: int) -> Pair:
    """One random run of writes, faults, cuts and stops."""
    random = Random(seed)
    pair = Pair(
        seed,
        loss=random.choice((0, 0.05, 0.3)),
        double=random.choice((0, 0.2)),
        jitter_ms=random.choice((0, 5, 40)),
        window=random.choice((1, 2, 16, 256)),
        alone=random.choice((0, 0.5, 1)),
    )
    pair.rejects = random.choice((0, 0, 0.1))
    pair.connect()
    value = 0
    for _ in range(random.randrange(5, 40)):
        act = random.randrange(10)
        if act < 6 and random.random() < pair.alone:
            value += pair.offer_all(value, random.randrange(1, 40), confirm=random.random() < 0.1)
        elif act < 6:
            for _ in range(random.randrange(1, 40)):
                value += pair.offer(value, confirm=random.random() < 0.1)
        elif act == 6 and pair.up:
            pair.cut()
        elif act == 7 and not pair.up:
            pair.connect()
        elif act == 8:
            pair.buffer = random.choice((0, 3, 10**9))
        pair.step(pair.now + random.randrange(1, 300) * MS)
    finish(pair)
    return pair


def check(pair: Pair) -> None:
    taken = [value for value, fate in zip(pair.offered, pair.fates, strict=True) if fate == "acknowledged"]
    assert pair.seen == taken
    assert set(pair.fates) <= {"acknowledged", "rejected"}
    assert pair.writer.ledger.in_flight == 0
    assert pair.unexplained == 0


@pytest.mark.fault("E08")
def test_each_sample_is_there_once_in_order_and_accounted_for() -> None:
    for seed in range(cases(10_000)):
        check(schedule(seed))


ACTS = st.lists(
    st.sampled_from(["write", "write", "lose", "keep", "double", "once", "cut", "connect", "stop", "go", "wait"]),
    max_size=40,
)
"""Schedules as hypothesis draws them: of one that fails it finds the shortest."""


def play(
    acts: list[str], seed: int, *, writer: type[WriterEnd] = WriterEnd, reader: type[ReaderEnd] = ReaderEnd
) -> None:
    """Let a pair of these ends go through a schedule, and check it."""
    pair = Pair(seed, window=4, jitter_ms=3, alone=0.5)
    pair.writer, pair.reader = writer(7, 1_000, window=4), reader(7, 2_000, window=4)
    pair.connect()
    value = 0
    for act in acts:
        match act:
            case "write":
                value += pair.offer(value)
            case "lose" | "keep":
                pair.loss = float(act == "lose")
            case "double" | "once":
                pair.double = float(act == "double")
            case "cut" if pair.up:
                pair.cut()
            case "connect" if not pair.up:
                pair.connect()
            case "stop":
                pair.buffer = 0
            case "go":
                pair.buffer = 10**9
            case "wait":
                pair.step(pair.now + 250 * MS)
        assert pair.unexplained == 0
    finish(pair)
    check(pair)


@settings(deadline=None, max_examples=70)
@given(ACTS, st.integers(0, 2**16))
def test_any_order_of_faults_leaves_nothing_unexplained(acts: list[str], seed: int) -> None:
    play(acts, seed)


class Twice(ReaderEnd):
    """Broken: gives out again what has come before."""

    def receive(self, now: int, head: Buffer, parts: Sequence[Buffer] = ()) -> None:
        if head[0] == frames.DATA and frames.head_of(head, self.number)[3] <= self._received:
            self._received = frames.head_of(head, self.number)[3] - 1
        super().receive(now, head, parts)


class Forgetful(ReaderEnd):
    """Broken: loses at a cut what waits for room, and acknowledges it."""

    def channel_down(self, now: int) -> None:
        while (sample := self.take()) is not None:
            self.done(now, sample[0])
        super().channel_down(now)


class Impatient(WriterEnd):
    """Broken: takes a sample for acknowledged as soon as it has come."""

    def _acknowledge(self, now: int, done: int, received: int, fates: dict[int, str]) -> None:
        super()._acknowledge(now, received, received, fates)


@pytest.mark.slow(kept_by="test_any_order_of_faults_leaves_nothing_unexplained")
@pytest.mark.parametrize("broken", [{"reader": Twice}, {"reader": Forgetful}, {"writer": Impatient}])
def test_a_schedule_that_fails_shrinks_to_ten_events(broken: dict[str, Any]) -> None:
    def fails(example: tuple[list[str], int]) -> bool:
        try:
            play(*example, **broken)
        except (AssertionError, ValueError, KeyError):
            return True
        return False

    acts, seed = find(
        st.tuples(ACTS, st.integers(0, 2**16)),
        fails,
        settings=settings(deadline=None, max_examples=500, database=None, derandomize=True),
    )
    assert 0 < len(acts) <= 10, acts
    play(acts, seed)  # whole ends pass it


@pytest.mark.parametrize("seed", range(20))
def test_a_new_reader_makes_what_was_unacknowledged_of_unknown_fate_and_goes_on(seed: int) -> None:
    pair = Pair(seed, loss=0.1, jitter_ms=10, alone=0.5)
    pair.connect()
    random = Random(seed)
    for value in range(200):
        while not pair.offer(value):
            pair.step(pair.now + 5 * MS)
        if value in (60, 130):
            pair.step(pair.now + random.randrange(20) * MS)
            before = list(pair.seen)
            pair.restart_reader()
            pair.connect()
            assert pair.seen == before
    finish(pair)
    assert len(pair.fates) == 200
    assert set(pair.fates) <= {"acknowledged", "unknown_fate"}
    kept = [value for value, fate in enumerate(pair.fates) if fate == "acknowledged"]
    assert sorted(set(pair.seen)) == pair.seen  # each at most once, in order
    assert set(kept) <= set(pair.seen)
    assert pair.seen[-1] == 199


def test_the_newest_is_never_stranded_with_a_window_of_two() -> None:
    pair = Pair(3, loss=0.5, jitter_ms=30, window=2)
    pair.connect()
    newest = 0
    for value in range(300):
        if pair.offer(value):
            newest = value
        pair.step(pair.now + 10 * MS)
    finish(pair)
    assert pair.seen[-1] == newest


@pytest.mark.fault("E07")
@pytest.mark.parametrize("window", [2, 256])
def test_how_long_a_slow_way_takes_is_learnt_and_then_nothing_is_sent_twice(window: int) -> None:
    pair = Pair(0, delay_ms=300, window=window)
    pair.connect()
    for value in range(50):
        pair.offer(value, confirm=True)
        pair.step(pair.now + 100 * MS)
    before = pair.writer.ledger.sent_again
    for value in range(50, 300):
        pair.offer(value, confirm=True)
        pair.step(pair.now + 100 * MS)
    assert pair.writer.ledger.sent_again == before
    assert len(pair.seen) > 40


def test_the_first_sample_of_an_idle_link_leaves_at_once_and_an_idle_link_says_nothing() -> None:
    pair = Pair(0)
    pair.connect()
    pair.step(pair.now + 100 * MS)
    before = pair.frames
    pair.offer(1)
    began = pair.now
    pair.step(pair.now + MS)
    assert pair.seen == [1]
    assert pair.now - began == MS  # the time of one way
    pair.step(pair.now + 100 * MS)
    assert pair.frames - before == 2  # the sample and its acknowledgement
    pair.step(pair.now + 60_000 * MS)
    assert pair.frames - before == 2
    assert pair.writer.poll(pair.now, pair.send(pair.writer)) is None
    assert pair.reader.poll(pair.now, pair.send(pair.reader)) is None


@pytest.mark.parametrize("alone", [0, 1])
def test_a_sample_that_is_to_be_confirmed_is_acknowledged_at_once_and_others_within_50_ms(alone: int) -> None:
    pair = Pair(0, alone=alone)
    pair.connect()
    pair.step(pair.now + 100 * MS)
    for confirm, least, most in ((True, 2, 3), (False, 50, 53)):
        began, count = pair.now, len(pair.fates)
        pair.offer(1, confirm=confirm)
        while len(pair.fates) == count:
            pair.step(pair.now + MS)
        assert least * MS <= pair.now - began <= most * MS


@pytest.mark.fault("E06")
def test_a_reader_without_room_stops_the_writer_and_loses_nothing() -> None:
    pair = Pair(0, window=8)
    pair.connect()
    pair.buffer = 0
    pair.step(pair.now + 10 * MS)
    taken = sum(pair.offer(value) for value in range(100))
    pair.step(pair.now + 10_000 * MS)
    assert taken == 8
    assert pair.writer.room == 0
    assert pair.writer.ledger.sent_again == 0  # it has them: nothing is sent again
    assert pair.writer.state(pair.now) is LinkState.STALLED
    pair.buffer = 100
    pair.step(pair.now + 100 * MS)
    assert pair.seen == list(range(8))
    assert pair.writer.state(pair.now) is LinkState.UP


def test_a_window_is_also_one_of_bytes() -> None:
    writer, reader = WriterEnd(1, 1, window_bytes=1000), ReaderEnd(1, 2)
    writer.channel_up(0, 2)
    reader.channel_up(0, 1)
    large = memoryview(bytes(1500))
    assert writer.room == 256
    writer.offer(0, b"x", (large,))
    assert writer.room == 0


def test_a_large_sample_is_not_kept_until_there_are_many() -> None:
    pair = Pair(0)
    pair.connect()
    pair.step(pair.now + 10 * MS)
    for size, kept in ((1 << 10, 1), (1 << 20, 0)):
        pair.writer.offer(pair.now, (0).to_bytes(4, "little"), (memoryview(bytes(size)),))
        pair.step(pair.now + 10 * MS)
        assert pair.writer.ledger.in_flight == kept


@pytest.mark.slow
@settings(deadline=None, max_examples=300)
@given(st.binary(max_size=80), st.integers(0, 5))
def test_no_bytes_of_a_peer_do_harm(frame: bytes, place: int) -> None:
    pair = Pair(0)
    pair.connect()
    pair.step(pair.now + 10 * MS)
    pair.offer(1)
    head = bytes((place + 1, 0)) + frame[:2].ljust(2, b"\0") + (7).to_bytes(4, "little")
    for data in (frame, head + frame[2:]):
        pair.writer.receive(pair.now, memoryview(data))
        pair.reader.receive(pair.now, memoryview(data))
    assert pair.reader.held <= 32
    assert pair.unexplained == 0 or pair.reader.ledger.received > 0


def test_frames_of_another_link_are_none() -> None:
    pair = Pair(0)
    pair.connect()
    pair.step(pair.now + 10 * MS)
    pair.writer.renumber(8)
    pair.offer(1)
    pair.step(pair.now + 100 * MS)
    assert pair.seen == []
    assert pair.reader.ledger.bad_frames > 0


def test_who_is_disconnected_says_so() -> None:
    pair = Pair(0)
    pair.connect()
    pair.step(pair.now + 10 * MS)
    pair.offer(1)
    pair.step(pair.now + 2 * MS)
    pair.offer(2)
    pair.writer.end(pair.now, pair.send(pair.writer))
    pair.step(pair.now + 10 * MS)
    assert pair.reader.peer_ended
    assert pair.reader.state(pair.now) is LinkState.ENDED
    assert pair.fates == ["unknown_fate", "disconnected"]


def test_a_silent_reader_makes_the_link_stalled_and_is_asked_ever_more_seldom() -> None:
    writer, reader = WriterEnd(1, 7), ReaderEnd(1, 9)
    writer.channel_up(0, 9)
    reader.channel_up(0, 7)
    reader.poll(0, lambda head, parts: (writer.receive(0, head), True)[1])
    writer.offer(0, b"one")
    due: list[int] = []
    now: int | None = 0
    while now is not None and now < 6_000 * MS:
        due.append(now // MS)
        now = writer.poll(now, lambda head, parts: True)
    assert due == [0, 200, 600, 1400, 3000, 5000]
    assert writer.state(1_900 * MS) == LinkState.UP
    assert writer.state(2_100 * MS) == LinkState.STALLED


def test_a_long_reason_is_cut_between_letters() -> None:
    writer, reader = WriterEnd(1, 7), ReaderEnd(1, 9)
    writer.channel_up(0, 9)
    reader.channel_up(0, 7)
    reader.poll(0, lambda head, parts: (writer.receive(0, head), True)[1])
    writer.offer(0, b"one")
    writer.poll(0, lambda head, parts: (reader.receive(0, head, parts), True)[1])
    sample = reader.take()
    assert sample is not None
    reader.failed(0, sample[0], "\N{LATIN SMALL LETTER E WITH ACUTE}" * 200)
    reader.poll(60 * MS, lambda head, parts: (writer.receive(60 * MS, head), True)[1])
    assert writer.ledger.dropped == 1
    assert not writer.ledger.bad_frames


def test_a_writer_that_ignores_the_window_cannot_make_the_readers_end_hold_more_than_twice_of_it() -> None:
    writer, reader = WriterEnd(1, 1, window=10_000, window_bytes=1 << 30), ReaderEnd(1, 2, window_bytes=1 << 20)
    writer.channel_up(0, 2)
    reader.channel_up(0, 1)
    reader.poll(0, lambda head, parts: writer.receive(0, head) is None)
    part = memoryview(bytes(1 << 18))
    for _ in range(100):
        writer.offer(0, b"x", (part,))
    writer.poll(0, lambda head, parts: reader.receive(0, head, parts) is None)
    assert reader.held == 8  # of 256 KiB each, twice the window


def test_half_a_window_of_bytes_is_acknowledged_at_once() -> None:
    writer, reader = WriterEnd(1, 1), ReaderEnd(1, 2, window_bytes=1 << 20)
    writer.channel_up(0, 2)
    reader.channel_up(0, 1)
    reader.poll(0, lambda head, parts: writer.receive(0, head) is None)
    part, left = memoryview(bytes(1 << 18)), []
    for _ in range(2):
        writer.offer(0, b"x", (part,))
        writer.poll(0, lambda head, parts: reader.receive(0, head, parts) is None)
        reader.done(0, reader.take()[0])  # type: ignore[index] # it has come
        reader.poll(0, lambda head, parts: writer.receive(0, head) is None)
        left.append(writer.ledger.in_flight)
    assert left == [1, 0]


@pytest.mark.parametrize("window", [0, -1, 65_536])
@pytest.mark.parametrize("end", [WriterEnd, ReaderEnd])
def test_a_window_has_bounds(end: Any, window: int) -> None:
    end(1, 1, window=65_535)
    with pytest.raises(ValueError, match=r"window = .*: expected 1 to 65,535 samples"):
        end(1, 1, window=window)


@pytest.mark.slow
def test_the_widest_window_whose_samples_are_all_refused_is_acknowledged() -> None:
    writer, reader = WriterEnd(1, 1, window=65_535), ReaderEnd(1, 2, window=65_535)
    writer.channel_up(0, 2)
    reader.channel_up(0, 1)
    reader.poll(0, lambda head, parts: writer.receive(0, head) is None)
    for _ in range(65_535):
        writer.offer(0, b"")
    assert writer.room == 0
    writer.poll(0, lambda head, parts: reader.receive(0, head, parts) is None)
    while (sample := reader.take()) is not None:
        reader.failed(0, sample[0], "rejected")
    reader.poll(0, lambda head, parts: writer.receive(0, head) is None)
    assert (writer.ledger.dropped, writer.ledger.in_flight) == (65_535, 0)


def test_sent_again_counts_the_samples_that_the_channel_took_again() -> None:
    writer, reader = WriterEnd(1, 1), ReaderEnd(1, 2)
    writer.channel_up(0, 2)
    reader.channel_up(0, 1)
    reader.poll(0, lambda head, parts: writer.receive(0, head) is None)
    for _ in range(3):
        writer.offer(0, b"x")
    writer.poll(0, lambda head, parts: True)  # lost
    assert writer.ledger.sent_again == 0
    writer.offer(0, b"y")
    writer.poll(300 * MS, lambda head, parts: False)  # no room
    assert writer.ledger.sent_again == 0
    writer.poll(400 * MS, lambda head, parts: True)
    assert writer.ledger.sent_again == 3


def test_the_writers_end_knows_what_was_lost_behind_the_reader_end() -> None:
    pair = Pair(0)
    pair.connect()
    pair.step(pair.now + 10 * MS)
    for losses in ({"overwritten": 3}, {"overwritten": 5, "expired": 1}):
        pair.reader.lost(losses)
        pair.step(pair.now + 10 * MS)
        assert pair.writer.lost == losses
    before = pair.frames
    pair.reader.lost({"overwritten": 5, "expired": 1})
    pair.step(pair.now + 10 * MS)
    assert pair.frames == before  # it is said once
    assert (pair.writer.ledger.bad_frames, pair.reader.ledger.bad_frames) == (0, 0)


def test_losses_of_reasons_that_are_not_known_count_together_and_of_too_many_not_at_all() -> None:
    pair = Pair(0)
    pair.connect()
    pair.writer.receive(0, frames.lost(7, pair.reader.epoch, {"mine": 2, "yours": 3, "expired": 1}))
    assert pair.writer.lost == {"refused": 5, "expired": 1}
    pair.writer.receive(0, frames.lost(7, pair.reader.epoch, {f"reason {number}": 1 for number in range(100)}))
    pair.writer.receive(0, frames.lost(7, pair.reader.epoch + 1, {"expired": 9}))
    assert (pair.writer.lost, pair.writer.ledger.bad_frames) == ({"refused": 5, "expired": 1}, 2)


def test_the_window_is_narrow_until_the_reader_has_kept_up_and_again_when_it_does_not() -> None:
    pair = Pair(0, window=256)
    pair.writer = WriterEnd(7, 1_000, window=256, least=8)
    pair.connect()
    pair.step(pair.now + 10 * MS)
    rooms = []
    for _ in range(7):
        rooms.append(pair.writer.room)
        for value in range(rooms[-1]):
            pair.offer(value)
        pair.step(pair.now + 60 * MS)
    assert rooms == [8, 16, 32, 64, 128, 256, 256]
    pair.buffer = 0
    for value in range(100):
        pair.step(pair.now + 20 * MS)
        if value < 20 or pair.writer.room:
            pair.offer(value)
    assert pair.writer.room == 0
    assert pair.writer.ledger.in_flight < 16
