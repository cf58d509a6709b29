"""How much is under way to another host is bounded, whatever is sent; nothing waits for ever."""

from __future__ import annotations

from collections import deque

import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("zenoh")

from aiorts_zenoh.envelope import BATCH, FRAME, LONG, LOOK, PIECE, PIECES, Whole, cost, read
from aiorts_zenoh.sending import Budget, Budgets, Receiver, Sender


class Way:
    """One direction of a channel: what was sent and has not come, and what the receiver made of it."""

    def __init__(self, budget: Budget, put: list[bytes] | None = None) -> None:
        self.under_way: deque[bytes] = deque()
        self.put = [] if put is None else put
        self.rooms = 0
        self.sender = Sender(budget, self._put, 1, lambda: 0, self._on_room)
        self.receiver, self.whole = Receiver(budget, self.sender.came), Whole()
        self.came: list[bytes] = []

    def _put(self, data: bytes) -> None:
        self.under_way.append(data)
        self.put.append(data)

    def _on_room(self) -> None:
        self.rooms += 1

    def step(self, *, lost: bool = False) -> None:
        """Let the oldest message arrive, or lose it."""
        if not self.under_way:
            return
        data = self.under_way.popleft()
        if lost:
            return
        kind, _, first, _, blocks = read(data)
        if kind == LOOK:
            self.receiver.asked(first)
            return
        self.receiver.took(first, len(data))
        frame = blocks if kind == FRAME else self.whole.add(blocks)
        assert kind in (FRAME, PIECE)
        if frame:
            self.came.append(bytes(frame[0]))


def packed(sizes: list[int]) -> int:
    """How many batches of the engine such messages take up when nothing is written meanwhile, with their keys."""
    batches, room = 0, 0
    for size in (size + 300 for size in sizes):
        if size <= room:
            room -= size
        else:
            batches, room = batches + -(-size // BATCH), BATCH - size if size < BATCH else 0
    return batches


SIZES = st.lists(
    st.tuples(st.integers(0, 1), st.one_of(st.integers(0, PIECES), st.integers(0, 5 * LONG)), st.integers(0, 3)),
    max_size=60,
)


@pytest.mark.slow
@given(SIZES)
def test_less_than_a_queue_is_under_way_and_all_comes_in_order(steps: list[tuple[int, int, int]]) -> None:
    budget, put = Budget(), []  # type: Budget, list[bytes]
    ways, sent = (Way(budget, put), Way(budget, put)), ([], [])  # type: tuple[Way, Way], tuple[list[bytes], list[bytes]]
    for number, (which, size, arrive) in enumerate(steps):
        frame = number.to_bytes(4, "little") + bytes(size)
        if ways[which].sender.send([frame]):
            sent[which].append(frame)
        under_way = [len(data) for data in put if any(data is one for way in ways for one in way.under_way)]
        assert packed(under_way) <= (16 if max(under_way, default=0) <= 15 * BATCH else 18)
        for way in ways[:arrive]:
            way.step()
        budget.pump()
    for _ in range(10_000):
        if not any(way.under_way for way in ways):
            break
        for way in ways:
            way.step()
        budget.pump()
        if not budget.has_room:
            budget.look()
    assert (ways[0].came, ways[1].came) == sent


def test_what_a_lost_message_took_up_is_free_again() -> None:
    way = Way(budget := Budget())
    while budget.has_room:
        way.sender.send([bytes(PIECES // 2)])
    way.sender.send([b"last"])
    while way.under_way:
        way.step(lost=True)
    budget.look_again()
    way.step()
    budget.pump()
    way.step()
    assert way.came == [b"last"]


def test_what_others_were_silent_about_has_one_long_frame_cut_and_no_more() -> None:
    budget = Budget()
    large, others = Way(budget), [Way(budget) for _ in range(3)]
    for way in others:
        for _ in range(300):
            way.sender.send([bytes(30)])
            way.step()
    messages = []
    for _ in range(2):
        assert large.sender.send([bytes(1 << 20)])
        messages.append(len(large.under_way))
        for way in (large, *others):
            while way.under_way:
                way.step()
                budget.pump()
    assert messages[0] > 1
    assert messages[1] == 1


def test_a_channel_that_closes_leaves_its_share_to_the_others() -> None:
    budget = Budget()
    one, other = Way(budget), Way(budget)
    while budget.has_room:
        one.sender.send([bytes(PIECES // 2)])
    assert other.sender.send([b"waits"])
    one.sender.close()
    budget.pump()
    other.step()  # what looked how far it is
    other.step()
    assert (budget.has_room, other.came) == (True, [b"waits"])


def test_too_much_that_waits_is_refused_until_half_of_it_is_gone() -> None:
    way = Way(budget := Budget())
    sent = 0
    while way.sender.send([bytes(PIECES // 2)]):
        sent += 1
        assert sent < 100
    assert not way.sender.room_made()
    for _ in range(200):
        way.step()
        budget.pump()
        if not budget.has_room:
            budget.look()
    assert (way.sender.room_made(), way.sender.room_made(), len(way.came)) == (True, False, sent)


def test_of_many_channels_those_that_have_refused_are_told_of_room_once() -> None:
    budget = Budget()
    ways = [Way(budget) for _ in range(20)]
    full = ways[3], ways[7]
    for way in full:
        while way.sender.send([bytes(PIECES // 2)]):
            pass
    budget.tell_room()
    assert [way.rooms for way in full] == [0, 0]
    ways[7].sender.close()
    for _ in range(200):
        ways[3].step()
        budget.pump()
        if not budget.has_room:
            budget.look()
        budget.tell_room()
    assert [way.rooms for way in ways] == [int(way is ways[3]) for way in ways]


@pytest.mark.slow
def test_of_thousands_of_channels_with_little_each_none_has_to_ask() -> None:
    budget, put = Budget(), []  # type: Budget, list[bytes]
    ways = [Way(budget, put) for _ in range(5_000)]
    for _ in range(3):
        for way in ways:
            assert way.sender.send([bytes(100)])
            way.step()
    assert [len(way.came) for way in ways] == [3] * 5_000
    assert {read(data).kind for data in put} == {FRAME}


@pytest.mark.slow
def test_it_is_asked_at_some_of_thousands_of_channels_at_a_time_and_all_that_was_lost_is_free() -> None:
    budget, put = Budget(), []  # type: Budget, list[bytes]
    ways = [Way(budget, put) for _ in range(5_000)]
    for way in ways:
        way.sender.send([bytes(100)])
    looks = sum(read(data).kind == LOOK for data in put)
    assert 0 < looks < 100
    sent = sum(cost(len(data)) for data in put if read(data).kind == FRAME)
    assert budget.used == sent
    for way in ways:
        while way.under_way:
            way.step(lost=True)
    for _ in range(1_000):
        if not budget.waiting:
            break
        budget.look_again()
        for way in ways:
            while way.under_way:
                way.step(lost=not way.came and read(way.under_way[0]).kind == FRAME)
        budget.pump()
    assert not budget.waiting


def test_what_says_that_a_link_has_ended_goes_out_though_there_is_no_room() -> None:
    way = Way(budget := Budget())
    while budget.has_room:
        way.sender.send([bytes(PIECES // 2)])
    for frame in (bytes(PIECES // 2), b"ends"):
        assert way.sender.send([frame])
    way.sender.close()
    while way.under_way:
        way.step()
    assert way.came[-1] == b"ends"


def test_an_acknowledgement_goes_out_though_samples_wait_for_room() -> None:
    budgets = Budgets()
    samples, control = Way(budgets.samples), Way(budgets.control)
    while budgets.samples.has_room:
        samples.sender.send([bytes(PIECES // 2)])
    assert samples.sender.send([b"waits"])
    assert control.sender.send([b"acknowledged"])
    control.step()
    assert (control.came, budgets.samples.has_room, budgets.count) == ([b"acknowledged"], False, 2)
    while samples.under_way:
        samples.step()
        budgets.pump()
    assert samples.came[-1] == b"waits"


def test_it_is_asked_again_at_each_that_has_no_room() -> None:
    budgets = Budgets()
    ways = Way(budgets.samples), Way(budgets.control)
    for way, budget in zip(ways, budgets.both, strict=True):
        while budget.has_room:
            way.sender.send([bytes(PIECES // 2)])
        way.under_way.clear()  # all is lost
    budgets.look_again()
    for way in ways:
        way.step()
    assert [budget.has_room for budget in budgets.both] == [True, True]


def test_who_cuts_a_long_frame_asks_at_some_of_thousands_of_channels() -> None:
    budget, put = Budget(), []  # type: Budget, list[bytes]
    ways = [Way(budget, put) for _ in range(2_000)]
    for way in ways:
        way.sender.send([bytes(100)])
    assert ways[0].sender.send([bytes(1 << 20)])
    kinds = [read(data).kind for data in put]
    assert PIECE in kinds
    assert 0 < kinds.count(LOOK) < 100


def test_that_a_link_has_ended_is_said_though_so_much_waits_that_it_was_refused() -> None:
    way = Way(Budget())
    while way.sender.send([bytes(PIECES // 2)]):
        pass
    assert not way.sender.send([b"ends"])
    way.sender.close()
    while way.under_way:
        way.step()
    assert way.came[-1] == b"ends"
