"""An attacker that makes single calls with a viewer's certificate, all at once: no session, no waiting for answers.

`python calling_program.py HOST:PORT CERTIFICATES NAME COUNT OPERATION`; it says how many were answered, how many were
refused as too many, and how many in another way. With "session" it begins as many sessions, each with a hello, and says
how many messages have come back. It ends when its standard input does, and all have come back, or `LAST` seconds later:
beside other programs two thousand take longer than a round.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from collections import Counter
from pathlib import Path

import msgpack
import zenoh

from aiorts.errors import BusyError
from aiorts.links import Peer
from aiorts.sessions import framed
from aiorts.sessions.protocol import NEWEST, OLDEST
from aiorts_zenoh import NetworkSettings
from aiorts_zenoh.envelope import FRAME, message
from aiorts_zenoh.keys import HELLO, INFO, ClientKeys, peer_of
from aiorts_zenoh.network import engine_settings
from aiorts_zenoh.security.access import VIEWER
from aiorts_zenoh.security.tls import secured_by

ADDRESS, CERTIFICATES, NAME, COUNT, OPERATION = sys.argv[1:]
SECONDS = 30.0
LAST = 4.0  # less than a round waits for the end of its attacker

config = zenoh.Config()
secured = secured_by(Path(CERTIFICATES), NAME, (VIEWER,))
settings = NetworkSettings(connect=ADDRESS, certificates=Path(CERTIFICATES))
for key, value in engine_settings(settings, secured).items():
    config.insert_json5(key, json.dumps(value))
keys = ClientKeys("default", NAME)
found: Counter[str] = Counter()
all_came, ended = threading.Event(), threading.Event()
threading.Thread(target=lambda: (sys.stdin.read(), all_came.wait(LAST), ended.set()), daemon=True).start()


def count(what: str) -> None:
    found[what] += 1
    if found.total() >= int(COUNT):
        all_came.set()


def came(reply: zenoh.Reply) -> None:
    if reply.ok is None:
        count("other")
        return
    answer = msgpack.unpackb(reply.ok.payload.to_bytes())
    if "error" in answer and answer["error"]["code"] == BusyError.code:
        count("refused")
    else:
        count("other" if "error" in answer else "answered")


def victim(session: zenoh.Session) -> Peer:
    until = time.monotonic() + SECONDS
    while time.monotonic() < until:
        for reply in session.get(keys.every(INFO, HELLO), target=zenoh.QueryTarget.ALL, timeout=2.0):
            if reply.ok is not None and (peer := peer_of(str(reply.ok.key_expr))) is not None:
                return peer
    raise SystemExit("there is no kernel")


def calls(session: zenoh.Session, peer: Peer) -> None:
    key = keys.session(INFO, peer, OPERATION)
    for _ in range(int(COUNT)):
        if ended.is_set():
            break
        session.get(key, zenoh.handlers.Callback(came, indirect=False), timeout=SECONDS)
    ended.wait()


def sessions(session: zenoh.Session, peer: Peer) -> None:
    def heard(_: zenoh.Sample) -> None:
        count("answered")

    hello = framed({"hello": {"oldest": OLDEST, "newest": NEWEST, "who": "it"}})
    subscribers = [session.declare_subscriber(keys.answers(INFO), heard)]
    for number in range(int(COUNT)):
        if ended.is_set():
            break
        key = keys.session(INFO, peer, f"{number:016x}")
        session.put(f"{key}/c", message(FRAME, number, 0, time.time_ns(), [hello]))
    ended.wait()
    subscribers.clear()


with zenoh.open(config) as session:
    peer = victim(session)
    print(flush=True)
    (sessions if OPERATION == "session" else calls)(session, peer)
print(f"answered={found['answered']} refused={found['refused']} other={found['other']}", flush=True)
