"""Hosts on one machine: network namespaces, the first of them with a cable to each of the others. Linux, as root."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager


def ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, timeout=10)


@contextmanager
def namespaces(hosts: Mapping[str, str]) -> Iterator[dict[str, list[str]]]:
    """Make hosts of these names and addresses; gives for each of them what goes before a command that runs there."""
    names = {host: f"lrf-{os.getpid()}-{host}" for host in hosts}
    hub, *others = hosts
    with ExitStack() as stack:
        for name in names.values():
            ip("netns", "add", name)
            stack.callback(ip, "netns", "del", name)
            ip("-n", name, "link", "set", "lo", "up")
        for other in others:
            near, far = f"to-{other}", f"to-{hub}"
            ip("-n", names[hub], "link", "add", near, "type", "veth", "peer", far, "netns", names[other])
            for host, cable, peer in ((hub, near, other), (other, far, hub)):
                ip("-n", names[host], "addr", "add", hosts[host], "peer", hosts[peer], "dev", cable)
                ip("-n", names[host], "link", "set", cable, "up")
        yield {host: ["ip", "netns", "exec", name] for host, name in names.items()}
