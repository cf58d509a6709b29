"""A process of its own that puts messages as fast as they are taken, and then one that says so again and again.

`python flooding_program.py HOST:PORT COUNT`, until its standard input ends.
"""

from __future__ import annotations

import json
import sys
import threading

import zenoh

from aiorts_zenoh import NetworkSettings
from aiorts_zenoh.network import engine_settings

address, count = sys.argv[1], int(sys.argv[2])
config = zenoh.Config()
for key, value in engine_settings(NetworkSettings(connect=address, insecure=True)).items():
    config.insert_json5(key, json.dumps(value))
with zenoh.open(config) as session:
    publisher = session.declare_publisher("flood", congestion_control=zenoh.CongestionControl.BLOCK)
    ended = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), ended.set()), daemon=True).start()
    while not publisher.matching_status.matching and not ended.wait(0.01):
        pass
    for _ in range(count):
        publisher.put(bytes(24))
    while not ended.wait(0.05):
        publisher.put(b"last")
