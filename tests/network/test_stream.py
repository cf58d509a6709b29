"""Both directions of a session: whatever messages are lost, doubled or late, what comes is whole and in order."""

from __future__ import annotations

import random
from collections import deque

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aiorts_zenoh.envelope import END, FRAME, HAVE, message, read
from aiorts_zenoh.stream import CHUNK, WINDOW, Stream

NUMBER = 7


class Line:
    """Two ends, and the messages that are on their way from each."""

    def __init__(self) -> None:
        self.to_reader: deque[bytes] = deque()
        self.to_writer: deque[bytes] = deque()
        self.writer = Stream(self.to_reader.append, NUMBER, lambda: 1)
        self.reader = Stream(self.to_writer.append, NUMBER, lambda: 2)
        self.came = bytearray()
        self.unused = 0

    def carry(self, count: int = 10_000) -> None:
        """Deliver as many messages, in both directions."""
        for _ in range(count):
            if self.to_reader:
                data = self.reader.arrived(read(self.to_reader.popleft()))
                self.came += data
                self.unused += len(data)
            elif self.to_writer:
                self.writer.arrived(read(self.to_writer.popleft()))
            else:
                return

    def use(self) -> None:
        """The reader uses what has come."""
        self.reader.took(self.unused)
        self.unused = 0


@given(st.lists(st.integers(1, CHUNK), max_size=30), st.integers(0, 2**32))
def test_what_is_sent_comes_whole_and_in_order_whatever_the_network_does(sizes: list[int], seed: int) -> None:
    line, sent, chance = Line(), bytearray(), random.Random(seed)
    for size in sizes:
        for _ in range(200):
            if line.writer.has_room:
                break
            spoil(line, chance)
            line.carry()
            line.use()
            line.writer.look()
        data = chance.randbytes(size)
        line.writer.send(data)
        sent += data
        spoil(line, chance)
        line.carry(chance.randrange(4))
        assert line.unused <= WINDOW
    line.writer.end()
    for _ in range(3):  # nothing is spoilt any more
        line.writer.look()
        line.carry()
        line.use()
    assert bytes(line.came) == bytes(sent)
    assert line.reader.ended
    assert line.writer.is_through


def spoil(line: Line, chance: random.Random) -> None:
    """Lose, double or exchange messages."""
    for way in (line.to_reader, line.to_writer):
        kept = [one for one in way for _ in range(chance.choice((0, 1, 1, 1, 2)))]
        if chance.random() < 0.2:
            chance.shuffle(kept)
        way.clear()
        way.extend(kept)


def test_no_more_than_a_window_is_under_way_to_an_end_that_uses_nothing() -> None:
    line = Line()
    while line.writer.has_room:
        line.writer.send(bytes(CHUNK))
        line.carry()
    assert line.unused <= WINDOW + CHUNK
    line.writer.look()
    line.carry()
    assert not line.writer.has_room
    line.use()
    line.carry()
    assert line.writer.has_room


@pytest.mark.parametrize("kind", [FRAME, END, HAVE])
def test_messages_of_another_session_are_passed_over(kind: int) -> None:
    line = Line()
    assert line.reader.arrived(read(message(kind, NUMBER + 1, 0, 1, [b"x"]))) == b""
    assert not line.reader.ended
    assert not line.to_writer


def test_an_end_that_sends_more_than_it_may_is_not_kept_up_with() -> None:
    line, came = Line(), 0
    for number in range(1_000):
        came += len(line.reader.arrived(read(message(FRAME, NUMBER, number * CHUNK, 1, [bytes(CHUNK)]))))
    assert came <= WINDOW + 2 * CHUNK


def test_a_number_that_no_end_ever_comes_to_is_no_message() -> None:
    with pytest.raises(ValueError, match="a message of version 1 and kind 1"):
        read(message(FRAME, NUMBER, 2**64 - 1, 1, [b"x"]))
