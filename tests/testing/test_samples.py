"""`difference` tells where two samples differ, bit by bit."""

from __future__ import annotations

import math
import struct
from typing import Any

import numpy as np
import pytest

from aiorts.testing import difference
from aiorts.testing.invented import record_types
from aiorts.types import Point2D, TimedDouble, TimedDoubleSeq, TimedLong, TimedMap, TimedNDArray, TimedStringSeq

PAYLOAD = struct.unpack("<d", bytes.fromhex("efbeadde0000f87f"))[0]


@pytest.mark.parametrize(
    ("left", "right", "where"),
    [
        (TimedDouble(1, 0.0), TimedDouble(1, -0.0), "TimedDouble.data: 0.0 (bits 0000000000000000), not -0.0"),
        (TimedDouble(1, math.nan), TimedDouble(1, PAYLOAD), "TimedDouble.data: nan (bits 7ff8000000000000), not nan"),
        (TimedDouble(1, 0.0), TimedDouble(2, 0.0), "TimedDouble.tm: 1, not 2"),
        (TimedDouble(1, 0.0), TimedLong(1, 0), "TimedDouble: a TimedDouble, not a TimedLong"),
        (True, 1, "bool: a bool, not a int"),
        (TimedDoubleSeq(1, [1.0, 2.0]), TimedDoubleSeq(1, [1.0, 3.0]), "TimedDoubleSeq.data[1]: '2.0 "),
        (TimedDoubleSeq(1, [1.0]), TimedDoubleSeq(1, [1.0, 3.0]), "TimedDoubleSeq.data.shape[0]: 1, not 2"),
        (TimedNDArray(1, np.zeros(2, "i2")), TimedNDArray(1, np.zeros(2, "u2")), "TimedNDArray.data.dtype: '<i2', not"),
        (TimedStringSeq(1, ["a"]), TimedStringSeq(1, ["b"]), "TimedStringSeq.data[0]: 'a', not 'b'"),
        (TimedStringSeq(1, ["a"]), TimedStringSeq(1, ["a", "b"]), "len(TimedStringSeq.data): 1, not 2"),
        (TimedMap(1, {"a": 1}), TimedMap(1, {"b": 1}), "keys of TimedMap.data[0]: 'a', not 'b'"),
        (TimedMap(1, {"a": 1}), TimedMap(1, {"a": 1.0}), "TimedMap.data['a']: a int, not a float"),
    ],
)
def test_first_difference_is_named(left: Any, right: Any, where: str) -> None:
    found = difference(left, right)
    assert found is not None
    assert found.startswith(where)


def test_same_bits_do_not_differ() -> None:
    for cls in record_types():
        assert difference(cls(), cls()) is None
    assert difference(TimedDouble(1, PAYLOAD), TimedDouble(1, PAYLOAD)) is None
    assert difference(Point2D(1.0, -0.0), Point2D(1.0, -0.0)) is None


def test_every_record_type_is_known_to_the_suite() -> None:
    names = {cls.__name__ for cls in record_types()}
    assert len(names) >= 126 + 6
    assert {"TimedDouble", "PointCloud", "TimedMap", "Time"} <= names
