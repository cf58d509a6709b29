"""A client that operates a kernel and holds its session: `python holding_program.py KERNEL OPERATION=COMPONENT...`.

The operation "begin" begins to activate it and does not wait; "start" starts a context with it. "load", "apply" and
"change" are of the file FILE instead, and "begin_apply" does not wait. It says "holds" when all is done. A line on its
standard input ends it in order.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from aiorts.sessions import Client, entries

CHANGES: dict[str, dict[str, Any]] = {"configure": {"values": {"": {"step": 2}}}}


def wanted_in(file: str) -> tuple[str, ...]:
    """The system of a file, as it is sent."""
    from aiorts.model.wanted.carried import carried
    from aiorts.system import load, wanted

    return (carried(wanted(load(file))),)


def carry_out(client: Client, operation: str, what: str) -> None:
    """One word."""
    if operation == "begin":
        client.begin("activate", component=what)
    elif operation == "start":
        client.call("start_context", 20.0, name="loop", members=[what], activate=True, options={"rate": 100.0})
    elif operation == "load":
        client.call("load_configuration", 20.0, parts=(Path(what).read_text(),))
    elif operation == "apply":
        client.call("apply", 20.0, wanted=wanted_in(what))
    elif operation == "begin_apply":
        client.begin("apply", wanted=wanted_in(what))
    elif operation == "change":
        client.call("change", 20.0, wanted=wanted_in(what))
        client.call("decide", 20.0, keep=True)
    else:
        client.call(operation, 20.0, component=what, **CHANGES.get(operation, {}))


entry = next(one for one in entries() if one.name == sys.argv[1])
with Client.open(entry, timeout=20.0, who="the operator") as client:
    for word in sys.argv[2:]:
        carry_out(client, *word.split("=", 1))
    print("holds", flush=True)
    sys.stdin.readline()
