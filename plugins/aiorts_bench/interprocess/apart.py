"""Components that `aiorts bench isolation` runs in processes of their own, and the bare process of the same work.

`python -m aiorts_bench.interprocess.apart` reads lines with numbers: it does so many pieces of work, then prints it.
"""

from __future__ import annotations

import sys
import time
from itertools import repeat
from typing import Final

from aiorts import Component, InPort, OutPort
from aiorts.types import TimedDouble, TimedLong, TimedOctetSeq

_PIECE: Final = 50_000


def work(pieces: int) -> int:
    """Add up numbers, in Python code alone; a piece takes some milliseconds."""
    total = 0
    for _ in repeat(None, pieces):
        for number in range(_PIECE):
            total += number & 7
    return total


class Through(Component):
    """Sends back what it reads; answers an empty array with the number of arrays before it and its processor time."""

    inp = InPort(TimedDouble)
    out = OutPort(TimedDouble)
    large_in = InPort(TimedOctetSeq)
    large_out = OutPort(TimedOctetSeq)
    arrays = InPort(TimedOctetSeq, length=16)
    taken = OutPort(TimedDouble)
    seen = 0

    def on_execute(self) -> None:
        for small in self.inp.drain():
            self.out.write_nowait(small)
        for large in self.large_in.drain():
            self.large_out.write_nowait(large)
        for array in self.arrays.drain():
            if len(array.data):
                self.seen += 1
            else:
                self.taken.write_nowait(TimedDouble(self.seen, time.process_time()))
                self.seen = 0


class Worker(Component):
    """Does the work that a sample asks for, then sends the sample back."""

    inp = InPort(TimedLong)
    out = OutPort(TimedLong)

    def on_execute(self) -> None:
        for sample in self.inp.drain():
            work(sample.data)
            self.out.write_nowait(sample)


if __name__ == "__main__":
    for line in sys.stdin:
        work(int(line))
        print(line, end="", flush=True)
