"""The memory of a ring is committed and sealed, and nothing else is mapped."""

from __future__ import annotations

import fcntl
import mmap
import os
import tempfile

import pytest

from aiorts.rings.memory import AVAILABLE, LARGEST, Making, fault_of, mapped
from aiorts.types.arrays import sealed_view

pytestmark = pytest.mark.skipif(not AVAILABLE, reason="this system has no such memory")
SIZE = 1 << 20
SHRINK, GROW, SEAL, FUTURE_WRITE = fcntl.F_SEAL_SHRINK, fcntl.F_SEAL_GROW, fcntl.F_SEAL_SEAL, 0x10


def test_who_receives_it_reads_what_is_written_and_can_change_nothing() -> None:
    making = Making(SIZE)
    while (memory := making.step()) is None:
        pass
    try:
        assert fault_of(making.descriptor) == ""
        theirs = mapped(making.descriptor)
        memory[:5] = b"hello"
        assert (theirs[:5], len(theirs)) == (b"hello", SIZE)
        with pytest.raises(TypeError):
            theirs[0] = 1
        for change in (
            lambda: mmap.mmap(making.descriptor, SIZE, mmap.MAP_SHARED, mmap.PROT_READ | mmap.PROT_WRITE),
            lambda: os.ftruncate(making.descriptor, 0),
            lambda: os.ftruncate(making.descriptor, 2 * SIZE),
            lambda: os.pwrite(making.descriptor, b"x", 0),
            lambda: fcntl.fcntl(making.descriptor, fcntl.F_ADD_SEALS, fcntl.F_SEAL_WRITE),
        ):
            with pytest.raises(PermissionError):
                change()
        theirs.close()
    finally:
        making.close()
        memory.close()


@pytest.mark.parametrize("missing", [SHRINK, GROW, SEAL, FUTURE_WRITE, SHRINK | GROW | SEAL | FUTURE_WRITE])
def test_memory_without_one_of_the_seals_is_refused(missing: int) -> None:
    descriptor = os.memfd_create("test", os.MFD_ALLOW_SEALING)
    try:
        os.posix_fallocate(descriptor, 0, SIZE)
        fcntl.fcntl(descriptor, fcntl.F_ADD_SEALS, (SHRINK | GROW | SEAL | FUTURE_WRITE) & ~missing)
        assert fault_of(descriptor) == f"memory without the seals {missing:#x}"
    finally:
        os.close(descriptor)


@pytest.mark.parametrize(
    ("size", "commit", "said"),
    [(SIZE, False, "not committed"), (0, False, "memory of 0 bytes"), (LARGEST + 4096, True, "memory of 67112960")],
)
def test_memory_of_a_wrong_size_or_with_holes_is_refused(size: int, commit: bool, said: str) -> None:
    descriptor = os.memfd_create("test", os.MFD_ALLOW_SEALING)
    try:
        if commit:
            os.posix_fallocate(descriptor, 0, size)
        else:
            os.ftruncate(descriptor, size)
        fcntl.fcntl(descriptor, fcntl.F_ADD_SEALS, SHRINK | GROW | SEAL | FUTURE_WRITE)
        assert said in fault_of(descriptor)
    finally:
        os.close(descriptor)


def test_records_lie_in_no_memory_that_this_process_can_write_to() -> None:
    with pytest.raises(ValueError, match="can only be read"):
        sealed_view(memoryview(bytearray(64)))


def test_what_is_no_memory_is_refused() -> None:
    reading, writing = os.pipe()
    with tempfile.TemporaryFile() as file:
        file.write(bytes(SIZE))
        file.flush()
        for descriptor in (reading, file.fileno()):
            assert "no memory that can be sealed" in fault_of(descriptor) or "without the seals" in fault_of(descriptor)
    os.close(reading)
    os.close(writing)
