"""A client that follows the profile of a kernel: `python watching_program.py KERNEL`. A line for each that comes."""

from __future__ import annotations

import json
import sys
from itertools import chain

from aiorts.sessions import Client, entries

entry = next(one for one in entries() if one.name == sys.argv[1])
with Client.open(entry, timeout=20.0) as client:
    stream = client.stream("changes", 20.0)
    for item in chain([stream.began], stream):
        print(json.dumps([item["kind"], item["sequence"], json.dumps(item).count("0.125")]), flush=True)
