"""Makes and reads certificates. No file is touched here, and no key gets into a message."""

from __future__ import annotations

import re
import secrets
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from ipaddress import ip_address
from typing import Final

from aiorts.errors import ConfigurationError, MissingExtra
from aiorts.late import dataclass

try:
    from cryptography import x509
    from cryptography.exceptions import InvalidSignature
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec, rsa
    from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID
except ImportError:
    raise MissingExtra("certificates", "cryptography", "zenoh") from None

PrivateKey = ec.EllipticCurvePrivateKey | rsa.RSAPrivateKey
_AUTHORITY_DAYS: Final = 3_650
_BEFORE: Final = timedelta(minutes=5)
"""The most by which another machine's clock may be behind this one's when a certificate is new."""
_LOOPBACK: Final = ("localhost", "127.0.0.1", "::1")
_LEAST: Final = ((rsa.RSAPublicKey, "RSA", 2_048), (ec.EllipticCurvePublicKey, "an elliptic curve", 256))
"""The least bits of a key, by its kind."""
_HOST: Final = re.compile(r"[A-Za-z0-9]([A-Za-z0-9-]*[A-Za-z0-9])?(\.[A-Za-z0-9]([A-Za-z0-9-]*[A-Za-z0-9])?)*")


@dataclass(frozen=True, slots=True)
class Facts:
    """The contents of a certificate, compared with its key and authority."""

    name: str
    role: str
    begins: datetime
    ends: datetime
    addresses: tuple[str, ...]
    certified: bool
    """Whether this authority has certified it."""
    fits_key: bool
    weak: str
    """The key that is too short, here or of the authority; "" when none is."""

    def fault(self, name: str, role: str) -> str:
        """The fault of the certificate for a name with a role ("" is any); "" when there is none."""
        now = datetime.now(UTC)
        if self.name != name:
            return f"is for {self.name!r}, not for {name!r}"
        if not self.certified:
            return "was not issued by the authority of this folder (ca.pem)"
        if not self.fits_key:
            return "does not go with its key"
        if self.weak:
            return f"has a key that is too short: {self.weak}; aiorts certs makes longer ones"
        if now < self.begins:
            return f"is not valid before {self.begins:%Y-%m-%d %H:%M} UTC"
        if now > self.ends:
            return f"has expired on {self.ends:%Y-%m-%d %H:%M} UTC; aiorts certs issue {name}"
        if role and role != self.role:
            return f"has the role {self.role!r}, the index says {role!r}; aiorts certs issue {name} --role {role}"
        return ""


def made_authority(days: float = _AUTHORITY_DAYS) -> tuple[bytes, bytes]:
    """The certificate and the key of a new authority."""
    key = _new_key()
    # Each authority has a name of its own, so that another one is reported as another, and not as a damaged one.
    word = f"aiorts authority {secrets.token_hex(4)}"
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, word)])
    builder = _builder(subject, subject, key, days)
    builder = builder.add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
    builder = builder.add_extension(_usage(signs=False), critical=True)
    return _signed(builder, key), _pem_of(key)


def made_certificate(
    authority: bytes,
    authority_key: bytes,
    name: str,
    role: str,
    addresses: Sequence[str],
    days: float,
    begins: datetime | None = None,
    key: PrivateKey | None = None,
) -> tuple[bytes, bytes]:
    """The certificate and the key of a name, valid from now on or from when it begins; by default the key is new."""
    issuer = _certificate(authority)
    signing = _key(authority_key)
    if signing.public_key() != issuer.public_key():
        raise ConfigurationError("ca.key: does not go with ca.pem")
    key = key or _new_key()
    subject = x509.Name(
        [
            x509.NameAttribute(NameOID.COMMON_NAME, name),
            x509.NameAttribute(NameOID.ORGANIZATIONAL_UNIT_NAME, role),
        ]
    )
    builder = _builder(subject, issuer.subject, key, days, begins)
    builder = builder.add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
    builder = builder.add_extension(_usage(signs=True), critical=True)
    uses = [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
    builder = builder.add_extension(x509.ExtendedKeyUsage(uses), critical=False)
    names = dict.fromkeys((*_LOOPBACK, *addresses))
    builder = builder.add_extension(x509.SubjectAlternativeName([_general(one) for one in names]), critical=False)
    return _signed(builder, signing), _pem_of(key)


def facts(certificate: bytes, key: bytes, authority: bytes) -> Facts:
    """The facts of a certificate. ConfigurationError: one of the three cannot be read."""
    found, issuer = _certificate(certificate), _certificate(authority)
    try:
        found.verify_directly_issued_by(issuer)
        certified = True
    except (ValueError, TypeError, InvalidSignature):
        certified = False
    return Facts(
        _of_subject(found, NameOID.COMMON_NAME),
        _of_subject(found, NameOID.ORGANIZATIONAL_UNIT_NAME),
        found.not_valid_before_utc,
        found.not_valid_after_utc,
        _addresses(found),
        certified,
        _key(key).public_key() == found.public_key(),
        _weak(found) or (_weak(issuer) and f"of the authority, {_weak(issuer)}"),
    )


# -- the library -------------------------------------------------------------------------------------------------------


def _new_key() -> ec.EllipticCurvePrivateKey:
    return ec.generate_private_key(ec.SECP256R1())


def _weak(certificate: x509.Certificate) -> str:
    key = certificate.public_key()
    for kind, word, least in _LEAST:
        if isinstance(key, kind):
            return "" if key.key_size >= least else f"{word} with {key.key_size} bits, of at least {least}"
    return ""  # Ed25519 and the like have one size


def _key(data: bytes) -> PrivateKey:
    try:
        found = serialization.load_pem_private_key(data, None)
    except (ValueError, TypeError):
        found = None
    if not isinstance(found, PrivateKey):
        raise ConfigurationError("the key is none of RSA or an elliptic curve in PEM without a passphrase")
    return found


def _certificate(data: bytes) -> x509.Certificate:
    try:
        return x509.load_pem_x509_certificate(data)
    except ValueError:
        raise ConfigurationError("the certificate is none in PEM") from None


def _pem_of(key: PrivateKey) -> bytes:
    form = serialization.PrivateFormat.PKCS8
    return key.private_bytes(serialization.Encoding.PEM, form, serialization.NoEncryption())


def _builder(
    subject: x509.Name,
    issuer: x509.Name,
    key: PrivateKey,
    days: float,
    begins: datetime | None = None,
) -> x509.CertificateBuilder:
    now = begins or datetime.now(UTC)
    builder = x509.CertificateBuilder().subject_name(subject).issuer_name(issuer).public_key(key.public_key())
    builder = builder.serial_number(x509.random_serial_number())
    return builder.not_valid_before(now - _BEFORE).not_valid_after(now + timedelta(days=days))


def _usage(*, signs: bool) -> x509.KeyUsage:
    """The usage of a key that signs handshakes, or that certifies others."""
    return x509.KeyUsage(
        digital_signature=signs,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=not signs,
        crl_sign=not signs,
        encipher_only=False,
        decipher_only=False,
    )


def _signed(builder: x509.CertificateBuilder, key: PrivateKey) -> bytes:
    return builder.sign(key, hashes.SHA256()).public_bytes(serialization.Encoding.PEM)


def _general(address: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ip_address(address))
    except ValueError:
        pass
    if len(address) > 253 or not _HOST.fullmatch(address):
        raise ConfigurationError(f"address: expected a host name or an IP address, got {address!r:.80}") from None
    return x509.DNSName(address)


def _addresses(certificate: x509.Certificate) -> tuple[str, ...]:
    try:
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return ()
    return (*names.get_values_for_type(x509.DNSName), *map(str, names.get_values_for_type(x509.IPAddress)))


def _of_subject(certificate: x509.Certificate, what: x509.ObjectIdentifier) -> str:
    found = certificate.subject.get_attributes_for_oid(what)
    return str(found[0].value) if found else ""
