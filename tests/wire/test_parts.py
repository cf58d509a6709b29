"""Heads and parts: every record comes back, large arrays are not copied, and whatever else comes is a WireError."""

from __future__ import annotations

import random
import struct
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import FrozenInstanceError, dataclass, field
from typing import Any, ClassVar, Final

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts.errors import LimitError, RecordError, RecordTypeError, WireError
from aiorts.testing.invented import invent, record_types
from aiorts.types import (
    PointCloud,
    TimedDouble,
    TimedMap,
    TimedNDArray,
    TimedOctetSeq,
    TimedStringSeq,
    TimedVelocity2D,
    Velocity2D,
    record,
    snapshot,
)
from aiorts.types.nested import RecordKind
from aiorts.wire import LINK, Limits, MsgpackCodec, sealed_bytes, with_parts
from aiorts.wire.arrays import pack_array
from campaign import cases
from each import each

CODEC = MsgpackCodec(LINK)
TYPES = sorted(record_types(), key=lambda cls: cls.__name__)
LARGE = 16_384


@dataclass
class Reading:
    """A mutable dataclass of a user's, with others in it."""

    label: str
    data: bytes
    values: list[float]


@record
class Cloud:
    """Several arrays, one of them nested."""

    tm: int
    name: str
    points: np.ndarray
    rest: tuple[TimedNDArray, ...]


def there_and_back(sample: Any) -> Any:
    head, parts = CODEC.encode_parts(sample)
    return CODEC.decode_parts(head, parts, type(sample))


@each(TYPES)
def test_every_record_comes_back(cls: type) -> None:
    dice = random.Random(cls.__name__)
    for _ in range(3):
        sample = invent(cls, dice)
        back = there_and_back(sample)
        assert back == sample
        assert MsgpackCodec().encode(back) == MsgpackCodec().encode(sample), "bit for bit"


@pytest.mark.parametrize("value", [True, 7, -(2**63), 1.5, "text", b"bytes", bytes(LARGE)], ids=str)
def test_a_plain_value_comes_back(value: Any) -> None:
    back = there_and_back(value)
    assert (back, type(back)) == (value, type(value))


def test_a_dataclass_comes_back() -> None:
    sample = snapshot(Reading("a", bytes(LARGE), [1.0, 2.0]))
    head, parts = CODEC.encode_parts(sample)
    assert [part.nbytes for part in parts] == [LARGE]
    back = CODEC.decode_parts(head, parts, Reading)
    assert (back.label, back.data, list(back.values)) == ("a", bytes(LARGE), [1.0, 2.0])


def test_numbers_alone_are_a_packed_structure_without_names() -> None:
    assert CODEC.encode_parts(TimedDouble(1, 1.5)) == (struct.pack("<Qd", 1, 1.5), ())
    nested = TimedVelocity2D(5, Velocity2D(1.0, 2.0, 3.0))
    assert CODEC.encode_parts(nested) == (struct.pack("<Qddd", 5, 1.0, 2.0, 3.0), ())


@record
class Share:
    """One number with a rule of its own."""

    of: float

    def __post_init__(self) -> None:
        if not 0.0 <= self.of <= 1.0:
            raise ValueError("a share is from 0 to 1")


@record
class Shares:
    """Numbers alone, the first of them in a record of its own."""

    one: Share
    count: int
    two: Share


def test_a_class_keeps_its_own_rules_when_it_is_decoded() -> None:
    assert there_and_back(Shares(Share(0.5), 3, Share(1.0))) == Shares(Share(0.5), 3, Share(1.0))
    for cls, head in ((Share, struct.pack("<d", -1.0)), (Shares, struct.pack("<dqd", 0.5, 3, 2.0))):
        with pytest.raises(ValueError, match="a share is from 0 to 1"):
            CODEC.decode_parts(head, (), cls)


def test_several_records_of_numbers_have_the_heads_that_each_has_alone() -> None:
    encode_all, decode_all = CODEC.heads_encoder(Shares), CODEC.heads_decoder(Shares)
    assert encode_all is not None
    assert decode_all is not None
    records = [Shares(Share(0.1 * number), number, Share(1.0)) for number in range(10)]
    heads = [CODEC.encode_parts(each)[0] for each in records]
    assert list(encode_all(records)) == heads
    assert list(decode_all([memoryview(head) for head in heads])) == records
    assert not encode_all([*records, TimedDouble(1, 2.0)])


@pytest.mark.parametrize("wrong", [b"", struct.pack("<dqd", 0.5, 3, 2.0)])
def test_those_before_a_head_that_is_none_are_records(wrong: bytes) -> None:
    decode_all = CODEC.heads_decoder(Shares)
    assert decode_all is not None
    one = Shares(Share(0.5), 3, Share(1.0))
    found = decode_all([CODEC.encode_parts(one)[0], wrong])
    assert next(found) == one
    with pytest.raises(ValueError if wrong else struct.error):
        next(found)


def test_records_of_more_than_numbers_are_looked_at_one_by_one() -> None:
    assert CODEC.heads_encoder(TimedStringSeq) is None
    assert CODEC.heads_decoder(TimedStringSeq) is None


def test_arrays_of_16_kib_travel_beside_the_head_and_are_not_copied() -> None:
    array = np.arange(LARGE // 8, dtype="f8").reshape(2, -1)
    sample = Cloud(1, "c", array, (TimedNDArray(2, np.zeros(LARGE // 8 - 1)), TimedNDArray(3, np.ones(LARGE, "b1"))))
    head, parts = CODEC.encode_parts(sample)
    assert [part.nbytes for part in parts] == [LARGE, LARGE]
    assert np.shares_memory(np.frombuffer(parts[0], "f8"), sample.points)
    received = []
    for part in parts:
        memory = sealed_bytes(part.nbytes)
        memory[:] = part
        received.append(memory.toreadonly())
    back = CODEC.decode_parts(head, received, Cloud)
    assert back == sample
    for array, part in ((back.points, received[0]), (back.rest[1].data, received[1])):
        assert np.shares_memory(array, np.frombuffer(part, "u1"))
        assert not array.flags.writeable
        with pytest.raises(ValueError, match=r"read-only|WRITEABLE"):
            array.setflags(write=True)


def test_memory_that_may_still_change_is_copied() -> None:
    head, parts = CODEC.encode_parts(TimedOctetSeq(1, bytes(LARGE)))
    memory = bytearray(parts[0])
    back = CODEC.decode_parts(head, [memoryview(memory)], TimedOctetSeq)
    memory[0] = 9
    assert back.data[0] == 0


def test_another_class_is_refused_where_it_is_written() -> None:
    @record
    class More(TimedDouble):
        unit: str = ""

    with pytest.raises(RecordTypeError, match=r"expected exactly a TimedDouble, got an instance of .*More"):
        CODEC.parts_encoder(TimedDouble)(More(1, 2.0, "m"))


def _cloud_frame() -> tuple[bytes, list[bytes]]:
    head, parts = CODEC.encode_parts(Cloud(1, "c", np.zeros(LARGE // 8), ()))
    return head, [bytes(part) for part in parts]


@pytest.mark.fault("E14")
@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda head, parts: (head, []), "expected a part beside the frame"),
        (lambda head, parts: (head, [*parts, b"x"]), "expected fewer than 2 parts"),
        (lambda head, parts: (head, [parts[0][:-1]]), "expected 16384 bytes for f64"),
        (lambda head, parts: (head, [parts[0] + b"x"]), "expected 16384 bytes for f64"),
        (lambda head, parts: (head, [memoryview(parts[0] * 2)[::2]]), "contiguous"),
        (lambda head, parts: (head, parts * 65), "65 parts; at most 64"),
        (lambda head, parts: (msgpack.packb([1, "c", [b"\x0c\x01"], []]), parts), "expected the head of an array"),
        (lambda head, parts: (msgpack.packb([1, "c", [1, 2], []]), parts), "expected the head of an array"),
        (
            lambda head, parts: (msgpack.packb([1, "c", [struct.pack("<BB6xQ", 12, 1, 2**40)], []]), parts),
            "expected 8796093022208 bytes",
        ),
        (lambda head, parts: (msgpack.packb([1, "c", []]), []), "expected a list of 4"),
        (lambda head, parts: (msgpack.packb({"tm": 1}), []), "expected a list of 4"),
    ],
)
def test_parts_that_do_not_fit_are_refused(change: Any, message: str) -> None:
    head, parts = change(*_cloud_frame())
    with pytest.raises(WireError, match=message):
        CODEC.decode_parts(head, parts, Cloud)


@pytest.mark.parametrize("head", [b"", bytes(15), bytes(17), b"\xff" * 16, bytes(16)[:8] * 2 + b"x"])
def test_a_packed_record_of_another_length_or_time_is_refused(head: bytes) -> None:
    with pytest.raises(WireError, match="TimedDouble"):
        CODEC.decode_parts(head, (), TimedDouble)


def test_limits_hold_on_both_sides() -> None:
    tight = MsgpackCodec(Limits(frame=4 * LARGE, values=40, parts=2))
    for sample, message in (
        (TimedStringSeq(0, ["a"] * 41), "claims"),
        (TimedOctetSeq(0, bytes(4 * LARGE)), "at most 65536 are allowed"),
        (Cloud(0, "", np.zeros(1), tuple(TimedNDArray(0, np.zeros(LARGE // 8)) for _ in range(3))), "3 large arrays"),
    ):
        with pytest.raises(LimitError, match=message):
            tight.encode_parts(sample)
        head, parts = CODEC.encode_parts(sample)
        with pytest.raises(LimitError):
            tight.decode_parts(head, parts, type(sample))


@pytest.mark.slow
@settings(max_examples=cases(5_000))
@given(
    st.sampled_from([Cloud, Reading, TimedMap, PointCloud, TimedVelocity2D]),
    st.integers(0, 99),
    st.randoms(),
    st.data(),
)
def test_a_damaged_head_gives_a_record_or_a_wire_error_and_nothing_else(
    cls: type, seed: int, dice: random.Random, data: st.DataObject
) -> None:
    sample = invent(cls, random.Random(seed))
    head, parts = CODEC.encode_parts(sample)
    damaged = bytearray(head)
    for _ in range(data.draw(st.integers(1, 4))):
        place = dice.randrange(len(damaged) + 1)
        damaged[place : place + dice.randrange(3)] = dice.randbytes(dice.randrange(3))
    try:
        back = CODEC.decode_parts(bytes(damaged), [bytes(part) for part in parts], cls)
    except WireError:
        return
    assert type(back) is cls


@pytest.mark.fault("E13")
@pytest.mark.parametrize(
    "bomb",
    [
        b"\xdc\xff\xff" * 24_400,
        b"\xdd\x7f\xff\xff\xff",
        b"\xdc\x27\x10" + (b"\xdc\x03\xe8" + b"\x80" * 1000) * 10_000,
        b"\x91" * 100_000 + b"\x01",
        b"\xdb\xff\xff\xff\xff",
        msgpack.packb([1, ["a"] * 4_090]),
        msgpack.packb([1, ["é" * 20] * 2_000 + [1]]),
    ],
    ids=["nested", "claims 2**31", "10 MB of empty maps", "deep", "text of 4 GiB", "texts", "texts, the last is none"],
)
def test_a_bomb_and_a_frame_of_texts_take_10_ms_of_the_processor(bomb: bytes) -> None:
    def read() -> float:
        began = time.thread_time()
        with suppress(WireError):
            CODEC.decode_parts(bomb, (), TimedStringSeq)
        return time.thread_time() - began

    assert min(read() for _ in range(5)) < 0.010


@record
class Small:
    """A record that many fit into a frame of."""

    of: int


@dataclass
class Listed:
    """A mutable dataclass that many fit into a frame of."""

    of: list[int]


@record
class Many:
    """Tiny records, of all sorts."""

    smalls: tuple[Small, ...]
    listed: tuple[Listed, ...]
    maps: tuple[TimedMap, ...]


_MOST: Final = LINK.values - 16
_EMPTY: Final = pack_array(np.zeros(0))


@pytest.mark.parametrize(
    ("cls", "content"),
    [
        (Many, [[[1]] * (_MOST // 2), [], []]),
        (Many, [[], [[[]]] * (_MOST // 2), []]),
        (Many, [[], [], [[1, {}]] * (_MOST // 3)]),
        (TimedMap, [1, {str(number): number for number in range(_MOST // 2)}]),
        (TimedMap, [1, {str(number): {} for number in range(_MOST // 2)}]),
        (TimedMap, [1, {str(number): [b""] for number in range(_MOST // 3)}]),
        (TimedMap, [1, {str(number): _EMPTY for number in range(_MOST // 2)}]),
    ],
    ids=["records", "dataclasses", "records of maps", "scalars", "maps", "bytes", "arrays"],
)
def test_each_value_of_a_frame_of_thousands_takes_fourteen_calls_at_the_most(cls: type, content: Any) -> None:
    """In calls, not in time: some 10 ms for the worst of them, which is all that a peer may hold the loop up for."""
    head, decode, calls = msgpack.packb(content), CODEC.parts_decoder(cls), 0
    decode(head, ())

    def count(_frame: Any, event: str, _what: Any) -> None:
        nonlocal calls
        calls += event in ("call", "c_call")

    before = sys.getprofile()
    sys.setprofile(count)
    try:
        decode(head, ())
    finally:
        sys.setprofile(before)
    assert LINK.values < calls < 14 * LINK.values


def test_a_codec_without_parts_gets_them_from_its_frames() -> None:
    class Plain:
        def encode(self, record: Any) -> bytes:
            return MsgpackCodec().encode(record)

        def decode(self, data: bytes, expected: type | None = None) -> Any:
            return MsgpackCodec().decode(data, expected)

    codec = with_parts(Plain())
    head, parts = codec.encode_parts(TimedDouble(1, 2.0))
    assert codec.decode_parts(memoryview(head), parts, TimedDouble) == TimedDouble(1, 2.0)
    with pytest.raises(WireError, match="expected no parts"):
        codec.decode_parts(head, [b"x"], TimedDouble)
    assert with_parts(CODEC) is CODEC


def test_a_frame_is_decoded_from_any_buffer() -> None:
    frame = MsgpackCodec().encode(TimedNDArray(1, np.arange(9.0)))
    for buffer in (bytearray(frame), memoryview(frame), memoryview(bytearray(frame)).toreadonly()):
        assert MsgpackCodec().decode(buffer) == MsgpackCodec().decode(frame)
    with pytest.raises(WireError, match="contiguous"):
        MsgpackCodec().decode(memoryview(frame * 2)[::2])


def test_a_field_that_is_not_what_it_says_is_named() -> None:
    head = msgpack.packb(["label", b"", "no list"])
    with pytest.raises((WireError, RecordError), match=r"Reading\.values"):
        CODEC.decode_parts(head, (), Reading)


@record
class Texts:
    texts: tuple[str, ...]


@record
class Several:
    flags: np.ndarray
    raw: bytes
    items: tuple[TimedNDArray, ...]


@dataclass(frozen=True)
class Leaf:
    value: int
    names: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Branch:
    leaves: tuple[Leaf, ...]
    table: dict[str, float] = field(default_factory=dict)


@dataclass
class Bough:
    """Sorts what it is given, and counts it."""

    branches: list[Branch]
    first: Leaf | None = None
    count: int = 0

    def __post_init__(self) -> None:
        self.branches = sorted(self.branches, key=lambda branch: len(branch.leaves))
        self.count = len(self.branches)


@dataclass(frozen=True)
class Tree:
    boughs: tuple[Bough, ...]
    pair: tuple[Bough, Leaf]


def tree() -> Tree:
    def branch(count: int) -> Branch:
        return Branch(tuple(Leaf(number, ["a", "b"]) for number in range(count)), {"weight": 1.5})

    def bough() -> Bough:
        return Bough([branch(3), branch(2)], Leaf(7))

    return Tree((bough(), bough()), (bough(), Leaf(8)))


def _seconds(read: Callable[[], object]) -> float:
    def once() -> float:
        began = time.thread_time()
        with suppress(WireError):
            read()
        return time.thread_time() - began

    return min(once() for _ in range(3))


@pytest.mark.fault("E13")
@pytest.mark.parametrize("letter", ["a", "\N{CJK UNIFIED IDEOGRAPH-4E2D}", "\N{GRINNING FACE}"])
def test_texts_of_a_frame_are_2_mib_together_over_links(letter: str) -> None:
    text = letter * (1_048_576 // len(letter.encode()))
    decode = CODEC.parts_decoder(Texts)
    head = msgpack.packb([[text] * 4])
    assert _seconds(lambda: decode(head, ())) < 0.010
    with pytest.raises(LimitError, match=r"Texts: 4194... bytes of texts and other values .* at most 2097152"):
        decode(head, ())
    with pytest.raises(LimitError, match=r"Texts: 3145... bytes of texts and other values .* at most 2097152"):
        CODEC.encode_parts(Texts((text,) * 3))
    assert there_and_back(Texts((text,))) == Texts((text,))
    files = MsgpackCodec()
    assert files.decode_parts(*files.encode_parts(Texts((text,) * 3)), Texts) == Texts((text,) * 3)


@pytest.mark.fault("E13")
@pytest.mark.parametrize("size", [LARGE + 100, 3 << 20])
def test_what_is_large_is_beside_the_head_or_refused(size: int) -> None:
    empty = pack_array(np.zeros(0))
    decode = CODEC.parts_decoder(Several)
    for flags, raw, items in (
        (pack_array(np.zeros(size, "?")), b"", []),
        (empty, bytes(size), []),
        (empty, b"", [[0, pack_array(np.zeros(size, "u1"))]]),
    ):
        head = msgpack.packb([flags, raw, items])
        assert _seconds(lambda head=head: decode(head, ())) < 0.010  # type: ignore[misc]
        with pytest.raises(WireError, match=r"bytes in the head of a frame|do not travel beside the frame"):
            decode(head, ())


def test_a_dataclass_deep_in_others_is_looked_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    sample = tree()
    head, parts = CODEC.encode_parts(sample)
    decode, looked = CODEC.parts_decoder(Tree), []
    check = RecordKind.check
    monkeypatch.setattr(RecordKind, "check", lambda *given: (looked.append(given), check(*given))[1])
    found = decode(head, parts)
    assert looked == []
    monkeypatch.undo()
    assert found == snapshot(sample)
    assert found.boughs[0].count == 2
    assert [len(branch.leaves) for branch in found.boughs[0].branches] == [2, 3]


def test_what_is_decoded_of_dataclasses_cannot_change() -> None:
    found = there_and_back(tree())
    bough = found.boughs[0]
    assert type(bough.branches) is tuple
    assert type(bough.branches[0].leaves[0].names) is tuple
    with pytest.raises(FrozenInstanceError):
        bough.count = 3
    with pytest.raises(TypeError):
        bough.branches[0].table["weight"] = 2.0
    assert MsgpackCodec().encode(found) == MsgpackCodec().encode(snapshot(tree()))


def test_what_a_class_makes_of_its_values_is_checked() -> None:
    head, parts = CODEC.encode_parts(Wrapped(Wrong(1)))
    Wrong.wrong = True
    try:
        with pytest.raises(WireError, match=r"Wrong\.value: expected an integer"):
            CODEC.decode_parts(head, parts, Wrapped)
    finally:
        Wrong.wrong = False


@dataclass
class Wrong:
    value: int
    wrong: ClassVar[bool] = False

    def __post_init__(self) -> None:
        if self.wrong:
            self.value = "text"  # type: ignore[assignment]


@dataclass
class Wrapped:
    inner: Wrong


def test_arrays_without_elements_are_of_their_type_and_nobody_writes_to_them() -> None:
    for element in ("f8", "u1", "?"):
        for shape in ((0,), (0, 3)):
            array = there_and_back(TimedNDArray(0, np.zeros(shape, element))).data
            assert (array.dtype, array.shape, array.flags.writeable) == (np.dtype(element), shape, False)
