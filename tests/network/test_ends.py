"""A process with certificates ends within 5 s, whatever its connection is like."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("zenoh")
pytest.importorskip("cryptography")

from network.certificate_parts import folder
from network.network_parts import free_port

ENDS = 5.0
TIMES = 67 if os.environ.get("AIORTS_CAMPAIGN") else 2
"""Of each case."""
CONNECTS = """
import asyncio, sys
from aiorts import Kernel
from aiorts_zenoh import Network

async def main(end, address, certificates, how):
    services = {"zenoh": {end: address, "host": end, "certificates": certificates}}
    async with Kernel("reader" if end == "listen" else "writer", services=services) as kernel:
        if end == "listen":
            await kernel.service(Network).opened()
        print("runs", flush=True)
        if how == "exit":
            await asyncio.sleep(0.5)
            sys.exit(7)
        await asyncio.sleep(60.0)

asyncio.run(main(*sys.argv[1:]))
"""


def start(end: str, address: str, certificates: Path, how: str = "wait") -> subprocess.Popen[str]:
    command = [sys.executable, "-c", CONNECTS, end, address, str(certificates), how]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "runs\n"
    return process


@pytest.mark.fault("E25")
@pytest.mark.fault("G11")
@pytest.mark.parametrize("case", ["linked", "refused", "nobody there"])
def test_the_interpreter_ends_whatever_its_connection_is_like(tmp_path: Path, case: str) -> None:
    folder(tmp_path / "ours", reader="component", writer="component")
    folder(tmp_path / "theirs", reader="component", writer="component")
    address = f"127.0.0.1:{free_port()}"
    listening = None if case == "nobody there" else start("listen", address, tmp_path / "ours")
    try:
        for number in range(TIMES):
            how = ("exit", "signal")[number % 2]
            process = start("connect", address, tmp_path / ("theirs" if case == "refused" else "ours"), how)
            began = time.monotonic()
            if how == "signal":
                time.sleep(0.5)
                process.send_signal(signal.SIGINT)
            try:
                _, said = process.communicate(timeout=20.0)
            finally:
                process.kill()
            assert time.monotonic() - began < ENDS + 0.5
            assert "Fatal Python error" not in said
            assert process.returncode == (7 if how == "exit" else -signal.SIGINT), said[-2000:]
    finally:
        if listening is not None:
            listening.kill()
            listening.communicate(timeout=20.0)
