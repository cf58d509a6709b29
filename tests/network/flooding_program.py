"""A process of its own that puts messages as fast as they are taken, until its standard input ends.

`python flooding_program.py HOST:PORT`
"""

from __future__ import annotations

import json
import sys
import threading

import zenoh

from aiorts_zenoh import NetworkSettings
from aiorts_zenoh.network import engine_settings

config = zenoh.Config()
for key, value in engine_settings(NetworkSettings(connect=sys.argv[1], insecure=True)).items():
    config.insert_json5(key, json.dumps(value))
with zenoh.open(config) as session:
    publisher = session.declare_publisher("flood", congestion_control=zenoh.CongestionControl.BLOCK)
    ended = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), ended.set()), daemon=True).start()
    while not ended.is_set():
        publisher.put(bytes(24))
