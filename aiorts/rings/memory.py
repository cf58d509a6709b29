"""The memory of a ring: made and sealed by the sender, checked and mapped by the receiver.

A memfd, and neither names in /dev/shm nor a library of shared memory: nothing is left of it when both processes are
killed. Measured in a trial with 1 MiB: 0.56x of Zenoh's shared memory, whose binding copies twice and keeps what it has
mapped locked (zenoh #2787); iceoryx2 was no faster (672 us against 592), has no descriptor that a loop can wait on, and
left 29 names and 1.1 GB behind after one kill.
"""

from __future__ import annotations

import mmap
import os
import stat
from typing import Final

AVAILABLE: Final = hasattr(os, "memfd_create")
"""Whether this system has such memory."""
_FUTURE_WRITE: Final = 0x0010
"""F_SEAL_FUTURE_WRITE, which `fcntl` does not name: from now on no process can map it to write, or punch holes."""
LARGEST: Final = 64 << 20
"""The most bytes of one ring: ten pictures of 1080p. They are committed while the connection is there; a
ring that was replaced is given back when nothing looks into it."""


def _seals() -> int:
    import fcntl  # late: not every system has it

    return fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW | fcntl.F_SEAL_SEAL | _FUTURE_WRITE


class Making:
    """Memory that is being made, in steps: committing 64 MiB at once holds the loop for tens of milliseconds."""

    _STEP: Final = 4 << 20

    def __init__(self, size: int) -> None:
        self.size = size
        self._done = 0
        self.descriptor = os.memfd_create("aiorts-ring", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)

    def step(self) -> mmap.mmap | None:
        """Commit some more memory; returns the memory to write to, once all is committed and sealed.

        Raises:
            OSError: the system has no room for the memory, or does not know these seals.
        """
        import fcntl

        if self._done < self.size:
            length = min(self._STEP, self.size - self._done)
            # Not ftruncate: without room it is an error here, and would be a SIGBUS in the code that touches it later.
            os.posix_fallocate(self.descriptor, self._done, length)
            self._done += length
            return None
        memory = mmap.mmap(self.descriptor, self.size, mmap.MAP_SHARED, mmap.PROT_READ | mmap.PROT_WRITE)
        fcntl.fcntl(self.descriptor, fcntl.F_ADD_SEALS, _seals())
        return memory

    def close(self) -> None:
        """Close the descriptor; what is mapped stays. Idempotent."""
        if self.descriptor >= 0:
            os.close(self.descriptor)
            self.descriptor = -1


def fault_of(descriptor: int) -> str:
    """Why memory that another process has sent must not be mapped; "" if it may."""
    import fcntl

    try:
        found = os.fstat(descriptor)
        seals = fcntl.fcntl(descriptor, fcntl.F_GET_SEALS)
    except OSError as error:
        return f"no memory that can be sealed ({error.strerror})"
    missing = _seals() & ~seals
    if missing:
        return f"memory without the seals {missing:#x}"
    if not stat.S_ISREG(found.st_mode) or not 0 < found.st_size <= LARGEST:
        return f"memory of {found.st_size} bytes"
    if found.st_blocks * 512 < found.st_size:
        return "memory that is not committed"  # a hole is filled when it is read, or is a SIGBUS
    return ""


def mapped(descriptor: int) -> mmap.mmap:
    """The memory of a descriptor, mapped for reading.

    Raises:
        OSError: this process may not have so much memory.
    """
    return mmap.mmap(descriptor, os.fstat(descriptor).st_size, mmap.MAP_SHARED, mmap.PROT_READ)
