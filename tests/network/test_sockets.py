"""Nothing listens unless it is asked for, and who is of another user gets nothing at a port of the loopback."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

pytest.importorskip("zenoh")
pytest.importorskip("cryptography")

from network.certificate_parts import folder

pytestmark = pytest.mark.slow(kept_by="network/test_network.py::test_switched_on_alone_it_listens_nowhere")

PYTHON = Path("/usr/bin/python3")
"""One that other users can run, too."""
NOBODY = 65_534
SYSTEM = """
schema = 1
[components.dump]
type = "FlexiDump"
params = { inputs = "TimedLong" }
[contexts.main]
kind = "event"
members = ["dump"]
"""
STRANGER = r"""
import os, socket, ssl, sys
os.setgroups([])
os.setgid(int(sys.argv[3]))
os.setuid(int(sys.argv[3]))
port, key = int(sys.argv[1]), sys.argv[2]
def received(sock):
    got = b""
    sock.settimeout(2.0)
    try:
        while data := sock.recv(4096):
            got += data
    except OSError:
        pass
    return got
with socket.create_connection(("127.0.0.1", port), 5.0) as plain:
    plain.sendall(bytes.fromhex("2000") + bytes(32))
    print("plain", received(plain).hex())
context = ssl.create_default_context()
context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
with socket.create_connection(("127.0.0.1", port), 5.0) as raw, context.wrap_socket(raw) as secured:
    print("tls", received(secured).hex())
try:
    open(key).read()
    print("key read")
except PermissionError:
    print("key denied")
"""


@contextmanager
def running(host: list[str], tmp_path: Path, *options: str) -> Iterator[None]:
    """A run on this host that has opened its network."""
    (tmp_path / "system.toml").write_text(SYSTEM)
    log = tmp_path / "log.txt"
    run = [*host, sys.executable, "-m", "aiorts", "run", str(tmp_path / "system.toml"), "--name", "robot", *options]
    with log.open("w") as output:
        process = subprocess.Popen(run, stdout=output, stderr=output)
    try:
        until = time.monotonic() + 20.0
        look = [*host, sys.executable, "-m", "aiorts", "ls"]
        while "robot/" not in subprocess.run(look, capture_output=True, text=True, timeout=20.0, check=False).stdout:
            assert time.monotonic() < until, log.read_text()
            assert process.poll() is None, log.read_text()
        time.sleep(1.0)  # it may open something later
        yield
        assert process.poll() is None, log.read_text()
    finally:
        process.terminate()
        process.wait(20.0)


def listening(host: list[str]) -> list[str]:
    """Sockets of the network of this host at which something listens, or that take datagrams from anywhere."""
    found = []
    for table, state in (("tcp", "0A"), ("tcp6", "0A"), ("udp", "07"), ("udp6", "07")):
        text = subprocess.run(
            [*host, "cat", f"/proc/net/{table}"], capture_output=True, text=True, timeout=10.0, check=True
        )
        rows = [line.split() for line in text.stdout.splitlines()[1:]]
        found += [f"{table} {row[1]}" for row in rows if row[3] == state]
    return found


@pytest.mark.parametrize("options", [("--host", "one"), ("--host", "one", "--connect", "10.77.0.2:7447")])
def test_without_listen_there_is_no_listener(
    hosts: tuple[list[str], list[str]], tmp_path: Path, options: tuple[str, ...]
) -> None:
    folder(tmp_path / "certs", robot="component")
    with running(hosts[0], tmp_path, *options, "--certs", str(tmp_path / "certs")):
        assert listening(hosts[0]) == []


def test_another_user_gets_nothing_at_the_port(hosts: tuple[list[str], list[str]], tmp_path: Path) -> None:
    if not PYTHON.exists():
        pytest.skip("not run: there is no Python that another user can run")
    folder(tmp_path / "certs", robot="component")
    network = ("--host", "one", "--listen", "127.0.0.1:7447", "--certs", str(tmp_path / "certs"))
    with running(hosts[0], tmp_path, *network):
        assert listening(hosts[0]) == ["tcp 0100007F:1D17"]
        command = [*hosts[0], str(PYTHON), "-c", STRANGER, "7447", str(tmp_path / "certs" / "robot.key"), str(NOBODY)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=30.0, check=False)
    said = dict(line.partition(" ")[::2] for line in done.stdout.splitlines())
    assert said.keys() == {"plain", "tls", "key"}, done.stderr
    assert said["plain"][:2] in ("", "15"), "an alert of TLS at the most"
    assert len(said["plain"]) <= 14
    assert (said["tls"], said["key"]) == ("", "denied")
