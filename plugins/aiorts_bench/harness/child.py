"""Runs fresh interpreters as workloads: always ended in time, with the compiled modules of daily use."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter_ns
from typing import Final

PARENT: Final = Path(__file__).resolve().parents[3]
"""The folder on the child's path from which it imports this aiorts."""
# Bytecode is kept: else each start would compile all modules. The other variables print, or wait for a terminal.
_DROPPED: Final = ("PYTHONDONTWRITEBYTECODE", "PYTHONPROFILEIMPORTTIME", "PYTHONINSPECT", "PYTHONSTARTUP")


def run(words: Sequence[str], *, timeout: float, cwd: str | Path | None = None) -> str:
    """Run `python WORDS` and return its standard output.

    Raises:
        OSError: the process failed or took longer than `timeout` seconds; it has ended in any case.
    """
    try:
        done = subprocess.run(  # noqa: S603 - our own interpreter, fixed words, no shell
            [sys.executable, *words],
            capture_output=True,
            text=True,
            timeout=timeout,
            check=False,
            stdin=subprocess.DEVNULL,
            cwd=cwd,
            env=environment(),
        )
    except subprocess.TimeoutExpired:
        raise OSError(f"python {' '.join(words)[:60]}: still ran after {timeout} s and was ended") from None
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["no reason given"])[-1]
        raise OSError(f"python {' '.join(words)[:60]}: status {done.returncode}: {last}")
    return done.stdout


def timed(words: Sequence[str], *, timeout: float = 30.0, cwd: str | Path | None = None) -> tuple[int, str]:
    """Nanoseconds from the start of `python WORDS` to its end, and what it printed. Raises as `run`."""
    began = perf_counter_ns()
    output = run(words, timeout=timeout, cwd=cwd)
    return perf_counter_ns() - began, output


def environment() -> dict[str, str]:
    """The user's environment without the variables of `_DROPPED`, and with this aiorts first on the path."""
    kept = {name: value for name, value in os.environ.items() if name not in _DROPPED}
    paths = [str(PARENT), *filter(None, [kept.get("PYTHONPATH")])]
    return {**kept, "PYTHONPATH": os.pathsep.join(paths)}
