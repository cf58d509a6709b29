"""A client that operates a kernel and holds its session: `python holding_program.py KERNEL OPERATION=COMPONENT...`.

The operation "begin" begins to activate it and does not wait; "start" starts a context with it.
It says "holds" when all is done. A line on its standard input ends it in order.
"""

from __future__ import annotations

import sys

from aiorts.control import Client, entries

CHANGES = {"configure": {"values": {"": {"step": 2}}}}

entry = next(one for one in entries() if one.name == sys.argv[1])
with Client.open(entry, timeout=20.0, who="the operator") as client:
    for word in sys.argv[2:]:
        operation, _, component = word.partition("=")
        if operation == "begin":
            client.begin("activate", component=component)
            continue
        if operation == "start":
            client.call("start_context", 20.0, name="loop", members=[component], activate=True, options={"rate": 100.0})
            continue
        client.call(operation, 20.0, component=component, **CHANGES.get(operation, {}))
    print("holds", flush=True)
    sys.stdin.readline()
