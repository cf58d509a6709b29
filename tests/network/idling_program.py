"""A process of its own that opens connections from one address, says nothing on them, and closes them at once.

`python idling_program.py HOST:PORT COUNT FROM` prints how many are open, and how many are closed when they are. It ends
when its standard input does.
"""

from __future__ import annotations

import resource
import socket
import sys
from contextlib import suppress

_, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
host, port = sys.argv[1].rsplit(":", 1)
opened = []
for _ in range(int(sys.argv[2])):
    with suppress(OSError):  # a firewall refuses it
        opened.append(socket.create_connection((host, int(port)), 5.0, source_address=(sys.argv[3], 0)))
print(f"{len(opened)} open", flush=True)
for one in opened:
    one.close()
print(f"{len(opened)} closed", flush=True)
sys.stdin.read()
