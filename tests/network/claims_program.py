"""An attacker that claims names: `python claims_program.py HOST:PORT FOLDER NAME HOST COUNT HOW`.

It has the certificate of NAME and goes by no table of its own. It declares COUNT tokens of kernels on HOST, until its
standard input ends; HOW: `one` name from many machines, `kernels` of many names, `comes`, and goes again and again.
"""

from __future__ import annotations

import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

from engine_parts import BASE, session  # its folder is the first where this program looks

from aiorts_zenoh.security.folder import Folder

address, certificates, name, host, count, how = sys.argv[1:]
ended = threading.Event()
with session(Folder(Path(certificates)), name, guarded=False, mode="client", connect=address) as opened:
    print("begins", flush=True)
    threading.Thread(target=lambda: (sys.stdin.read(), ended.set()), daemon=True).start()
    print(f'start {time.monotonic():.2f}', flush=True)
    began, tokens = time.monotonic(), []
    for number in range(int(count)):
        if ended.is_set():
            break
        kernel = f"{name}-{number}" if how == "kernels" else name
        token = f"{BASE}/live/{host}/{kernel}/1-{number:016x}-{number:016x}"
        for one in (token, f"{token}/own"):
            with suppress(Exception):
                tokens.append(opened.liveliness().declare_token(one))
        if how == "comes":
            for one in tokens:
                one.undeclare()
            tokens.clear()
    print(f"{number + 1} claims in {time.monotonic() - began:.2f} s", flush=True)
    print(f"declared {time.monotonic():.2f}", flush=True)
    ended.wait()
    print(f"ended {time.monotonic():.2f}", flush=True)
print(f"closed {time.monotonic():.2f}", flush=True)
