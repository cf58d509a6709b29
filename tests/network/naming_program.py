"""A client that names files in every way to a kernel: `python naming_program.py KERNEL HOME PLACE...`.

It prints the code of each refusal as JSON, by way and place; "" where it was done.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from aiorts.errors import AiortsError
from aiorts.sessions import Client, entries
from file_parts import PLACES, WAYS

entry = next(one for one in entries() if one.name == sys.argv[1])
home = Path(sys.argv[2])
found: dict[str, str] = {}
with Client.open(entry, timeout=20.0) as client:
    for way, call in WAYS.items():
        for place in sys.argv[3:]:
            operation, arguments = call(str(home / PLACES[place][0]), home)
            try:
                client.result(client.begin(operation, **arguments), 20.0)
                found[f"{way}, {place}"] = ""
            except AiortsError as error:
                found[f"{way}, {place}"] = error.code
print(json.dumps(found))
