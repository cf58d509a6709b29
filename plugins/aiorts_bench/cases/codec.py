"""`aiorts bench codec`: records to bytes and back, next to codecs that check nothing, on the same values."""

from __future__ import annotations

import importlib
import json
import operator
import pickle
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import repeat
from time import perf_counter_ns
from types import MappingProxyType
from typing import Any, Final

import msgpack  # type: ignore[import-untyped]
import numpy as np

from aiorts import Catalogue
from aiorts.errors import MissingExtra, PluginError
from aiorts.types import TimedDouble, TimedDoubleSeq, TimedOctetSeq, to_plain
from aiorts.wire import MsgpackCodec, find_codec
from aiorts_bench.harness.bench import Bench, Options
from aiorts_bench.harness.case import COST, RATE, Aim, Case, Measure, Reading
from aiorts_bench.harness.report import Report

_SIZE: Final = Measure("frame", "B")
_ENCODE: Final = Measure("encode", "ns")
_DECODE: Final = Measure("decode", "ns")
_OURS: Final = "msgpack"
"""The name of aiorts' own codec among the entry points `aiorts.codecs`."""
_WHAT: Final = {"aiorts": "record, checked on both sides"}
_COLUMNS: Final = (_ENCODE, _DECODE, _SIZE, RATE)

Pair = tuple[Callable[[Any], Any], Callable[[Any], Any]]


@dataclass(frozen=True, slots=True)
class Payload:
    """A record to encode, and the same values in the form that other codecs take.

    Attributes:
        bare: a tuple for codecs that carry bytes, with arrays as bytes. text: the form for JSON, with arrays as lists.
    """

    name: str
    record: Any
    bare: Any
    text: Any
    messages: int


def _payloads() -> tuple[Payload, ...]:
    large, image = np.arange(10_000, dtype=np.float64), bytes(range(256)) * 4096
    six = [0.5, 1.5, -2.5, 3.25, 4.0, 5.0]
    return (
        Payload("float", TimedDouble(1, 1.5), (1, 1.5), [1, 1.5], 3000),
        Payload("6 doubles", TimedDoubleSeq(1, six), (1, np.array(six).tobytes()), [1, six], 2000),
        Payload("80 kB", TimedDoubleSeq(1, large.copy()), (1, large.tobytes()), [1, large.tolist()], 30),
        Payload("1 MB image", TimedOctetSeq(1, image), (1, image), [1, image.decode("latin-1")], 20),
    )


PAYLOADS: Final = _payloads()


def _run(codec: Pair, value: Any, check: Callable[[Any], bool], count: int) -> Reading:
    """Encode, then decode, `count` times each."""
    encode, decode = codec
    frame = encode(value)
    faults = () if check(decode(frame)) else ("the decoded value differs from the encoded one",)
    began = perf_counter_ns()
    for _ in repeat(None, count):
        encode(value)
    middle = perf_counter_ns()
    for _ in repeat(None, count):
        decode(frame)
    ended = perf_counter_ns()
    each = {"encode": (middle - began) / count, "decode": (ended - middle) / count, "frame": float(len(frame))}
    return replace(Reading.timed(count, ended - began, None, **each), faults=faults)


def _codecs() -> dict[str, tuple[Pair, str]]:
    """Encode and decode by name, and the attribute of `Payload` that they take."""
    ours = MsgpackCodec()
    pack = partial(msgpack.packb, use_bin_type=True)
    unpack = partial(msgpack.unpackb, raw=False, use_list=False, max_bin_len=2**24)
    found: dict[str, tuple[Pair, str]] = {
        "msgpack": ((pack, unpack), "bare"),
        "pickle 5": ((partial(pickle.dumps, protocol=5), pickle.loads), "bare"),  # loads only dumps of this bench
        "json": ((lambda value: json.dumps(value).encode(), json.loads), "text"),
    }
    try:
        msgspec: Any = importlib.import_module("msgspec")
    except ImportError:
        pass
    else:
        found["msgspec"] = ((msgspec.msgpack.encode, partial(msgspec.msgpack.decode, type=tuple)), "bare")
    found["aiorts"] = ((ours.encode, ours.decode), "record")
    return found


def _of_plugins() -> tuple[dict[str, tuple[Pair, str]], tuple[str, ...]]:
    """The codecs that plugins offer, and a note for each that cannot be loaded."""
    found: dict[str, tuple[Pair, str]] = {}
    notes = []
    for name in Catalogue.default().extensions("codecs"):
        if name == _OURS:
            continue
        try:
            codec = find_codec(name)
        except PluginError as error:
            notes.append(f"left out: {error}")
        else:
            found[name if name not in _codecs() else f"{name} of a plugin"] = (codec.encode, codec.decode), "record"
    return found, tuple(notes)


def cases(others: Mapping[str, tuple[Pair, str]] = MappingProxyType({})) -> tuple[Case, ...]:
    """A case for each payload and codec, those of `others` included; aiorts is compared with msgpack and pickle."""
    made = []
    for payload in PAYLOADS:
        for name, (pair, attribute) in {**_codecs(), **others}.items():
            value = getattr(payload, attribute)
            check = partial(_same_record if attribute == "record" else operator.eq, value)
            aims = tuple(Aim(f"{base}, {payload.name}") for base in ("msgpack", "pickle 5")) if name == "aiorts" else ()
            what = _WHAT.get(name, "record, a plugin's codec" if name in others else "the same values, nothing checked")
            run = partial(_run, pair, value, check)
            made.append(Case(f"{name}, {payload.name}", what, COST, run, payload.messages, aims, columns=_COLUMNS))
    return tuple(made)


def _same_record(sent: Any, back: Any) -> bool:
    return type(sent) is type(back) and bool(to_plain(sent) == to_plain(back))


def report(options: Options) -> Report:
    """Measure every codec."""
    others, notes = _of_plugins()
    rows = options.rows(cases(others))
    has_msgspec = any(row.case.name.startswith("msgspec") for row in rows)
    missing = () if has_msgspec else (str(MissingExtra("the baseline msgspec", "msgspec", "bench")),)
    how = "Cost is one encode and one decode; JSON carries arrays as lists of numbers and bytes as text."
    return options.report("codec", rows, notes=(*missing, *notes), how=how)


BENCH: Final = Bench(
    "codec", "Records to bytes and back, beside msgpack, pickle and json on the same values.", report, loops=False
)
