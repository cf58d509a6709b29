"""The options of a recording, validated, and the counts of its samples."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, Literal, TypeAlias

from aiorts_log.mcap.encodings import ENCODINGS, Encoding
from aiorts_log.mcap.locked_file import Existing

Sync: TypeAlias = Literal["never", "chunk", "record"]
_MIB: Final = 2**20


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingOptions:
    """The options for writing a recording.

    Attributes:
        encoding: of the samples: "msgpack", or "json", which Foxglove shows as it is.
        existing: what to do when the file exists: "refuse", "append" or "overwrite".
        chunk: bytes after which a chunk is written.
        age: seconds after which a chunk is written in any case.
        sync: when to wait for the disk: "never" (a crash of the process loses nothing more), after each "chunk", or
            after each "record", which is then on the disk before the next is taken.
        queue: samples that may wait for the thread; queue_bytes: bytes that they may hold.
        part: number of the first file, for a recording in several.
        max_bytes: size after which the next file begins; max_seconds: log time after which it does.
        min_free: bytes of the disk to leave free; None is 1 GiB, or 5 % of a small disk.

    Raises:
        ValueError: a value makes no sense.
    """

    encoding: Encoding = "msgpack"
    existing: Existing = "refuse"
    chunk: int = 65_536
    age: float = 0.2
    sync: Sync = "never"
    queue: int = 100_000
    queue_bytes: int = 64 * _MIB
    part: int = 0
    max_bytes: int | None = None
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
            ("queue_bytes", 1, 2**40),
            ("part", 0, 1_000_000),
            ("max_bytes", 4096, 2**62),
            ("max_seconds", 0.001, 1e9),
            ("min_free", 0, 2**62),
        ):
            value = getattr(self, name)
            if value is not None and not least <= value <= most:
                raise ValueError(f"{name}: expected {least}..{most}, got {value!r}")


@dataclass(frozen=True, slots=True)
class RecordingStatistics:
    """The counts of samples, at every moment: offered = stored + dropped + refused + waiting.

    Attributes:
        offered: samples given to `write`.
        stored: samples given to the system in whole chunks.
        durable: stored samples known to be on the disk; 0 with `sync="never"`.
        dropped: by port: no room in the queue, or the recording had ended.
        refused: by port: could not be encoded.
        reasons: by port, the refused samples by the reason that the encoding gives.
        clamped: samples whose log time went back, and was replaced by that of the sample before.
        size: bytes of all files.
        files: the number of files.
    """

    offered: int = 0
    stored: int = 0
    durable: int = 0
    dropped: Mapping[str, int] = field(default_factory=dict)
    refused: Mapping[str, int] = field(default_factory=dict)
    reasons: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    clamped: int = 0
    size: int = 0
    files: int = 1

    @property
    def waiting(self) -> int:
        """Samples in the queue or in the open chunk."""
        return self.offered - self.stored - sum(self.dropped.values()) - sum(self.refused.values())
