"""Two hosts with a network between them.

The engine's own threads and descriptors live as long as the process: they are made before a test counts.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator

import pytest

from aiorts.testing import check_transport


@pytest.fixture(scope="session", autouse=True)
def _engine_is_there() -> None:
    pytest.importorskip("zenoh")
    from network.network_parts import loopback

    check_transport(loopback, only=["answers_questions"])


@pytest.fixture
def hosts() -> Iterator[tuple[list[str], list[str]]]:
    """What runs a command on each of two hosts with a network between them: 10.77.0.1 and 10.77.0.2."""
    if shutil.which("ip") is None or os.geteuid() != 0:
        pytest.skip("not run: network namespaces need `ip` and root")
    names = [f"aiorts-{os.getpid()}-{one}" for one in "ab"]
    wires = [f"ai{os.getpid() % 100_000}{one}" for one in "ab"]
    made: list[str] = []
    folders: list[str] = []
    try:
        for name in names:
            done = subprocess.run(["ip", "netns", "add", name], capture_output=True, text=True, check=False, timeout=10)
            if done.returncode:
                pytest.skip(f"not run: no network namespaces here: {done.stderr.strip()[:200]}")
            made.append(name)
        steps = [["link", "add", wires[0], "type", "veth", "peer", "name", wires[1]]]
        steps += [["link", "set", wire, "netns", name] for wire, name in zip(wires, names, strict=True)]
        for number, (wire, name) in enumerate(zip(wires, names, strict=True), 1):
            steps += [
                ["-n", name, "addr", "add", f"10.77.0.{number}/24", "dev", wire],
                ["-n", name, "link", "set", "lo", "up"],
                ["-n", name, "link", "set", wire, "up"],
            ]
        for step in steps:
            subprocess.run(["ip", *step], check=True, timeout=10)
        commands = []
        for name in names:
            folders.append(folder := tempfile.mkdtemp(prefix="ai"))  # short: a socket's path has 107 letters
            commands.append(["ip", "netns", "exec", name, "env", f"XDG_RUNTIME_DIR={folder}"])
        yield commands[0], commands[1]
    finally:
        for name in made:
            subprocess.run(["ip", "netns", "del", name], check=False, timeout=10)
        for folder in folders:
            shutil.rmtree(folder)
