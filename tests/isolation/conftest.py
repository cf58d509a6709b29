"""Kernels of a test meet no others: each test has a run-time folder of its own."""

from __future__ import annotations

from runtime_parts import runtime as runtime
