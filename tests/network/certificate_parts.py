"""Certificates of a test: a folder with an authority and the names that it needs."""

from __future__ import annotations

from pathlib import Path

from aiorts_zenoh.security.folder import Folder


def folder(path: Path, **roles: str) -> Folder:
    """A new authority that has certified these names with their roles."""
    made = Folder(path)
    made.init()
    for name, role in roles.items():
        made.issue(name, role)
    return made
