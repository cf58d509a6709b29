"""Why a connection does not come about, in one line: a short handshake of its own says what the engine does not.

It sends nothing but the handshake, and blocks: it is called in a thread.
"""

from __future__ import annotations

import socket
import ssl
import time
from typing import Final

from aiorts.errors import ConfigurationError
from aiorts_zenoh.security.folder import Folder, Identity

_WITHIN: Final = 3.0
_ALERT_WITHIN: Final = 0.5
"""Seconds that the other end has, after the handshake, to refuse what this one has shown."""
_SILENT: Final = 0.9
"""Seconds after which an end of aiorts closes a connection on which nothing is said: that is no refusal."""
_BUSY: Final = "is busy: it did not answer a handshake within {:g} s"
"""An end of aiorts, with certificates or without, answers or ends what it does not understand within a second."""
_ENDS: Final = "it ends the connection"
_THEIRS: Final = {
    7: "the certificate there is of another authority",
    9: "the certificate there is not yet valid, by the clock of this machine",
    10: "the certificate there has expired",
    18: "the certificate there is of another authority",
    19: "the certificate there is of another authority",
    20: "the certificate there is of another authority",
    21: "the certificate there is of another authority",
    62: "the certificate there is for other host names; issue it with --address",
    64: "the certificate there is for other addresses; issue it with --address",
}
"""By the number that OpenSSL gives to what is wrong with a certificate."""
_OURS: Final = {
    "UNKNOWN_CA": "is of another authority",
    "CERTIFICATE_EXPIRED": "has expired, or is not yet valid, by the clock there",
    "CERTIFICATE_REQUIRED": "is missing",
    "DECRYPT_ERROR": "is of another authority of the same name",
    "BAD_CERTIFICATE": "is damaged, or none for this use",
    "CERTIFICATE_UNKNOWN": "is not taken",
    "HANDSHAKE_FAILURE": "is missing, or not taken",
}
"""By the alert of the other end: what is wrong with the certificate of this one."""


def probe(host: str, port: int, identity: Identity | None, within: float = _WITHIN) -> str:
    """Why there is no connection with host:port; "" where nothing speaks against one.

    Args:
        identity: what this end shows; None: it speaks plain TCP.
    """
    try:
        with socket.create_connection((host, port), within) as connected:
            return _handshake(connected, host, identity, within)
    except TimeoutError:
        return "does not answer"
    except OSError as error:
        return f"is not reached: {error.strerror or error}"


def _handshake(connected: socket.socket, host: str, identity: Identity | None, within: float) -> str:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    if identity is None:
        context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    else:
        try:
            context.load_verify_locations(identity.authority)
            context.load_cert_chain(identity.certificate, identity.key)
        except OSError as error:  # of TLS as well: one is gone, or worth nothing
            return f"is not reached: the certificate of this end: {_own_fault(identity) or error.strerror}"
    began = time.monotonic()
    try:
        with context.wrap_socket(connected, server_hostname=host) as secured:
            secured.settimeout(_ALERT_WITHIN)
            said = _alert(secured)
            if said == _ENDS and time.monotonic() - began > _SILENT:
                said = ""  # it ends those that say nothing
    except ssl.SSLCertVerificationError as error:
        return _THEIRS.get(error.verify_code, f"the certificate there is not taken: {error.verify_message}")
    except ssl.SSLError as error:
        said = error.reason or "it ends the handshake"
    except TimeoutError:
        return _BUSY.format(within)
    except OSError:
        said = "no TLS"
    return _meaning(said, identity)


def _alert(secured: ssl.SSLSocket) -> str:
    """What the other end says against the certificate of this one; "" for nothing."""
    try:
        return "" if secured.recv(1) else _ENDS
    except TimeoutError:
        return ""
    except ssl.SSLError as error:
        return error.reason or _ENDS


def _meaning(said: str, identity: Identity | None) -> str:
    refused = next((text for word, text in _OURS.items() if said.endswith(word)), "")
    if identity is None:
        speaks = refused or not said
        return "speaks TLS, and takes those with certificates alone: give their folder (--certs)" if speaks else ""
    if refused:
        return f"refuses the certificate of {identity.name!r}, which {_own_fault(identity) or refused}"
    if said in ("no TLS", "WRONG_VERSION_NUMBER", "UNEXPECTED_EOF_WHILE_READING", "RECORD_LAYER_FAILURE"):
        return "does not speak TLS: it may be a kernel without certificates"
    return said and f"refuses the handshake: {said}"


def _own_fault(identity: Identity) -> str:
    """What this end can see itself of what is wrong with its certificate."""
    try:
        return Folder(identity.certificate.parent).facts(identity.name).fault(identity.name, "")
    except ConfigurationError as error:
        return str(error)
