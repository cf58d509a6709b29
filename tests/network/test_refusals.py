"""What is refused beyond the host, that it sees nothing, and that the end which is refused says why."""

from __future__ import annotations

import asyncio
import json
import logging
import shutil
import socket
import ssl
import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from aiorts import Kernel, exits
from aiorts.links import Links

pytest.importorskip("zenoh")
pytest.importorskip("cryptography")

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec, rsa
from cryptography.x509.oid import NameOID

from aiorts_zenoh import Network
from aiorts_zenoh.neighbours import Neighbours
from aiorts_zenoh.security.folder import Folder
from aiorts_zenoh.security.probe import probe
from network.certificate_parts import folder, issue_for, issue_later
from network.engine_parts import Heard, session, unchecked
from network.network_parts import free_port
from run_parts import here

NAMES = {"reader": "component", "writer": "component"}
SYSTEM = """
schema = 1
[components.dump]
type = "FlexiDump"
[contexts.main]
kind = "event"
members = ["dump"]
"""


def nothing_wrong(theirs: Folder, ours: Folder) -> None:
    pass


def another_authority(theirs: Folder, ours: Folder) -> None:
    shutil.rmtree(theirs.path)
    folder(theirs.path, **NAMES)


def expired(theirs: Folder, ours: Folder) -> None:
    issue_later(theirs, "writer", -2.0)


def not_yet_valid(theirs: Folder, ours: Folder) -> None:
    issue_later(theirs, "writer", 1.0)


def revoked(theirs: Folder, ours: Folder) -> None:
    ours.revoke("writer")


def of_another_name(theirs: Folder, ours: Folder) -> None:
    for ending in ("pem", "key"):
        (theirs.path / f"reader.{ending}").replace(theirs.path / f"writer.{ending}")


def not_of_its_key(theirs: Folder, ours: Folder) -> None:
    (theirs.path / "reader.key").replace(theirs.path / "writer.key")


def readable(theirs: Folder, ours: Folder) -> None:
    (theirs.path / "writer.key").chmod(0o644)


def short_rsa(theirs: Folder, ours: Folder) -> None:
    issue_for(theirs, "writer", rsa.generate_private_key(65_537, 1_024))


def short_curve(theirs: Folder, ours: Folder) -> None:
    issue_for(theirs, "writer", ec.generate_private_key(ec.SECP224R1()))


def short_authority(theirs: Folder, ours: Folder) -> None:
    """The authority signs itself anew with a short key."""
    key = rsa.generate_private_key(65_537, 1_024)
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "weak")])
    now = datetime.now(UTC)
    builder = x509.CertificateBuilder().subject_name(name).issuer_name(name).public_key(key.public_key())
    builder = builder.serial_number(1).not_valid_before(now).not_valid_after(now + timedelta(days=1))
    own = builder.sign(key, hashes.SHA256())
    (theirs.path / "ca.pem").write_bytes(own.public_bytes(serialization.Encoding.PEM))
    form = serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    (theirs.path / "ca.key").write_bytes(key.private_bytes(*form))
    issue_for(theirs, "writer", ec.generate_private_key(ec.SECP256R1()))


def without_a_role(theirs: Folder, ours: Folder) -> None:
    index = json.loads(ours.index.read_bytes())
    del index["roles"]["writer"]
    ours.index.write_text(json.dumps(index))


Cause = Callable[[Folder, Folder], None]


def pair(path: Path, cause: Cause) -> tuple[Folder, Folder]:
    """Certificates of two machines; something is wrong with those of the second."""
    ours = folder(path / "ours", **NAMES)
    shutil.copytree(ours.path, path / "theirs")
    theirs = Folder(path / "theirs")
    cause(theirs, ours)
    return ours, theirs


# -- at its own start --------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.fault("E18")
@pytest.mark.parametrize(
    ("cause", "said"),
    [
        (expired, "writer.pem: has expired on "),
        (not_yet_valid, "writer.pem: is not valid before "),
        (of_another_name, "writer.pem: is for 'reader', not for 'writer'"),
        (not_of_its_key, "writer.pem: does not go with its key"),
        (readable, "writer.key: has mode 0644, so others can read the key; chmod 600 "),
        (short_rsa, "writer.pem: has a key that is too short: RSA with 1024 bits, of at least 2048"),
        (short_curve, "writer.pem: has a key that is too short: an elliptic curve with 224 bits, of at least 256"),
        (short_authority, "writer.pem: has a key that is too short: of the authority, RSA with 1024 bits"),
        (lambda theirs, ours: theirs.revoke("writer"), "'writer' was revoked"),
        (lambda theirs, ours: shutil.copy(theirs.path / "reader.pem", theirs.path / "ca.pem"), "was not issued by"),
        (lambda theirs, ours: (theirs.path / "writer.pem").unlink(), "'writer' has no certificate"),
        (lambda theirs, ours: (theirs.path / "writer.pem").write_text("x"), "the certificate is none in PEM"),
        (lambda theirs, ours: (theirs.path / "index.json").write_text("{"), "is no index of certificates"),
    ],
)
def test_a_kernel_whose_certificate_is_not_to_be_used_is_not_started(tmp_path: Path, cause: Any, said: str) -> None:
    _, theirs = pair(tmp_path, cause)
    with socket.create_server(("127.0.0.1", 0)) as listening:
        (tmp_path / "system.toml").write_text(SYSTEM)
        network = ["--certs", theirs.path, "--connect", f"127.0.0.1:{listening.getsockname()[1]}"]
        done = here("run", tmp_path / "system.toml", "--name", "writer", *network)
        assert (done.returncode, said in done.stderr) == (exits.REFUSED, True), done.stderr
        assert "PRIVATE" not in done.stderr
        listening.settimeout(0.1)
        with pytest.raises(TimeoutError):
            listening.accept()


# -- at the other end --------------------------------------------------------------------------------------------------


async def reader_at(address: str, certificates: Path) -> Kernel:
    services = {"zenoh": {"listen": address, "host": "far", "certificates": certificates}}
    kernel = await Kernel("reader", services=services).open()
    await kernel.service(Network).opened()
    return kernel


@pytest.mark.slow
@pytest.mark.fault("E18")
@pytest.mark.parametrize(
    "cause", [nothing_wrong, another_authority, expired, not_yet_valid, revoked, without_a_role, short_rsa, short_curve]
)
def test_who_is_refused_sees_nothing_whatever_its_own_end_checks(tmp_path: Path, cause: Cause) -> None:
    ours, theirs = pair(tmp_path, cause)

    async def main() -> tuple[Counter[str], int, str]:
        address = f"127.0.0.1:{free_port()}"
        kernel = await reader_at(address, ours.path)
        try:

            def thief() -> tuple[Counter[str], int, str]:
                with session(theirs, "writer", guarded=False, connect=address) as opened:
                    heard = Heard(opened)
                    seen = opened.liveliness().declare_subscriber("aiorts/1/default/live/*/*/**", history=True)
                    heard.wait(1, within=2.0)
                    heard.counts["token"] += sum(1 for _ in iter(seen.try_recv, None))
                why = probe("127.0.0.1", int(address.rpartition(":")[2]), unchecked(theirs, "writer"))
                return heard.counts, heard.bytes, why

            return await asyncio.to_thread(thief)
        finally:
            await kernel.aclose()

    counts, size, why = asyncio.run(main())
    if cause is nothing_wrong:
        assert counts["token"] > 0, "this test would see it"
        assert why == ""
        return
    assert (+counts, size) == (Counter(), 0)
    said = {another_authority: "of another authority", expired: "has expired", not_yet_valid: "is not valid before"}
    said |= dict.fromkeys((short_rsa, short_curve), "has a key that is too short")
    assert said.get(cause, "") in why


@pytest.mark.slow(kept_by="test_the_probe_says_what_does_not_answer_and_what_is_busy")
@pytest.mark.fault("E18")
@pytest.mark.parametrize(
    ("cause", "at", "said"),
    [
        (another_authority, "127.0.0.1", "the certificate there is of another authority"),
        (revoked, "127.0.0.1", "'reader' says that the name 'writer' was revoked: it takes nothing from this kernel"),
        (nothing_wrong, "127.0.0.2", "the certificate there is for other addresses; issue it with --address"),
    ],
)
def test_the_kernel_that_is_refused_says_why(
    tmp_path: Path, cause: Cause, at: str, said: str, caplog: pytest.LogCaptureFixture
) -> None:
    ours, theirs = pair(tmp_path, cause)
    refused_by(at, ours.path, {"certificates": theirs.path}, said, caplog)
    if cause is revoked:
        assert "tls/127.0.0.1 is refused: 'writer' was revoked" in caplog.text


@pytest.mark.slow(kept_by="test_the_probe_says_what_does_not_answer_and_what_is_busy")
@pytest.mark.fault("E18")
def test_a_name_without_a_role_is_refused_and_that_is_said(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    ours, theirs = pair(tmp_path, without_a_role)
    refused_by("127.0.0.1", ours.path, {"certificates": theirs.path}, "is refused: 'writer' has no role here", caplog)


@pytest.mark.fault("E18")
@pytest.mark.parametrize("gone", ["writer.pem", "writer.key", "ca.pem"])
def test_a_file_of_its_own_that_has_gone_is_named(tmp_path: Path, gone: str) -> None:
    ours = folder(tmp_path, **NAMES)
    own = unchecked(ours, "writer")
    (tmp_path / gone).unlink()
    with socket.create_server(("127.0.0.1", 0)) as listening:
        why = probe("127.0.0.1", listening.getsockname()[1], own)
    assert why == f"is not reached: the certificate of this end: {tmp_path / gone}: there is none"


@pytest.mark.slow
@pytest.mark.fault("E17")
def test_a_kernel_in_plain_tcp_is_refused_and_says_why(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    ours = folder(tmp_path, **NAMES)
    said = "speaks TLS, and takes those with certificates alone: give their folder (--certs)"
    refused_by("127.0.0.1", ours.path, {"insecure": True}, said, caplog)


def refused_by(at: str, ours: Path, security: dict[str, Any], said: str, caplog: pytest.LogCaptureFixture) -> None:
    """A kernel connects to another one, is refused, and says why."""

    async def main() -> None:
        address = f"{at}:{free_port()}"
        reader = await reader_at(address, ours)
        near = {"zenoh": {"connect": address, "host": "near", **security}}
        try:
            async with Kernel("writer", services=near) as writer:
                async with asyncio.timeout(15.0):
                    while said not in caplog.text:
                        await asyncio.sleep(0.05)
                assert (reader.service(Links).peers, writer.service(Links).peers) == ((), ())
        finally:
            await reader.aclose()

    with caplog.at_level(logging.WARNING):
        asyncio.run(main())


@pytest.mark.slow
@pytest.mark.fault("E17")
def test_plain_bytes_and_a_handshake_without_a_certificate_get_nothing_of_ours(tmp_path: Path) -> None:
    ours = folder(tmp_path, **NAMES)

    def plain(address: tuple[str, int]) -> bytes:
        with socket.create_connection(address, 5.0) as connected:
            connected.sendall(b"\x20\x00" + bytes(32))
            return received(connected)

    def unnamed(address: tuple[str, int]) -> bytes:
        context = ssl.create_default_context(cafile=str(tmp_path / "ca.pem"))
        with (
            socket.create_connection(address, 5.0) as connected,
            context.wrap_socket(connected, server_hostname="localhost") as secured,
            pytest.raises(ssl.SSLError, match="certificate required"),
        ):
            return received(secured)
        return b""

    async def main() -> None:
        port = free_port()
        kernel = await reader_at(f"127.0.0.1:{port}", ours.path)
        try:
            for _ in range(20):
                got = await asyncio.to_thread(plain, ("127.0.0.1", port))
                assert got[:1] in (b"", b"\x15"), "an alert of TLS at the most"
                assert len(got) <= 7
                assert await asyncio.to_thread(unnamed, ("127.0.0.1", port)) == b""
        finally:
            await kernel.aclose()

    asyncio.run(main())


def received(connected: socket.socket) -> bytes:
    got, until = b"", time.monotonic() + 5.0
    while time.monotonic() < until:
        try:
            data = connected.recv(4096)
        except ConnectionError:
            return got
        if not data:
            return got
        got += data
    return got


@pytest.mark.slow(kept_by="first")
def test_the_probe_says_what_does_not_answer_and_what_is_busy(tmp_path: Path) -> None:
    own = unchecked(folder(tmp_path, **NAMES), "writer")
    assert probe("127.0.0.1", free_port(), own) == "is not reached: Connection refused"
    for shown in (own, None):
        with socket.create_server(("127.0.0.1", 0)) as silent:
            said = probe("127.0.0.1", silent.getsockname()[1], shown, within=0.2)
            assert said == "is busy: it did not answer a handshake within 0.2 s"


@pytest.mark.parametrize("answer", [b"", b"220 mail\r\n", b"HTTP/1.1 400 Bad Request\r\n\r\n"])
def test_the_probe_says_what_is_no_tls(tmp_path: Path, answer: bytes) -> None:
    """A port of plain TCP: what is there ends the connection, or answers in words of its own."""
    own = unchecked(folder(tmp_path, **NAMES), "writer")
    with socket.create_server(("127.0.0.1", 0)) as plain:

        def serve() -> None:
            connected, _ = plain.accept()
            with connected:
                connected.recv(4096)
                connected.sendall(answer)

        serving = threading.Thread(target=serve)
        serving.start()
        said = probe("127.0.0.1", plain.getsockname()[1], own)
        serving.join(10.0)
    assert said == "does not speak TLS: it may be a kernel without certificates"


@pytest.mark.slow(kept_by="test_the_probe_says_what_does_not_answer_and_what_is_busy")
@pytest.mark.fault("E12")
def test_a_port_that_is_busy_with_bad_handshakes_is_called_busy_and_then_answers(tmp_path: Path) -> None:
    made, port, ended = folder(tmp_path, **NAMES), free_port(), threading.Event()
    own = unchecked(made, "writer")

    def flood() -> None:
        """Four times as many as the engine takes in a second."""
        while not ended.wait(0.02):
            with suppress(OSError), socket.create_connection(("127.0.0.1", port), 1.0) as one:
                one.sendall(b"\x20\x00" + bytes(32))

    with session(made, "reader", guarded=True, listen=f"127.0.0.1:{port}"):
        assert probe("127.0.0.1", port, own) == ""
        flooding = threading.Thread(target=flood)
        flooding.start()
        try:
            said = [probe("127.0.0.1", port, own, within=1.0)]
            while not said[-1] and len(said) < 3:  # what the engine is behind with takes it twice as long to be rid of
                said.append(probe("127.0.0.1", port, own, within=1.0))
        finally:
            ended.set()
            flooding.join(10.0)
        assert said[-1] == "is busy: it did not answer a handshake within 1 s", said
        assert not any("TLS" in one for one in said)
        until = time.monotonic() + 60.0
        while probe("127.0.0.1", port, own):
            assert time.monotonic() < until


@pytest.mark.slow(kept_by="test_the_probe_says_what_is_no_tls")
def test_a_kernel_in_plain_tcp_is_said_to_speak_no_tls(tmp_path: Path) -> None:
    own = unchecked(folder(tmp_path, **NAMES), "writer")

    async def main() -> str:
        port = free_port()
        services = {"zenoh": {"listen": f"127.0.0.1:{port}", "host": "far", "insecure": True}}
        async with Kernel("reader", services=services) as kernel:
            await kernel.service(Network).opened()
            return await asyncio.to_thread(probe, "127.0.0.1", port, own)

    assert asyncio.run(main()) == "does not speak TLS: it may be a kernel without certificates"


def test_names_in_tokens_are_not_kept_where_nobody_looks_for_them() -> None:
    neighbours = Neighbours([], None, lambda text: None)
    for number in range(10):
        neighbours._token(f"aiorts/1/default/live/far/k{number}/1-{number:016x}-{1:016x}", True)
    assert not neighbours._shown
