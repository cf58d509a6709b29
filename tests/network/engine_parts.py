"""The bare engine with a certificate, as a program of somebody else would use it."""

from __future__ import annotations

import json
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import zenoh

from aiorts_zenoh.security.folder import Folder, Identity
from aiorts_zenoh.security.tls import Secured, tls_settings

BASE = "aiorts/1/default"


def unchecked(made: Folder, name: str) -> Identity:
    """What a name shows, whatever is wrong with it."""
    role, _ = made.names[name]
    certificate, key, authority = (made.path / f"{word}" for word in (f"{name}.pem", f"{name}.key", "ca.pem"))
    return Identity(name, role, certificate, key, authority)


def with_open_ears(table: dict[str, Any]) -> dict[str, Any]:
    asks = ["declare_subscriber", "declare_queryable", "declare_liveliness_subscriber"]
    rule = {"id": "ears", "messages": asks, "flows": ["egress"], "permission": "allow", "key_exprs": ["**"]}
    policy = {"rules": ["ears"], "subjects": [one["id"] for one in table["subjects"]]}
    return {**table, "rules": [*table["rules"], rule], "policies": [*table["policies"], policy]}


@contextmanager
def session(
    certificates: Folder, name: str, *, guarded: bool, open_ears: bool = False, mode: str = "peer", **endpoints: str
) -> Iterator[Any]:
    """The bare engine with the certificate of a name; unguarded it goes by no table of its own, as a thief's would.

    With `open_ears` it asks others for everything, so that they do send it, and what comes in is as guarded as ever.
    """
    settings = dict(tls_settings(Secured(unchecked(certificates, name), certificates.access), BASE))
    if not guarded:
        del settings["access_control"]
    elif open_ears:
        settings["access_control"] = with_open_ears(settings["access_control"])
    config = zenoh.Config()
    off = ("scouting/multicast/enabled", "scouting/gossip/enabled", "transport/shared_memory/enabled")
    basics: dict[str, Any] = dict.fromkeys(off, False) | {"connect/timeout_ms": 5_000, "connect/exit_on_failure": False}
    basics["mode"] = mode
    ends = {
        f"{end}/endpoints": [f"tls/{one}" for one in endpoints.get(end, "").split()] for end in ("listen", "connect")
    }
    for key, value in (settings | basics | ends).items():
        config.insert_json5(key, json.dumps(value))
    opened = zenoh.open(config)
    try:
        yield opened
    finally:
        opened.close()


class Heard:
    """What comes to a session, whatever its key is."""

    def __init__(self, opened: Any) -> None:
        self.counts: Counter[str] = Counter()
        self.bytes = 0
        self._lock = threading.Lock()
        direct = zenoh.handlers.Callback
        self._kept = [
            opened.declare_subscriber("**", direct(self._sample, indirect=False), allowed_origin=zenoh.Locality.REMOTE),
            opened.declare_queryable("**", direct(lambda query: self._count("query"), indirect=False)),
            opened.liveliness().declare_subscriber("**", direct(lambda one: self._count("token"), indirect=False)),
        ]

    def _sample(self, sample: Any) -> None:
        with self._lock:
            self.bytes += len(sample.payload.to_bytes())
        self._count("put")

    def _count(self, what: str) -> None:
        with self._lock:
            self.counts[what] += 1

    def wait(self, count: int, within: float = 10.0) -> None:
        until = time.monotonic() + within
        while self.counts.total() < count and time.monotonic() < until:
            time.sleep(0.01)
