"""How a recording is written, and what became of its samples: values, checked when they are made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, Literal, TypeAlias

from aiorts_log.file import Existing
from aiorts_log.forms import ENCODINGS, Encoding

__all__ = ("RecordingOptions", "RecordingStatistics", "Sync")

Sync: TypeAlias = Literal["never", "chunk", "record"]
_MIB: Final = 2**20


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingOptions:
    """How a recording is written.

    Attributes:
        encoding: of the samples: "msgpack", or "json", which Foxglove shows as it is.
        existing: what is to happen when the file is there: "refuse", "append" or "overwrite".
        chunk: octets after which a chunk is written.
        age: seconds after which it is written in any case.
        sync: when to wait for the disk: "never" (a crash of the process loses nothing more), after each "chunk", or
            after each "record", which is then on the disk before the next is taken.
        queue: samples that may wait for the thread; queue_octets: what they may hold.
        part: number of the file to begin with, of a recording in several.
        max_octets: size after which the next file is begun; max_seconds: log time after which it is.
        min_free: octets of the disk that are to stay free; None is 1 GiB, or 5 % of a small disk.

    Raises:
        ValueError: a value makes no sense.
    """

    encoding: Encoding = "msgpack"
    existing: Existing = "refuse"
    chunk: int = 65_536
    age: float = 0.2
    sync: Sync = "never"
    queue: int = 100_000
    queue_octets: int = 64 * _MIB
    part: int = 0
    max_octets: int | None = None
    max_seconds: float | None = None
    min_free: int | None = None

    def __post_init__(self) -> None:
        for name, allowed in (
            ("encoding", ENCODINGS),
            ("existing", ("refuse", "append", "overwrite")),
            ("sync", ("never", "chunk", "record")),
        ):
            if getattr(self, name) not in allowed:
                raise ValueError(f"{name}: expected {' | '.join(allowed)}, got {getattr(self, name)!r}")
        for name, least, most in (
            ("chunk", 1, 64 * _MIB),
            ("age", 0.001, 3600.0),
            ("queue", 1, 10_000_000),
            ("queue_octets", 1, 2**40),
            ("part", 0, 1_000_000),
            ("max_octets", 4096, 2**62),
            ("max_seconds", 0.001, 1e9),
            ("min_free", 0, 2**62),
        ):
            value = getattr(self, name)
            if value is not None and not least <= value <= most:
                raise ValueError(f"{name}: expected {least}..{most}, got {value!r}")


@dataclass(frozen=True, slots=True)
class RecordingStatistics:
    """What became of the samples, at every moment: offered = stored + dropped + refused + waiting.

    Attributes:
        offered: samples given to `write`.
        stored: handed to the system in whole chunks.
        durable: of them, known to be on the disk; 0 with `sync="never"`.
        dropped: by port: no room in the queue, or the recording had ended.
        refused: by port: could not be encoded.
        clamped: samples whose log time was before the one of the sample before, which they were given then.
        octets: in all files; files: how many.
    """

    offered: int = 0
    stored: int = 0
    durable: int = 0
    dropped: Mapping[str, int] = field(default_factory=dict)
    refused: Mapping[str, int] = field(default_factory=dict)
    clamped: int = 0
    octets: int = 0
    files: int = 1

    @property
    def waiting(self) -> int:
        """Samples in the queue or in the open chunk."""
        return self.offered - self.stored - sum(self.dropped.values()) - sum(self.refused.values())
