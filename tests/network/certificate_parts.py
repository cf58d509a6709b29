"""Certificates of a test: a folder with an authority and the names that it needs."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

from aiorts_zenoh.security.certificates import PrivateKey, made_certificate
from aiorts_zenoh.security.folder import Folder


def folder(path: Path, **roles: str) -> Folder:
    """A new authority that has certified these names with their roles."""
    made = Folder(path)
    made.init()
    for name, role in roles.items():
        made.issue(name, role)
    return made


def issue_for(made: Folder, name: str, key: PrivateKey) -> None:
    """Certify a name again, for this key."""
    authority, of_authority = (made.path / f"ca.{ending}" for ending in ("pem", "key"))
    role, _ = made.names[name]
    pair = made_certificate(authority.read_bytes(), of_authority.read_bytes(), name, role, (), 1.0, key=key)
    for ending, data in zip(("pem", "key"), pair, strict=True):
        (made.path / f"{name}.{ending}").write_bytes(data)


def issue_later(made: Folder, name: str, days_from_now: float) -> None:
    """Certify a name again, for a day that begins so many days from now."""
    authority, key = (made.path / f"ca.{ending}" for ending in ("pem", "key"))
    begins = datetime.now(UTC) + timedelta(days=days_from_now)
    role, _ = made.names[name]
    pair = made_certificate(authority.read_bytes(), key.read_bytes(), name, role, (), 1.0, begins)
    for ending, data in zip(("pem", "key"), pair, strict=True):
        (made.path / f"{name}.{ending}").write_bytes(data)
