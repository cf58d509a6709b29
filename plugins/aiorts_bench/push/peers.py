"""Measures other installed libraries: imported late, on the loopback only, and left out when they fail."""

from __future__ import annotations

import socket
import struct
import tempfile
import threading
from collections import deque
from collections.abc import Callable
from importlib.util import find_spec
from itertools import repeat
from pathlib import Path
from time import perf_counter_ns
from typing import Any, Final

from aiorts.errors import MissingExtra
from aiorts_bench.harness.case import COST, RATE, Aim, Case, Reading

PACKAGES: Final = {"reactivex": "reactivex", "zmq": "pyzmq", "zenoh": "eclipse-zenoh", "dora": "dora-rs"}
"""The name of each distribution, by the name of its module."""
DORA: Final = "needs a coordinator, a daemon and a process for each node; it has no way of sending within one process"
_FRAME: Final = struct.pack("<qd", 0, 1.0)
"""A time and a float: the message where objects cannot be passed."""
_PATIENCE: Final = 5.0
"""Seconds that a peer has for each wait."""
_WINDOW: Final = 100
"""Messages under way at once where a queue of the operating system lies between."""


def reactivex_subject(count: int) -> Reading:
    """Call `Subject.on_next` with an observer that fills a deque, which is read in the same task."""
    import reactivex.subject  # type: ignore[import-not-found, unused-ignore]

    taken: deque[float] = deque()
    subject: Any = reactivex.subject.Subject()
    with subject.subscribe(taken.append):
        put, get = subject.on_next, taken.popleft
        began = perf_counter_ns()
        for _ in repeat(None, count):
            put(1.0)
            get()
        return Reading.timed(count, perf_counter_ns() - began)


def _zmq_pair(endpoint: str, count: int, window: int) -> Reading:
    import zmq  # type: ignore[import-not-found, unused-ignore]

    context: Any = zmq.Context()
    reader, writer = context.socket(zmq.PAIR), context.socket(zmq.PAIR)
    try:
        for end in (reader, writer):
            # Without this, term() waits for messages that are never read.
            end.setsockopt(zmq.LINGER, 0)
            end.setsockopt(zmq.RCVTIMEO, int(_PATIENCE * 1000))
            end.setsockopt(zmq.SNDTIMEO, int(_PATIENCE * 1000))
        reader.bind(endpoint)
        writer.connect(endpoint)
        began = perf_counter_ns()
        for _ in repeat(None, max(1, count // window)):
            for _ in repeat(None, window):
                writer.send(_FRAME)
            for _ in repeat(None, window):
                reader.recv()
        return Reading.timed(max(1, count // window) * window, perf_counter_ns() - began)
    finally:
        writer.close()
        reader.close()
        context.term()


def zmq_inproc(count: int) -> Reading:
    """Send through a pair of sockets within the process, in one thread."""
    return _zmq_pair("inproc://aiorts", count, 1)


def zmq_ipc(count: int) -> Reading:
    """Send through a pair of sockets over a local socket file, in one thread."""
    with tempfile.TemporaryDirectory(prefix="aiorts") as folder:
        return _zmq_pair(f"ipc://{Path(folder) / 'bench'}", count, _WINDOW)


def zenoh_loopback(count: int) -> Reading:
    """Publish between two sessions over TCP on 127.0.0.1, without scouting.

    Raises:
        TimeoutError: messages are missing after five seconds.
    """
    import zenoh  # type: ignore[import-not-found, unused-ignore]

    endpoint = f"tcp/127.0.0.1:{free_port()}"
    arrived, lock = threading.Event(), threading.Lock()
    left = [1]

    def take(sample: Any) -> None:
        with lock:
            left[0] -= 1
            if left[0] == 0:
                arrived.set()

    def wait() -> None:
        if not arrived.wait(_PATIENCE):
            raise TimeoutError(f"{left[0]} messages missing after {_PATIENCE:g} s")

    with (
        zenoh.open(zenoh_config(zenoh, "listen", endpoint)) as listening,
        zenoh.open(zenoh_config(zenoh, "connect", endpoint)) as connecting,
    ):
        subscriber: Any = listening.declare_subscriber("aiorts/bench", take)
        publisher: Any = connecting.declare_publisher("aiorts/bench", congestion_control=zenoh.CongestionControl.BLOCK)
        for _ in range(int(_PATIENCE * 100)):  # until the two have met
            publisher.put(_FRAME)
            if arrived.wait(0.01):
                break
        wait()
        arrived.clear()
        with lock:
            left[0] = count
        began = perf_counter_ns()
        for _ in repeat(None, count):
            publisher.put(_FRAME)
        wait()
        elapsed = perf_counter_ns() - began
        subscriber.undeclare()
        publisher.undeclare()
        return Reading.timed(count, elapsed)


def zenoh_config(zenoh: Any, role: str, endpoint: str) -> Any:
    config = zenoh.Config()
    config.insert_json5("mode", '"peer"')
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("scouting/gossip/enabled", "false")
    config.insert_json5("listen/endpoints", "[]")
    config.insert_json5("connect/endpoints", "[]")
    config.insert_json5(f"{role}/endpoints", f'["{endpoint}"]')
    return config


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


_CASES: Final[tuple[tuple[str, str, str, Callable[[int], Reading], int], ...]] = (
    ("reactivex", "reactivex Subject", "on_next into an observer's deque, one task", reactivex_subject, 10_000),
    ("zmq", "pyzmq inproc", "16 bytes through a pair of sockets, one thread", zmq_inproc, 3_000),
    ("zmq", "pyzmq ipc", f"16 bytes, a local socket file, one thread, {_WINDOW} at once", zmq_ipc, 2_000),
    ("zenoh", "eclipse-zenoh tcp", "16 bytes, two sessions in one process over 127.0.0.1", zenoh_loopback, 2_000),
)


def cases(base: str = "flush") -> tuple[tuple[Case, ...], tuple[str, ...]]:
    """A case for each peer that is installed and works, and a line for each that is left out."""
    found, notes = [], []
    for module, name, what, run, messages in _CASES:
        if find_spec(module) is None:
            notes.append(f"peer left out: {MissingExtra(name, PACKAGES[module], 'bench')}")
            continue
        try:
            run(1)
        except (ImportError, OSError, RuntimeError, AttributeError) as error:  # a peer's TimeoutError is an OSError
            notes.append(f"peer left out: {name}: {type(error).__name__}: {error}")
            continue
        found.append(Case(name, what, COST, run, messages, (Aim(base),), columns=(RATE,), peer=True))
    if find_spec("dora") is not None:
        notes.append(f"peer left out: {PACKAGES['dora']} {DORA}")
    return tuple(found), tuple(dict.fromkeys(notes))
