"""The `aiorts` command, built on the public face alone, like any user of it."""

from __future__ import annotations

import os
import sys

__all__ = ("main",)


def main() -> int:
    """Run the command line of this process; returns the exit status."""
    _fill_gaps()
    try:
        from aiorts.cli.app import run_command

        return run_command(sys.argv[1:])
    except KeyboardInterrupt:
        return 130


def _fill_gaps() -> None:
    """Open nothing at all in the place of a missing standard stream, or the first file we open takes its number."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # the lowest free number, which is this one
