"""What a message of a channel between hosts looks like: it is read back, and what is none is refused."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("zenoh")

from aiorts_zenoh.envelope import FRAME, LARGEST, LONG, LOOK, PIECE, PIECES, TAKEN, Whole, message, pieces, read

BLOCKS = st.lists(st.binary(max_size=300), max_size=8)
NUMBERS = {"epoch": st.integers(0, 2**32 - 1), "first": st.integers(0, 2**63 - 1)}


@given(st.sampled_from((FRAME, PIECE, TAKEN, LOOK)), NUMBERS["epoch"], NUMBERS["first"], BLOCKS)
def test_a_message_is_read_back(kind: int, epoch: int, first: int, blocks: list[bytes]) -> None:
    found = read(message(kind, epoch, first, 1_700_000_000_000_000_000, blocks))
    assert (found.kind, found.epoch, found.first, [bytes(one) for one in found.blocks]) == (kind, epoch, first, blocks)
    assert found.sent_ns == 1_700_000_000_000_000_000
    assert all(one.readonly for one in found.blocks)


def test_the_layout_is_that_of_the_specification() -> None:
    assert message(FRAME, 0x01020304, 5, 6, [b"ab"]).hex() == (
        "01 01 0100 04030201 0500000000000000 0600000000000000 02000000 6162".replace(" ", "")
    )


@given(BLOCKS, st.data())
def test_what_is_cut_or_longer_is_no_message(blocks: list[bytes], data: st.DataObject) -> None:
    whole = message(FRAME, 1, 2, 3, blocks)
    cut = data.draw(st.integers(0, len(whole) - 1))
    for wrong in (whole[:cut], whole + b"x"):
        with pytest.raises(ValueError, match=r"message|block"):
            read(wrong)


def test_a_message_of_one_block_that_is_cut_at_any_byte_is_none() -> None:
    whole = message(FRAME, 1, 2, 3, [b"a"])
    for cut in range(len(whole)):
        with pytest.raises(ValueError, match=r"message|block"):
            read(whole[:cut])


@given(st.binary(max_size=200))
def test_any_bytes_are_read_or_refused(data: bytes) -> None:
    try:
        found = read(data)
    except ValueError:
        return
    try:
        Whole().add(found.blocks)
    except ValueError:
        return


def test_a_long_frame_comes_whole_and_one_with_a_piece_missing_not_at_all() -> None:
    blocks = [b"head", bytes(range(256)) * 2_500, b"", b"x" * PIECES]
    parts = [read(message(PIECE, 1, 2, 3, piece)).blocks for piece in pieces(blocks)]
    assert [len(part) for _, part in parts[:-1]] == [LONG, LONG, PIECES, PIECES]
    whole = Whole()
    found = [whole.add(part) for part in parts]
    assert found[:-1] == [None] * (len(parts) - 1)
    assert [bytes(one) for one in found[-1] or ()] == blocks
    lost = [whole.add(part) for part in parts[:2] + parts[3:]]
    assert lost == [None] * (len(parts) - 1)
    again = [whole.add(part) for part in parts]
    assert [bytes(one) for one in again[-1] or ()] == blocks


def test_a_frame_of_a_gigabyte_is_refused_before_anything_is_kept() -> None:
    place = (LARGEST + 1).to_bytes(8, "little") + bytes(8)
    with pytest.raises(ValueError, match="a frame of"):
        Whole().add([memoryview(place), memoryview(b"x")])
