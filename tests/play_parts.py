"""What the tests of replay share: recordings made to measure, and a player whose samples are written down."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

from aiorts import Clock, Kernel
from aiorts.types import TimedDouble, TimedLong
from aiorts_log import RecordingOptions, RecordingWriter
from aiorts_log.mcap.chunks import ChunkBuilder
from aiorts_log.mcap.encodings import encoder, schema_of
from aiorts_log.mcap.format import DATA_END, HEADER, MAGIC, Channel, record, text
from aiorts_log.playing.player import Player, Playing
from aiorts_log.playing.read_ahead import Reading
from aiorts_log.playing.schedule import Pace
from aiorts_log.text.opening import open_recording

BEGIN = 1_700_000_000_000_000_000
MS = 1_000_000
S = 1_000_000_000


def recorded(path: Path, samples: list[tuple[str, int, Any]], **options: Any) -> Path:
    """A recording of these samples: port, log time, record."""
    with RecordingWriter(path, RecordingOptions(**{"min_free": 0, **options})) as writer:
        ports: dict[str, int] = {}
        for port, log_time, sample in samples:
            if port not in ports:
                ports[port] = writer.add_port(port, type(sample))
            assert writer.write(ports[port], sample, log_time)
    assert writer.failure is None
    return path


def steady(path: Path, count: int, step: int = 10 * MS, **options: Any) -> Path:
    """A recording of two ports by turns, `step` ns apart, whose stamps are their log times."""
    types = TimedDouble, TimedLong
    return recorded(
        path,
        [("ab"[i % 2], BEGIN + i * step, types[i % 2](BEGIN + i * step, i)) for i in range(count)],
        **options,
    )


class Unordered(ChunkBuilder):
    """A chunk whose log times go back."""

    start = end = 0  # type: ignore[assignment]


def foreign(path: Path, times: list[int], *, numbered: bool = True, type_name: str = "") -> Path:
    """A recording as somebody else's writer makes it: log times as its clock had them, chunk after chunk.

    Args:
        numbered: whether its samples have numbers.
        type_name: of another port, "b", with a sample for each; "" is that there is none.
    """
    encode = encoder("msgpack", TimedLong)
    raw = MAGIC + record(HEADER, text(""), text("somebody"))
    for first in range(0, len(times), 20):
        builder = Unordered()
        builder.define(schema_of(1, TimedLong, "msgpack"))
        builder.define(Channel(1, 1, "a", "msgpack", {}))
        if type_name:
            builder.define(schema_of(1, TimedLong, "msgpack")._replace(id=2, name=type_name))
            builder.define(Channel(2, 2, "b", "msgpack", {}))
        part = times[first : first + 20]
        for number, time in enumerate(part, start=first):
            for channel in (1, 2) if type_name else (1,):
                builder.add(channel, number if numbered else 0, time, time, encode(TimedLong(0, number)))
        builder.start, builder.end = min(part), max(part)
        parts, _ = builder.take(len(raw))
        raw += b"".join(parts)
    path.write_bytes(raw + record(DATA_END, struct.pack("<I", 0)))
    return path


class Played:
    """A player, and what it has sent: the moment of the clock, the port, the record."""

    def __init__(
        self, kernel: Kernel, path: Path, pace: Pace | None = None, *, opened: Any = open_recording, **how: Any
    ) -> None:
        self.samples: list[tuple[int, str, Any]] = []
        self.told: list[str] = []
        self._clock: Clock = kernel.clock
        with open_recording(path) as reader:
            types = {name: (name, port.type) for name, port in reader.ports.items()}
        chosen = {name: how.pop(name, None) for name in ("start", "end")}
        self.player = Player(
            Reading(lambda: opened(path), types, **chosen),
            Playing(pace=pace or Pace(), **how),
            clock=kernel.clock,
            sleep=kernel.sleep,
            send=self.take,
            notify=self.told.append,
        )

    async def take(self, port: str, sample: Any) -> None:
        self.samples.append((self._clock.monotonic_ns(), port, sample))

    @property
    def moments(self) -> list[int]:
        """When samples were sent, in ns after the first."""
        return [moment - self.samples[0][0] for moment, _, _ in self.samples]

    @property
    def values(self) -> list[Any]:
        return [sample.data for _, _, sample in self.samples]

    @property
    def stamps(self) -> list[int]:
        return [sample.tm for _, _, sample in self.samples]
