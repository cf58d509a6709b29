"""Up to 60 processes in sessions of their own that end and start one another anew, for a few seconds and no longer.

    python bomb.py FILE UNTIL

Args:
    FILE: where they see how many there are.
    UNTIL: of `time.monotonic`, when the last ends by itself.
"""

from __future__ import annotations

import mmap
import os
import random
import signal
import sys
import time

ALIVE, FORKS, LATE = 60, 10_000, 0.3


def main(path: str, until: float) -> None:
    """Have others started in the place of each that was not seen for LATE seconds."""
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # none stays a zombie
    file = os.open(path, os.O_RDWR | os.O_CREAT)
    os.ftruncate(file, 8 * (ALIVE + 1))
    seen = memoryview(mmap.mmap(file, 8 * (ALIVE + 1))).cast("d")
    place = 0
    while (now := time.monotonic()) < until and seen[ALIVE] < FORKS:
        seen[place] = now
        other = random.randrange(ALIVE)
        if now - seen[other] < LATE:
            if seen[ALIVE] > ALIVE // 2 and random.random() < 0.003:
                return  # its place is taken by another one soon
            time.sleep(0.002)
            continue
        seen[other] = now
        seen[ALIVE] += 1
        if not os.fork():
            os.setsid()
            place = other


if __name__ == "__main__":
    main(sys.argv[1], min(float(sys.argv[2]), time.monotonic() + 10.0))
