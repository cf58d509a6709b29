"""Many kernels that are simulated with `zenoh` and `msgpack` alone, as SPEC.md says: they are there, and answer calls.

    python fleet_program.py HOST:PORT COUNT [SILENT]

It listens. Each kernel has a token, and answers `hello` and `names`; the first SILENT of them never answer.
"""

from __future__ import annotations

import json
import os
import sys
import threading
from functools import partial
from typing import Any

import msgpack
import zenoh


def _keep(held: list[Any], query: Any) -> None:
    held.append(query)


def _answer(key: str, said: dict[str, bytes], query: Any) -> None:
    caller, operation = str(query.key_expr).split("/")[-2:]
    if operation in said:
        query.reply(f"aiorts/1/default/info/{key}/{caller}/{operation}", said[operation])


def main(where: str, count: int, silent: int) -> None:
    config = zenoh.Config()
    config.insert_json5("mode", '"peer"')
    config.insert_json5("listen/endpoints", json.dumps([f"tcp/{where}"]))
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("scouting/gossip/enabled", "false")
    held: list[Any] = []
    with zenoh.open(config) as session:
        for number in range(count):
            host, name, epoch = f"host{number // 10}", f"robot{number}", f"{number + 1:016x}"
            key = f"{host}/{name}/{epoch}"
            own = {"address": f"{host}/{name}", "pid": os.getpid()}
            hello = {**own, "epoch": epoch, "kernel": name, "right": "view"}
            names = {**own, "state": "open", "components": {f"drive{number}": {"loop": "active"}}, "links": name}
            names |= {"contexts": {"loop": [f"drive{number}"]}, "connectors": {}, "in_error": []}
            said = {"hello": msgpack.packb({"ok": hello}), "names": msgpack.packb({"ok": names})}
            asked = partial(_keep, held) if number < silent else partial(_answer, key, said)
            callback = zenoh.handlers.Callback(asked, indirect=False)
            held.append(session.declare_queryable(f"aiorts/1/default/info/{key}/*/*", callback, complete=True))
            token = f"aiorts/1/default/live/{host}/{name}/{number + 1}-{epoch}-{number // 10:016x}"
            held += [session.liveliness().declare_token(one) for one in (token, f"{token}/own")]
        print("ready", flush=True)
        threading.Event().wait()


main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]) if len(sys.argv) > 3 else 0)
