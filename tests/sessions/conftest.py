"""Each test of sessions has a folder of its own for sockets."""

from __future__ import annotations

import aiorts.observe.profiling  # noqa: F401 - late in two threads at once, pytest's rewriting may fail (CPython 3.11)
from runtime_parts import runtime as runtime
