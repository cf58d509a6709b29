"""Draws the pictures of the page on push policies: which sample arrives when, from a run in virtual time.

Run: python tests/guide_pictures.py, which writes them beside the page; tests/guide/test_pictures.py compares.
"""

from __future__ import annotations

import asyncio
from typing import Any, Final, NamedTuple

from aiorts import Component, InPort, Kernel, OutPort, PeriodicContext, WouldBlock
from aiorts.guide.contents import FOLDER
from aiorts.testing import simulate

WRITER_RATE, READER_RATE, SECONDS = 40.0, 20.0, 1.0
POLICIES: Final[dict[str, dict[str, Any]]] = {
    "flush": {},
    "flush-drain": {},
    "new-new": {"subscription": "new", "push": "new"},
    "new-skip": {"subscription": "new", "push": "skip", "skip": 1},
    "periodic-new": {"subscription": "periodic", "push": "new", "push_rate": 10.0},
    "block": {"full": "block", "length": 2},
}
"""Picture -> the options of its connector."""
_LEFT, _SCALE, _UP, _DOWN = 70.0, 640.0, 24.0, 84.0
_STYLE: Final = (
    "text{font:12px system-ui,sans-serif;fill:#333}.w{fill:#0550ae}.b{fill:#fff;stroke:#0550ae}"
    ".r{fill:#1a7f37}.x{stroke:#b30000;stroke-width:1.5}"
    ".l{stroke:#1a7f37;stroke-opacity:.55}.a{stroke:#999}"
)


class Sample(NamedTuple):
    """One sample of the run; times in seconds since the start."""

    written: float
    read: float | None
    waits: bool
    """Whether it is in the buffer when the second is over."""


class _Writer(Component):
    out = OutPort(int)

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.times: list[float] = []

    async def on_execute(self) -> None:
        await self.out.write(len(self.times))
        self.times.append(self.clock.time())


class _Reader(Component):
    inp = InPort(int)

    def __init__(self, name: str, *, takes_all: bool) -> None:
        super().__init__(name)
        self.takes_all = takes_all
        self.times: dict[int, float] = {}

    async def on_execute(self) -> None:
        try:
            numbers = self.inp.drain() if self.takes_all else [self.inp.read_nowait()]
        except WouldBlock:
            return
        self.times.update(dict.fromkeys(numbers, self.clock.time()))


async def _run(name: str) -> list[Sample]:
    async with Kernel() as kernel:
        reader = await kernel.add(_Reader("reader", takes_all=name.endswith("drain")))
        writer = await kernel.add(_Writer("writer"))
        await kernel.connect(writer.out, reader.inp, **POLICIES[name])
        start = kernel.clock.time()
        await kernel.start(PeriodicContext(READER_RATE, timing=False), reader, activate=True)
        await kernel.start(PeriodicContext(WRITER_RATE, timing=False), writer, activate=True)
        await asyncio.sleep(SECONDS)
        waiting = reader.inp.drain()
        return [
            Sample(
                round(at - start, 6),
                round(reader.times[number] - start, 6) if number in reader.times else None,
                number in waiting,
            )
            for number, at in enumerate(writer.times)
        ]


def samples(name: str) -> list[Sample]:
    """What was written in a second, and when it was read."""
    return simulate(_run(name))


def drawn(name: str) -> str:
    """The picture as SVG, on a background of its own, so that it is readable on a light and on a dark page."""
    width, height = _LEFT + _SCALE + 20, _DOWN + 38
    lines, marks = [], []
    for sample in samples(name):
        x = _LEFT + sample.written * _SCALE
        kind = "w" if sample.read is not None else "b" if sample.waits else "x"
        marks.append(
            f'<path class="x" d="M{x - 4:g} {_UP - 4:g}l8 8m0 -8l-8 8"/>'
            if kind == "x"
            else f'<circle class="{kind}" cx="{x:g}" cy="{_UP:g}" r="4"/>'
        )
        if sample.read is not None:
            end = _LEFT + sample.read * _SCALE
            lines.append(f'<line class="l" x1="{x:g}" y1="{_UP:g}" x2="{end:g}" y2="{_DOWN:g}"/>')
            marks.append(f'<circle class="r" cx="{end:g}" cy="{_DOWN:g}" r="4"/>')
    ticks = "".join(
        f'<line class="a" x1="{at:g}" y1="{_DOWN + 8:g}" x2="{at:g}" y2="{_DOWN + 14:g}"/>'
        f'<text x="{at:g}" y="{_DOWN + 28:g}" text-anchor="middle">{tenth / 10:g} s</text>'
        for tenth in range(0, 11, 2)
        for at in [_LEFT + tenth / 10 * _SCALE]
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}" height="{height:g}" '
        f'viewBox="0 0 {width:g} {height:g}">\n'
        f"<style>{_STYLE}</style>\n"
        f'<rect width="{width:g}" height="{height:g}" rx="6" fill="#fff"/>\n'
        f'<text x="8" y="{_UP + 4:g}">written</text><text x="8" y="{_DOWN + 4:g}">read</text>\n{ticks}\n'
        + "\n".join([*lines, *marks, "</svg>\n"])
    )


if __name__ == "__main__":
    for one in POLICIES:
        (FOLDER / "howto" / f"policy-{one}.svg").write_text(drawn(one), encoding="utf-8")
