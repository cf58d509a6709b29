"""A process that knows Zenoh alone and floods a kernel: `python hostile_program.py HOST:PORT HOST/KERNEL/EPOCH`.

It claims one name after the other, sends what is no message, and asks for 15 s.
"""

from __future__ import annotations

import json
import sys
import threading
import time

import zenoh


def main(address: str, whom: str) -> None:
    config = zenoh.Config()
    settings = {"mode": "client", "connect/endpoints": [f"tcp/{address}"], "scouting/multicast/enabled": False}
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    session = zenoh.open(config)
    host, kernel, _ = whom.split("/")
    base = "aiorts/1/default"
    tokens = [session.liveliness().declare_token(f"{base}/live/evil/k/1-{1:016x}-{1:016x}")]

    def claim() -> None:
        names = (f"{base}/live/evil/k{number}/1-{number:016x}-{1:016x}" for number in range(12_000))
        tokens.extend(session.liveliness().declare_token(name) for name in names)

    threading.Thread(target=claim, daemon=True).start()
    beside = (1).to_bytes(8, "little") + bytes(8) + b"evil/k"
    number = 0
    until = time.monotonic() + 15.0  # whatever becomes of who started it
    while time.monotonic() < until:
        for _ in range(200):
            number += 1
            session.put(f"{base}/link/evil/k/{host}/{kernel}/1/w", b"no message")
            session.get(
                f"{base}/svc/{whom}/k/offer",
                zenoh.handlers.Callback(lambda _reply: None),
                attachment=beside,
                timeout=0.5,
            )
        time.sleep(0.02)


main(sys.argv[1], sys.argv[2])
