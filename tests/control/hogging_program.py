"""A client that has as many connections as it is given: `python hogging_program.py KERNEL COUNT [RIGHT]`.

It prints how many it has and what it was told, and ends with its standard input.
"""

from __future__ import annotations

import sys
from typing import cast

from aiorts.errors import AiortsError
from aiorts.sessions import Client, RightName, entries

entry = next(one for one in entries() if one.name == sys.argv[1])
right = cast("RightName", sys.argv[3] if sys.argv[3:] else "")
clients: list[Client] = []
refusals: set[str] = set()
for _ in range(int(sys.argv[2])):
    try:
        clients.append(Client.open(entry, timeout=20.0, right=right))
    except AiortsError as error:
        refusals.add(f"{error.code} {error}")
print(len(clients), *sorted(refusals), sep="\n", end="\n\n", flush=True)
sys.stdin.read()
