"""What another kernel may say to hold this one up: it is refused in a time that the loop has."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress

import pytest

from aiorts.errors import LinkError
from aiorts.links.messages import fields

LARGEST = 1_048_576
"""Bytes of a message at the most."""


def held_up(read: Callable[[], object]) -> float:
    """Seconds of the processor that it takes at the least."""

    def once() -> float:
        began = time.thread_time()
        with suppress(LinkError):
            read()
        return time.thread_time() - began

    return min(once() for _ in range(3))


@pytest.mark.fault("E13")
@pytest.mark.parametrize(
    "bomb",
    [
        (b"\xdd\x00\x0f\x42\x40" * 500).ljust(LARGEST, b"\xc0"),
        (b"\xdc\xff\xff" * 300).ljust(LARGEST, b"\x90"),
        b"\xdd\x00\x0f\xff\x00" + b"\x90" * 0xFFF00,
        b"\x91" * LARGEST,
    ],
    ids=["claims", "claims with lists", "lists", "deep"],
)
def test_a_message_that_is_a_bomb_takes_10_ms_of_the_processor(bomb: bytes) -> None:
    assert held_up(lambda: fields(bomb, (list,), longer=True)) < 0.010
    with pytest.raises(LinkError, match="no message of this protocol"):
        fields(bomb, (list,), longer=True)
