"""The conformance suite of codecs: decoding gives exactly the record that was encoded; other bytes are refused.

Everything is reproducible: records are invented from fixed seeds, no clock and no order of sets is involved.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any, Final

from aiorts.errors import AiortsError, LimitError, WireError
from aiorts.testing.conformance import Suite, expect
from aiorts.testing.invented import HARD_FLOATS, invent, record_types
from aiorts.testing.samples import difference
from aiorts.types import (
    TimedBooleanSeq,
    TimedDouble,
    TimedDoubleSeq,
    TimedFloat,
    TimedFloatSeq,
    TimedLong,
    TimedLongLong,
    TimedLongSeq,
    TimedMap,
    TimedNDArray,
    TimedOctetSeq,
    TimedString,
    TimedStringSeq,
    TimedULongLong,
)

if TYPE_CHECKING:
    from aiorts.wire import Codec

_SUITE: Suite[Codec] = Suite()
_ROUNDS: Final = 10
"""The number of random records of each type."""
_GARBAGE: Final = 500
"""The number of frames of random bytes, and of frames with a few bytes changed."""
_DTYPES: Final = ("?", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "f4", "f8")


def check_codec(codec: Codec, *, only: Iterable[str] | None = None, skip: Iterable[str] = ()) -> None:
    """Hold a codec to the promises of its kind; `CODEC_CHECKS` lists them.

    Args:
        only: names of the checks to run; by default all. skip: names of checks to leave out.

    Raises:
        ConformanceError: names the check that failed, the first field that differs, expected and got.
    """
    _SUITE.run(type(codec).__name__, codec, only, skip)


def _round_trip(codec: Codec, record: Any) -> Any:
    frame = codec.encode(record)
    expect(type(frame) is bytes, "encode to give bytes", type(frame).__name__)
    decoded = codec.decode(frame)
    found = difference(decoded, record)
    expect(found is None, "the record that was encoded, bit by bit", str(found))
    return decoded


@_SUITE.check
def keeps_every_float(codec: Codec) -> None:
    """-0.0, infinities, subnormals and NaN payloads come back bit by bit, as scalars and in arrays."""
    import numpy as np

    for value in HARD_FLOATS:
        _round_trip(codec, TimedDouble(1, value))
    for value in (-0.0, float("inf"), -float("inf"), 1e-45):
        _round_trip(codec, TimedFloat(1, value))
    _round_trip(codec, TimedDoubleSeq(1, np.array(HARD_FLOATS)))
    singles = np.array([0x80000000, 0x7F800001, 0x7FC0BEEF, 0xFF800000, 1], "u4").view("f4")
    _round_trip(codec, TimedFloatSeq(1, singles.copy()))


@_SUITE.check
def keeps_every_integer(codec: Codec) -> None:
    """Integers come back at both ends of their range."""
    for value in (-(2**63), 2**63 - 1, 2**53 + 1, -1, 0):
        _round_trip(codec, TimedLongLong(0, value))
    for unsigned in (0, 2**63, 2**64 - 1):
        _round_trip(codec, TimedULongLong(2**32 * 10**9 - 1, unsigned))
    for narrow in (-(2**31), 2**31 - 1):
        _round_trip(codec, TimedLong(1, narrow))


@_SUITE.check
def keeps_text(codec: Codec) -> None:
    """Text comes back character by character, with NUL, and beyond the basic plane."""
    texts = ("", "\0", "a\0b", "äöü", "日本語", "\U0001f916", "e\u0301", "x" * 70_000)
    for text in texts:
        _round_trip(codec, TimedString(1, text))
    _round_trip(codec, TimedStringSeq(1, texts))


@_SUITE.check
def keeps_nothing(codec: Codec) -> None:
    """Empty sequences, arrays without elements and empty maps are values and come back."""
    import numpy as np

    for record in (TimedDoubleSeq(1, []), TimedStringSeq(1, []), TimedOctetSeq(1, b""), TimedMap(1, {})):
        _round_trip(codec, record)
    for shape in ((0,), (3, 0), (0, 2, 2)):
        _round_trip(codec, TimedNDArray(1, np.zeros(shape, "i2")))


@_SUITE.check
def takes_any_layout(codec: Codec) -> None:
    """Big-endian, strided and transposed arrays come back as native, contiguous arrays of the same values."""
    import numpy as np

    base = np.arange(24, dtype="f8")
    for array in (base.astype(">f8"), base[::2], base[::-1]):
        decoded = _round_trip(codec, TimedDoubleSeq(1, array))
        expect(bool((decoded.data == array).all()), f"{array[:3]}...", f"{decoded.data[:3]}...")
    for array in (base.reshape(4, 6).T, base.astype(">i4").reshape(2, 3, 4)):
        decoded = _round_trip(codec, TimedNDArray(1, array))
        same = decoded.data.shape == array.shape and bool((decoded.data == array).all())
        expect(same, f"shape {array.shape} and the same values", f"shape {decoded.data.shape}")


@_SUITE.check
def keeps_element_types(codec: Codec) -> None:
    """An array comes back with its element type and shape, native, contiguous and read-only."""
    import numpy as np

    for dtype in _DTYPES:
        array = np.arange(6).astype(dtype).reshape(2, 3)
        got = _round_trip(codec, TimedNDArray(1, array)).data
        expect(got.dtype == np.dtype(dtype) and got.dtype.isnative, f"native {np.dtype(dtype)}", str(got.dtype))
        expect(got.flags.c_contiguous and not got.flags.writeable, "contiguous, read-only", str(got.flags))
    _round_trip(codec, TimedBooleanSeq(1, [True, False, True]))
    _round_trip(codec, TimedLongSeq(1, [1, -1]))


@_SUITE.check
def keeps_every_type(codec: Codec) -> None:
    """Each record type that comes with aiorts comes back: as it is by default, and with random content."""
    for cls in record_types():
        _round_trip(codec, cls())
        dice = random.Random(f"{cls.__name__}")  # noqa: S311 - reproducible, not secret
        for _ in range(_ROUNDS):
            _round_trip(codec, invent(cls, dice))


@_SUITE.check
def keeps_plain_values(codec: Codec) -> None:
    """bool, int, float, str and bytes travel on their own, each as its own type."""
    for value in (True, False, 0, -1, 2**62, -0.0, 1.0, "", "ä", b"", b"\x00\xff"):
        _round_trip(codec, value)


@_SUITE.check
def says_the_same_each_time(codec: Codec) -> None:
    """The same record gives the same bytes each time, and decoding it changes nothing."""
    record = invent(TimedMap, random.Random(1))  # noqa: S311
    frame = codec.encode(record)
    expect(codec.encode(record) == frame, "the same bytes again", codec.encode(record)[:40])
    expect(codec.encode(codec.decode(frame)) == frame, "the same bytes of the decoded record", frame[:40])


@_SUITE.check
def holds_to_the_expected_type(codec: Codec) -> None:
    """A frame of another type than expected is a WireError; one of the expected type is decoded."""
    frame = codec.encode(TimedDouble(1, 2.0))
    expect(codec.decode(frame, TimedDouble) == TimedDouble(1, 2.0), "the record", codec.decode(frame, TimedDouble))
    _refused(lambda: codec.decode(frame, TimedLong), "a TimedDouble where a TimedLong is expected")


def _refused(decode: Callable[[], Any], what: str, kind: type[AiortsError] = WireError) -> None:
    try:
        got = decode()
    except kind:
        return
    expect(False, f"{kind.__name__} for {what}", got)


def _frames(codec: Codec) -> list[bytes]:
    records = (
        TimedDouble(1, 2.0),
        TimedStringSeq(1, ["a", "bc"]),
        TimedDoubleSeq(1, [1.0, 2.0]),
        TimedMap(1, {"a": 1}),
    )
    return [codec.encode(record) for record in records]


@_SUITE.check
def refuses_a_part(codec: Codec) -> None:
    """Each beginning of a frame that is not all of it is a WireError."""
    for frame in _frames(codec):
        for length in range(len(frame)):
            _refused(lambda part=frame[:length]: codec.decode(part), f"the first {length} of {len(frame)} bytes")  # type: ignore[misc]


@_SUITE.check
def refuses_more_than_a_frame(codec: Codec) -> None:
    """Bytes after a frame are a WireError, be they another frame."""
    for frame in _frames(codec):
        for tail in (b"\x00", b"\xc0", b"garbage", frame):
            _refused(lambda whole=frame + tail: codec.decode(whole), f"{len(tail)} bytes after the frame")  # type: ignore[misc]


@_SUITE.check
def survives_garbage(codec: Codec) -> None:
    """Random bytes and damaged frames are a WireError, or by chance a record; nothing else is raised."""
    dice = random.Random(20)  # noqa: S311
    frames = _frames(codec)
    for number in range(_GARBAGE):
        data = bytearray(dice.choice(frames))
        for _ in range(dice.randint(1, 3)):
            data[dice.randrange(len(data))] = dice.randrange(256)
        for candidate in (bytes(data), dice.randbytes(number % 64)):
            try:
                codec.decode(candidate)
            except WireError:
                continue


@_SUITE.check
def keeps_to_its_limits(codec: Codec) -> None:
    """A codec with `limits` refuses larger frames and longer strings, on both sides, with LimitError."""
    limits = getattr(codec, "limits", None)
    if limits is None:
        return
    long_text = TimedString(1, "x" * (limits.string + 1))
    _refused(lambda: codec.encode(long_text), f"a string of {limits.string + 1} bytes", LimitError)
    _refused(lambda: codec.decode(bytes(limits.frame + 1)), f"a frame of {limits.frame + 1} bytes", LimitError)


CODEC_CHECKS: Mapping[str, str] = _SUITE.promises
"""The promises that `check_codec` demands: name of the check -> promise."""
