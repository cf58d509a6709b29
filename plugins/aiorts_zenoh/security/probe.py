"""The reason why a connection does not come about, in one line, found by a short handshake: the engine gives none.

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
"""Seconds after which an end of aiorts closes a silent connection: that is no refusal."""
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
"""The faults of the other end's certificate, by OpenSSL's number of the fault."""
_OURS: Final = {
    "UNKNOWN_CA": "is of another authority",
    "CERTIFICATE_EXPIRED": "has expired, or is not yet valid, by the clock there",
    "CERTIFICATE_REQUIRED": "is missing",
    "DECRYPT_ERROR": "is of another authority of the same name",
    "BAD_CERTIFICATE": "is damaged, or none for this use",
    "CERTIFICATE_UNKNOWN": "is not taken",
    "HANDSHAKE_FAILURE": "is missing, or not taken",
}
"""The faults of this end's certificate, by the alert of the other end."""


def probe(host: str, port: int, identity: Identity | None, within: float = _WITHIN) -> str:
    """The reason why there is no connection with host:port; "" where none is found.

    Args:
        identity: the certificate of this end; None: it speaks plain TCP.
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
        except OSError as error:  # an SSLError as well: a file is gone, or worth nothing
            return f"is not reached: the certificate of this end: {_own_fault(identity) or error.strerror}"
    began = time.monotonic()
    try:
        with context.wrap_socket(connected, server_hostname=host) as secured:
            secured.settimeout(_ALERT_WITHIN)
            said = _alert(secured)
            if said == _ENDS and time.monotonic() - began > _SILENT:
                said = ""  # it ends silent connections
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
    """The alert of the other end against this end's certificate; "" for none."""
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
    """The fault of this end's certificate, as far as this end can see it itself; else ""."""
    try:
        return Folder(identity.certificate.parent).facts(identity.name).fault(identity.name, "")
    except ConfigurationError as error:
        return str(error)
