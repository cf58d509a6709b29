"""Each test of control has a folder of its own for sockets."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable

import pytest

import aiorts.observe.profiling  # noqa: F401 - late in two threads at once, pytest's rewriting may fail (CPython 3.11)
from control_parts import WAIT
from runtime_parts import runtime as runtime


@pytest.fixture
def completed() -> Callable[..., set[str]]:
    """A function that returns what bash completes behind `aiorts WORDS`, in a process of its own; the last word is the
    one that is completed."""

    def complete(*words: str) -> set[str]:
        line = {"COMP_WORDS": " ".join(("aiorts", *words)), "COMP_CWORD": str(len(words))}
        done = subprocess.run(
            [sys.executable, "-m", "aiorts"],
            env={**os.environ, "_AIORTS_COMPLETE": "bash_complete", **line},
            capture_output=True,
            text=True,
            timeout=WAIT,
        )
        return {one.partition(",")[2] for one in done.stdout.splitlines()}

    return complete
