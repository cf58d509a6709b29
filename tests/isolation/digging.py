"""Work in pure Python, of a component or without one."""

from __future__ import annotations

from aiorts import Component, InPort, OutPort
from aiorts.types import TimedLong


def dig(turns: int) -> int:
    """Turn a number over so many times."""
    value = 1
    for _ in range(turns):
        value = (value * 1_103_515_245 + 12_345) & 0x7FFFFFFF
    return value


class Digger(Component):
    """Works in pure Python, as long as each sample says."""

    inp = InPort(TimedLong)
    out = OutPort(TimedLong)

    def on_execute(self) -> None:
        for sample in self.inp.drain():
            self.out.write_nowait(TimedLong(sample.tm, dig(sample.data)))
