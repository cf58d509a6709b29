"""Hosts with a network between them, each a namespace of this machine."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import pytest


@contextmanager
def two_hosts(number: int = 0) -> Iterator[tuple[list[str], list[str]]]:
    """What runs a command on each of two hosts: 10.77.0.1 and 10.77.0.2, on a network that no other number has."""
    if shutil.which("ip") is None or os.geteuid() != 0:
        pytest.skip("not run: network namespaces need `ip` and root")
    names = [f"aiorts-{os.getpid()}-{number}{one}" for one in "ab"]
    wires = [f"ai{os.getpid() % 100_000}{one}{number}" for one in "ab"]
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
        for last, (wire, name) in enumerate(zip(wires, names, strict=True), 1):
            steps += [
                ["-n", name, "addr", "add", f"10.77.0.{last}/24", "dev", wire],
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


def wire_of(host: Sequence[str]) -> Callable[[str], float]:
    """What takes the network device of a host up or down, and says when it began: links may see it before this ends."""
    name = host[3]
    listed = subprocess.run(["ip", "-n", name, "-o", "link"], capture_output=True, text=True, check=True, timeout=10)
    (device,) = [line.split()[1].partition("@")[0] for line in listed.stdout.splitlines() if "@" in line]

    def set_to(state: str) -> float:
        begins = time.monotonic()
        subprocess.run(["ip", "-n", name, "link", "set", device, state], check=True, timeout=10)
        return begins

    return set_to


_NETWORK = 0x4000_0000
"""What `setns` calls the namespace of a network."""


@contextmanager
def own_network(rules: str = "") -> Iterator[None]:
    """What is started within has a network of its own, with a loopback alone, and this firewall (of `nft`)."""
    missing = [one for one in ("ip", "nft") if shutil.which(one) is None]
    if missing or os.geteuid() != 0:
        pytest.skip(f"not run: a firewall needs root, and {' and '.join(missing) or 'its programs'}")
    name = f"aiorts-{os.getpid()}-own"
    done = subprocess.run(["ip", "netns", "add", name], capture_output=True, text=True, check=False, timeout=10)
    if done.returncode:
        pytest.skip(f"not run: no network namespaces here: {done.stderr.strip()[:200]}")
    libc = ctypes.CDLL(None, use_errno=True)
    with open("/proc/thread-self/ns/net") as before, open(f"/run/netns/{name}") as own:
        try:
            _check(libc.setns(own.fileno(), _NETWORK))
            subprocess.run(["ip", "link", "set", "lo", "up"], check=True, timeout=10)
            subprocess.run(["nft", "-f", "-"], input=rules, text=True, check=True, timeout=10)
            yield
        finally:
            _check(libc.setns(before.fileno(), _NETWORK))
            subprocess.run(["ip", "netns", "del", name], check=False, timeout=10)


def _check(result: int) -> None:
    if result:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
